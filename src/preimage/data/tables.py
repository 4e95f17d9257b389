"""The table of joints of an episode, `joints.csv`, as recorders and spreadsheets write it.

Columns are separated by commas, semicolons or tabs; numbers have a point or a comma before their decimals; the text is UTF-8, with or
without a byte-order mark, or UTF-16. Rows without any content are passed over. Clocks (`data.clocks`) are known by their names, in whatever
column they stand.
"""

import csv
import io
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from preimage.data.clocks import Clock, find_clock, is_clock, may_be_clock, seconds_since_1970
from preimage.data.files import read_text

SEPARATORS = ";", "\t", ","
"""The first of them that the head has separates the columns."""
DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
HOLDS = "it should hold the joints, one row a picture, under a head of their names"


@dataclass(frozen=True, eq=False)
class Table:
    """The columns of a table of joints, by what they are."""

    names: tuple[str, ...]
    joints: Float[np.ndarray, "T J"]
    clocks: dict[str, Float[np.ndarray, " T"]]
    """By name, in the order of the table."""

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
    head, *rows = _rows_of(path)
    names = [name.strip() for name in head]
    if len(set(names)) != len(names) or "" in names:
        raise ValueError(f"{path} has the head {','.join(head)}: it should give each joint a name of its own")
    numbers = [_numbers(row, names, f"{path}, row {number}") for number, row in enumerate(rows, start=1)]
    table = np.array(numbers, np.float64).reshape(-1, len(names))  # and so where there is no row
    clocks = {
        name: table[:, column]
        for column, name in enumerate(names)
        if is_clock(name) or (may_be_clock(name) and len(table) > 1 and (np.diff(table[:, column]) > 0).all())
    }
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
    separator = next((each for each in SEPARATORS if each in head), ",")
    try:
        rows = [row for row in csv.reader(io.StringIO(text, newline=""), delimiter=separator) if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise ValueError(f"{path} is no table ({error}): {HOLDS}") from error
    if not rows:
        raise ValueError(f"{path} is empty or no table: {HOLDS}")
    return rows


def _numbers(row: list[str], names: list[str], where: str) -> list[float]:
    if len(row) != len(names):
        commas = "; where commas stand before decimals, semicolons have to separate the columns" if len(row) == 2 * len(names) else ""
        raise ValueError(f"{where} has {len(row)} columns, the head {len(names)}: let them agree{commas}")
    try:
        return [_number(cell.strip(), name) for cell, name in zip(row, names, strict=True)]
    except ValueError as error:
        raise ValueError(f"{where} holds {','.join(row)[:100]}: it should hold numbers") from error


def _number(cell: str, name: str) -> float:
    if not cell:
        return np.nan
    try:
        return float(cell.replace(",", ".") if DECIMAL_COMMA.fullmatch(cell) else cell)
    except ValueError:
        if is_clock(name):
            return seconds_since_1970(cell)
        raise
