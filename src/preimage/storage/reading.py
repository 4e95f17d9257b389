"""JSON and arrays that others may have written or damaged: read within bounds, every number finite, every fault one sentence.

>>> import tempfile
>>> with tempfile.TemporaryDirectory() as folder:
...     path = Path(folder) / "limits.json"
...     _ = path.write_text('{"elbow": {"upper": 1e999}}')
...     read_json(path)
Traceback (most recent call last):
ValueError: elbow: upper is inf, which nothing can be computed with
"""

import json
import math
import types
import typing
import zipfile
from collections.abc import Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.lib import format as npy

from preimage.data.files import HALF, loads

Record = TypeVar("Record")

LONGEST_JSON = 64 << 20
"""Bytes of a JSON file; what this program writes has thousands."""
LARGEST_ARRAYS = 512 << 20
"""Bytes of all arrays of one file, unpacked; those of a plan of a thousand frames in colour are a fortieth of it."""
LARGEST_NUMBER = 1e300
"""A whole number beyond it is none that could be computed with either."""
LARGEST_VALUE = float(np.finfo(np.float32).max)
"""Numbers in arrays are computed with in float32, which holds no larger ones."""


def read_json(path: Path) -> dict[str, Any]:
    """The mapping in a JSON file.

    Raises:
        ValueError: it is missing, no such JSON, or holds a number that is not finite; the text says which, and not where the file is.
    """
    content = parse_json(path)
    if not isinstance(content, dict):
        raise ValueError(f"it holds {kind_of(content)}, not names with values")
    if place := non_finite_in(content):
        raise ValueError(f"{place}, which nothing can be computed with")
    return content


def parse_json(path: Path) -> Any:
    """What a JSON file holds, whatever that is.

    Raises:
        ValueError: it is missing, or no JSON.
    """
    if not path.is_file():
        raise ValueError(f"there is no file {path.name}")
    try:
        if path.stat().st_size > LONGEST_JSON:
            raise ValueError
        return loads(path.read_bytes().decode("utf-8-sig"))
    except OSError as error:
        raise ValueError(f"it cannot be opened: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ValueError("it is no text in UTF-8") from error
    except UnicodeEncodeError as error:
        raise ValueError(f"it {HALF}") from error
    except json.JSONDecodeError as error:
        raise ValueError(f"it is no JSON from line {error.lineno}, column {error.colno} on") from error
    except (RecursionError, ValueError) as error:  # lists in lists in lists; a number of thousands of digits
        raise ValueError("it is too large, or no JSON that a person would write") from error


def kind_of(value: object) -> str:
    """What a value of JSON is, in words.

    >>> kind_of([1]), kind_of(None), kind_of("a")
    ('a list', 'nothing', "'a'")
    """
    return {list: "a list", dict: "names with values", type(None): "nothing"}.get(type(value)) or f"{value!r:.40}"


def non_finite_in(content: object) -> str | None:
    """Where the first number stands that is not finite, and what it is."""
    if isinstance(content, int | float) and not abs(content) <= LARGEST_NUMBER:
        return f"is {content!r:.40}"
    each = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    for name, value in each:
        if found := non_finite_in(value):
            return f"{name} {found}" if found.startswith("is ") else f"{name}: {found}"
    return None


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays of an npz file.

    Raises:
        ValueError: it is missing, damaged, larger than it could be once unpacked, or holds a number that is not finite.
    """
    if not path.is_file():
        raise ValueError(f"there is no file {path.name}")
    try:
        with path.open("rb") as file:
            with zipfile.ZipFile(file) as members:
                validate_sizes(members)
            file.seek(0)
            with np.load(file) as arrays:
                found = dict(arrays)
    except TooLarge as error:
        raise ValueError(str(error)) from error
    except Exception as error:  # zipfile, zlib, numpy and the tokenizer it asks raise a dozen types for a damaged file
        raise ValueError("it is cut short or damaged") from error
    for name, value in found.items():
        if value.dtype.kind not in "biuf":
            raise ValueError(f"{name} holds no numbers")
        if not np.isfinite(value).all():
            raise ValueError(f"{name} holds numbers that are not finite")
        if value.dtype.kind == "f" and float(max(value.max(initial=0), -value.min(initial=0))) > LARGEST_VALUE:
            raise ValueError(f"{name} holds numbers beyond {LARGEST_VALUE:.1g}")
    return found


class TooLarge(ValueError):
    """Arrays that would fill the memory."""


def validate_sizes(members: zipfile.ZipFile) -> None:
    """Raises ValueError where the arrays of a file, unpacked, are larger than they could be, or than they say."""
    unpacked = sum(member.file_size for member in members.infolist())
    if unpacked > LARGEST_ARRAYS:
        raise TooLarge(f"it would unpack to {unpacked >> 20} MB")
    for member in members.infolist():
        with members.open(member) as file:
            version = npy.read_magic(file)
            shape, _, dtype = npy.read_array_header_1_0(file) if version == (1, 0) else npy.read_array_header_2_0(file)
        if math.prod(shape) * dtype.itemsize > member.file_size:
            raise TooLarge(f"{member.filename.removesuffix('.npy')} is shorter than it says")


def record_of(record: type[Record], content: object) -> Record:
    """A dataclass out of JSON, where its tuples have become lists; what is left out has its default.

    Raises:
        ValueError: a field is unknown, missing, or of another type.

    >>> from preimage.records import Body
    >>> record_of(Body, {"joint_names": ["yaw"], "held": {"yaw": "up"}})
    Traceback (most recent call last):
    ValueError: held is names with values: give Mapping[str, float]
    """
    if not isinstance(content, Mapping):
        raise ValueError(f"there is {kind_of(content)}, not names with values")
    known = {each.name: each for each in fields(record)}  # pyright: ignore[reportArgumentType]
    if unknown := [name for name in content if name not in known]:
        raise ValueError(f"{unknown[0]} is not known here")
    missing = [name for name, each in known.items() if each.default is MISSING and each.default_factory is MISSING and name not in content]
    if missing:
        raise ValueError(f"{missing[0]} is missing")
    hints = typing.get_type_hints(record)
    values = {name: tupled(value) for name, value in content.items()}
    for name, value in values.items():
        if not is_of(value, hints[name]):
            kind = known[name].type
            raise ValueError(f"{name} is {kind_of(content[name])}: give {kind if isinstance(kind, str) else readable(hints[name])}")
    return record(**values)


def readable(hint: Any) -> str:
    """A type as it is written."""
    return str(getattr(hint, "__name__", hint) if isinstance(hint, type) and not typing.get_args(hint) else hint).replace(
        "collections.abc.", ""
    )


def tupled(value: Any) -> Any:
    """The value with tuples for lists."""
    return tuple(map(tupled, value)) if isinstance(value, list) else value


def is_of(value: Any, hint: Any) -> bool:
    """Whether a value of JSON is of a type that a setting has."""
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if hint is None or hint is type(None):
        return value is None
    if origin is typing.Annotated:
        return is_of(value, parts[0])
    if origin in (typing.Union, types.UnionType):
        return any(is_of(value, part) for part in parts)
    if origin is Literal:
        return value in parts and isinstance(value, str)
    if origin is tuple:
        each = parts[:1] * len(value) if isinstance(value, tuple) and parts[-1:] == (Ellipsis,) else parts
        return isinstance(value, tuple) and len(value) == len(each) and all(map(is_of, value, each))
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return isinstance(value, dict) and all(is_of(one, parts[0]) and is_of(other, parts[1]) for one, other in value.items())
    if hint is float:
        return isinstance(value, int | float) and not isinstance(value, bool)
    if hint is int:
        return isinstance(value, int) and not isinstance(value, bool)
    return isinstance(value, hint) if isinstance(hint, type) else True
