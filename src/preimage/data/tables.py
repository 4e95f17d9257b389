"""The table of joints of an episode, `joints.csv`, as recorders and spreadsheets write it.

Columns are separated by commas, semicolons or tabs; numbers have a point or a comma before their decimals; the text is UTF-8, with or
without a byte-order mark, or UTF-16. Rows without any content are passed over, and so are columns without a name that hold nothing or count
the rows. Clocks (`data.clocks`) are known by their names, in whatever column they stand.
"""

import csv
import io
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from preimage.data.clocks import Clock, Columns, clocks_among, find_clock, is_clock, seconds_since_1970
from preimage.data.files import read_text

SEPARATORS = ";", "\t", ","
"""The first of them that the head has separates the columns."""
DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
WORDS = {"": np.nan, "true": 1.0, "false": 0.0}
"""Cells that are no numbers and mean one."""
HOLDS = "it should hold the joints, one row a picture, under a head of their names"


@dataclass(frozen=True, eq=False)
class Table:
    """The columns of a table of joints, by what they are."""

    names: tuple[str, ...]
    joints: Float[np.ndarray, "T J"]
    clocks: Columns
    """By name, in the order of the table."""

    def in_order(self, names: tuple[str, ...]) -> "Table":
        """The same with its joints in the order of these names."""
        return Table(names, self.joints[:, [self.names.index(name) for name in names]], self.clocks)

    def clock(self, rate_hz: float | None) -> Clock | None:
        """The clock that tells when each row was taken, where there is one; `rate_hz` is the rate where it is known otherwise."""
        return find_clock(self.clocks, rate_hz=rate_hz)


def read_table(path: Path) -> Table:
    """What the table in a file holds.

    Raises:
        ValueError: there is no such table, or a row does not fit.
    """
    if not path.exists():
        raise ValueError(f"{path} is missing: it should hold the joints, one row a picture, under their names")
    head, *rows = _without_row_numbers(*_rows_of(path))
    names = [name.strip() for name in head]
    if all(_is_number(name) for name in names) and not all(name.isdecimal() for name in names):  # which may be numbers of motors
        raise ValueError(f"{path} begins with numbers ({','.join(head)[:100]}): its first row should hold the names of the joints")
    if len(set(names)) != len(names) or "" in names:
        raise ValueError(f"{path} has the head {','.join(head)}: it should give each joint a name of its own")
    numbers = [_numbers(row, names, f"{path}, row {number}") for number, row in enumerate(rows, start=1)]
    table = np.array(numbers, np.float64).reshape(-1, len(names))  # and so where there is no row
    clocks = clocks_among(dict(zip(names, table.T, strict=True)))
    joints = [column for column, name in enumerate(names) if name not in clocks]
    if not joints:
        raise ValueError(f"{path} has the head {','.join(head)}: it should give each joint a name of its own")
    return Table(tuple(names[column] for column in joints), table[:, joints], clocks)


def _rows_of(path: Path) -> list[list[str]]:
    """The cells of the head and of every row in which something stands."""
    text = read_text(path)
    if text[:4].lower() == "sep=":  # a spreadsheet's own word on what separates the columns
        text = text.partition("\n")[2]
    head = next((line for line in text.splitlines() if line.strip()), "")
    separator = next((each for each in SEPARATORS if each in head), "#" if head.startswith("#") else ",")
    text = text.lstrip().removeprefix("#")  # which numpy.savetxt writes before the head, and blanks between the columns
    if separator == "#":
        return [line.split() for line in text.splitlines() if line.strip()]
    try:
        table = csv.reader(io.StringIO(text, newline=""), delimiter=separator, skipinitialspace=True)
        rows = [row for row in table if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise ValueError(f"{path} is no table ({error}): {HOLDS}") from error
    if not rows:
        raise ValueError(f"{path} is empty or no table: {HOLDS}")
    return rows


def _without_row_numbers(head: list[str], *rows: list[str]) -> list[list[str]]:
    """Columns without a name that hold nothing, or count the rows as pandas does, are left out."""
    if not all(len(row) == len(head) for row in rows):
        return [head, *rows]
    columns = [[name.strip(), *(cell.strip() for cell in cells)] for name, *cells in zip(head, *rows, strict=True)]
    kept = [cells for cells in columns if cells[0] or (any(cells) and cells[1:] != [str(row) for row in range(len(rows))])]
    return [list(row) for row in zip(*kept, strict=True)] or [head, *rows]


def _numbers(row: list[str], names: list[str], where: str) -> list[float]:
    if len(row) != len(names):
        commas = "; where commas stand before decimals, semicolons have to separate the columns" if len(row) == 2 * len(names) else ""
        raise ValueError(f"{where} has {len(row)} columns, the head {len(names)}: let them agree{commas}")
    return [_number(cell.strip(), name, where) for cell, name in zip(row, names, strict=True)]


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _number(cell: str, name: str, where: str) -> float:
    """What a cell says: a number, a date where the column is a clock, true or false as 1 or 0, and nothing as NaN."""
    cell = cell.replace(",", ".") if DECIMAL_COMMA.fullmatch(cell) else cell
    if cell.lower() in WORDS:
        return WORDS[cell.lower()]
    if _is_number(cell):
        return float(cell)
    try:
        if is_clock(name):
            return seconds_since_1970(cell)
    except ValueError:
        pass
    raise ValueError(f"{where} holds {cell[:60]} under {name}: it should hold numbers; take a column of anything else out")
