"""Which columns are clocks and not joints, in what unit they count, and how many steps a second they tell.

A column is known as a clock by its name. What rises evenly under another name is asked about (`data.questions`).

>>> [name for name in ("timestamp", "Time_s", "header.stamp.secs", "shoulder", "index_finger") if is_clock(name)]
['timestamp', 'Time_s', 'header.stamp.secs']
>>> unit_of("time_ms"), unit_of("timestamp")
('ms', None)
"""

import datetime
import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from preimage.records import HIGHEST_RATE_HZ, LOWEST_RATE_HZ

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
IN_WORDS = {"s": "seconds", "ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}
SPELLINGS = {
    "s": ("s", "sec", "secs", "second", "seconds"),
    "ms": ("ms", "msec", "msecs", "milli", "millis", "millisecond", "milliseconds"),
    "us": ("us", "µs", "μs", "usec", "usecs", "micro", "micros", "microsecond", "microseconds"),
    "ns": ("ns", "nsec", "nsecs", "nano", "nanos", "nanosec", "nanosecs", "nanosecond", "nanoseconds"),
}
UNITS = {word: unit for unit, words in SPELLINGS.items() for word in words}
BARE = {*UNITS, "t", "epoch", "unix", "elapsed"}
"""Words of which a name may consist altogether to be that of a clock, if it rises."""
COUNTER = {"step", "steps", "timestep", "timesteps", "index", "idx", "frame", "frames", "count"}
"""Words that make a counter of a clock: it tells the order and not the time."""
SINCE_1970_S = 1e9, 5e9
"""Seconds since 1970 in the years 2001 and 2128: a clock that stands between them in one unit does so in no other."""
WITHIN = 2.0
"""A clock without a unit counts in the unit in which it agrees with a rate that is known, to this factor."""


def words_of(name: str) -> list[str]:
    """The words of a column's name in small letters, at every change of case and every sign between them.

    >>> words_of("rosTime [ms]"), words_of("TIME_S")
    (['ros', 'time', 'ms'], ['time', 's'])
    """
    return [word for word in re.split(r"[^a-zµμ]+", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).lower()) if word]


def is_clock(name: str) -> bool:
    """Whether the name alone says that a column is a clock."""
    return any(re.match(r"time|.*(time|stamps?)$|(date|clock)$|stamp(ns|us|ms|s)$", word) for word in words_of(name))


def may_be_clock(name: str) -> bool:
    """Whether a column that always rises is a clock under this name: `t`, `secs`, `elapsed [ms]`."""
    return bool(words := words_of(name)) and set(words) <= BARE


def unit_of(name: str) -> str | None:
    """The unit of time that a name gives, `s`, `ms`, `us` or `ns`."""
    words = words_of(name)
    joined = [match[1] for word in words if (match := re.fullmatch(r"(?:.*time|.*stamp|t)(ns|us|ms|s)", word)) and word not in COUNTER]
    found = [UNITS[word] for word in words if word in UNITS] + [unit for unit in joined if f"time{unit}" != "times"]
    return found[-1] if found else None


Columns = Mapping[str, Float[np.ndarray, " T"]]


def clocks_among(columns: Columns) -> Columns:
    """The columns of a table that are clocks: by their names, or because they may be by their names and rise at every step, alone or with
    the nanoseconds beside them.

    >>> columns = {"sec": np.array([7.0, 7.0, 8.0]), "nanosec": np.array([1e8, 9e8, 7e8]), "elbow": np.arange(3.0)}
    >>> [*clocks_among(columns)], [*clocks_among(columns | {"nanosec": np.array([9e8, 1e8, 7e8])})]
    (['sec', 'nanosec'], [])
    """
    known = {name for name, values in columns.items() if is_clock(name) or (may_be_clock(name) and _rises(values))}
    for name, values in columns.items():
        rest = _nanoseconds_beside(columns, name) if may_be_clock(name) and unit_of(name) == "s" else None
        if rest and _rises(values + SECONDS["ns"] * columns[rest]):
            known |= {name, rest}
    return {name: values for name, values in columns.items() if name in known}


def _rises(values: Float[np.ndarray, " T"]) -> bool:
    """Whether it rises at every step; a single value does not."""
    return len(values) > 1 and bool((np.diff(values) > 0).all())


@dataclass(frozen=True, eq=False)
class Clock:
    """A column that tells when each row was taken."""

    name: str
    times_s: Float[np.ndarray, " T"]


def find_clock(columns: Columns, *, rate_hz: float | None) -> Clock | None:
    """The first of these clocks that rises at every step; None where none does.

    Args:
        columns: the clocks of a table by name, in the order of the table.
        rate_hz: the rate, where it is known otherwise: a clock whose name gives no unit counts in the one that agrees with it.
    """
    for name, values in columns.items():
        if COUNTER & set(words_of(name)):
            continue
        unit = unit_of(name)
        rest = _nanoseconds_beside(columns, name) if unit == "s" else None
        times_s = values * SECONDS[unit or unit_that_agrees(values, rate_hz)] + (SECONDS["ns"] * columns[rest] if rest else 0)
        if len(times_s) < 2 or (np.isfinite(times_s).all() and _rises(times_s)):
            return Clock(name, times_s)
    return None


def _nanoseconds_beside(columns: Columns, name: str) -> str | None:
    """ROS splits a time in two columns, `secs` and `nsecs`."""
    for other, values in columns.items():
        if unit_of(other) == "ns" and words_of(other)[:-1] == words_of(name)[:-1] and (values >= 0).all() and (values < 1e9).all():
            return other
    return None


def unit_that_agrees(values: Float[np.ndarray, " T"], rate_hz: float | None) -> str:
    """The unit in which a clock agrees with the rate, or, where none is known, with the time since 1970; seconds where none does.

    >>> since_1970 = 1.7e18 + 1e8 * np.arange(5)
    >>> unit_that_agrees(since_1970, None), unit_that_agrees(100.0 * np.arange(5), 10.0), unit_that_agrees(np.arange(5.0), None)
    ('ns', 'ms', 's')
    """
    if len(values) < 2 or not np.isfinite(values).all():
        return "s"
    step = float(np.median(np.diff(values)))
    for unit, seconds in SECONDS.items():
        if rate_hz is not None:
            agrees = 1 / WITHIN < step * seconds * rate_hz < WITHIN
        else:
            agrees = SINCE_1970_S[0] <= values[0] * seconds < SINCE_1970_S[1] and is_rate(1 / (step * seconds) if step > 0 else None)
        if agrees:
            return unit
    return "s"


def rate_of(clock: Clock, where: str) -> float:
    """Steps a second, by the median step.

    Args:
        where: the table, for the sentence.

    Raises:
        ValueError: the rate is none of a robot's recording.
    """
    step_s, seconds = float(np.median(np.diff(clock.times_s))), SECONDS[unit_of(clock.name) or "s"]
    rate_hz = float(f"{1 / step_s:.4g}")  # clocks jitter: more digits would say what nobody measured
    if is_rate(rate_hz):
        return rate_hz
    likely = [unit for unit in SECONDS if is_rate(seconds / (step_s * SECONDS[unit]))]
    guess = f"if it counts {IN_WORDS[likely[0]]}, call it time_{likely[0]}" if likely else "look at the unit"
    unit = IN_WORDS[unit_of(clock.name) or "s"]
    raise ValueError(f"{where} has {step_s:g} s a picture ({rate_hz:g} Hz), as {clock.name} is in {unit}: {guess}; {bounds()}")


def bounds() -> str:
    return f"rates are {LOWEST_RATE_HZ:g} to {HIGHEST_RATE_HZ:g} Hz"


def is_rate(rate_hz: object) -> bool:
    """Whether a value out of a file is a rate that a robot may be recorded at."""
    return isinstance(rate_hz, int | float) and not isinstance(rate_hz, bool) and LOWEST_RATE_HZ <= rate_hz <= HIGHEST_RATE_HZ


def seconds_since_1970(text: str) -> float:
    """What a date and time in ISO 8601 means; ValueError where it is none."""
    moment = datetime.datetime.fromisoformat(text.strip())
    return (moment if moment.tzinfo else moment.replace(tzinfo=datetime.UTC)).timestamp()
