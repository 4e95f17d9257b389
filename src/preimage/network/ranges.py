"""Settings validate themselves: what can be asked for is refused where it is asked, on the command line and in Python alike."""

import math
from collections.abc import Iterable, Mapping
from typing import Any

from preimage.records import HIGHEST_RATE_HZ, LOWEST_RATE_HZ

MOST = 10**9
"""Numbers beyond this are none that the work could end with."""
MOST_HELD = 10**5
"""The same of numbers of things that are held in memory at once."""


def validate(
    settings: Any,
    *,
    at_least: Mapping[str, float] | None = None,
    held: Iterable[str] = (),
    above_zero: Iterable[str] = (),
    shares: Iterable[str] = (),
    rates: Iterable[str] = (),
) -> None:
    """Raises ValueError for the first field that is out of range; None stands for a default and passes.

    Args:
        at_least: the least of each field.
        held: those of them that are numbers of things in memory.

    >>> from types import SimpleNamespace
    >>> validate(SimpleNamespace(batch_size=0), at_least={"batch_size": 1}, held=["batch_size"])
    Traceback (most recent call last):
    ValueError: batch_size (--batch-size) is 0: give 1 or more
    """
    for name, least in (at_least or {}).items():
        most = MOST_HELD if name in held else MOST
        _require(settings, name, lambda value, least=least: value >= least, f"{least:g} or more")
        _require(settings, name, lambda value, most=most: value <= most, f"{most} or less")
    for name in above_zero:
        _require(settings, name, lambda value: 0 < value < math.inf, "a number above 0")
        _require(settings, name, lambda value: value <= MOST, f"{MOST} or less")
    for name in shares:
        _require(settings, name, lambda value: 0 <= value <= 1, "a share between 0 and 1")
    for name in rates:
        in_words = f"{LOWEST_RATE_HZ:g} to {HIGHEST_RATE_HZ:g} steps a second"
        _require(settings, name, lambda value: LOWEST_RATE_HZ <= value <= HIGHEST_RATE_HZ, in_words)


def _require(settings: Any, name: str, fits: Any, wanted: str) -> None:
    value = getattr(settings, name)
    if value is not None and not fits(value):
        raise ValueError(f"{name} (--{name.replace('_', '-')}) is {value}: give {wanted}")
