"""Which columns are clocks and not joints, in what unit they count, and how many steps a second they tell.

A column is known as a clock by its name. What rises evenly in every episode under any other name is a clock or a counter as well, but a
joint that turns at one pace does the same: there the user is asked.

>>> [name for name in ("timestamp", "Time_s", "header.stamp.secs", "shoulder", "index_finger") if is_clock(name)]
['timestamp', 'Time_s', 'header.stamp.secs']
>>> unit_of("time_ms"), unit_of("timestamp")
('ms', None)
"""

import datetime
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

LEAST_RATE_HZ, MOST_RATE_HZ = 0.2, 1000.0
"""Recordings of robots have rates between these; what is outside counts in another unit."""
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
WITHIN = 2.0
"""A clock without a unit counts in the unit in which it agrees with a rate that is known, to this factor."""
LEAST_STEPS = 10
"""Steps of the median episode from which on an even rise says something: shorter ways are often straight."""
EVEN = 0.5
"""Share of a column's median step by which nine of ten of its steps may differ, and the median steps of two episodes: clocks jitter."""


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


@dataclass(frozen=True, eq=False)
class Clock:
    """A column that tells when each row was taken."""

    name: str
    times_s: Float[np.ndarray, " T"]


def find_clock(columns: Mapping[str, Float[np.ndarray, " T"]], *, rate_hz: float | None) -> Clock | None:
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
        times_s = values * SECONDS[unit or _agreeing(values, rate_hz)] + (0 if rest is None else rest)
        if len(times_s) < 2 or (np.diff(times_s) > 0).all():
            return Clock(name, times_s)
    return None


def _nanoseconds_beside(columns: Mapping[str, Float[np.ndarray, " T"]], name: str) -> Float[np.ndarray, " T"] | None:
    """ROS splits a time in two columns, `secs` and `nsecs`."""
    for other, values in columns.items():
        if unit_of(other) == "ns" and words_of(other)[:-1] == words_of(name)[:-1] and (values >= 0).all() and (values < 1e9).all():
            return values * SECONDS["ns"]
    return None


def _agreeing(values: Float[np.ndarray, " T"], rate_hz: float | None) -> str:
    if rate_hz is None or len(values) < 2:
        return "s"
    step = float(np.median(np.diff(values)))
    agreeing = [unit for unit, seconds in SECONDS.items() if 1 / WITHIN < step * seconds * rate_hz < WITHIN]
    return agreeing[0] if agreeing else "s"


def rate_of(clock: Clock, where: str) -> float:
    """Steps a second, by the median step.

    Args:
        where: the table, for the sentence.

    Raises:
        ValueError: the rate is none of a robot's recording.
    """
    step_s, seconds = float(np.median(np.diff(clock.times_s))), SECONDS[unit_of(clock.name) or "s"]
    rate_hz = float(f"{1 / step_s:.4g}")  # clocks jitter: more digits would say what nobody measured
    if LEAST_RATE_HZ <= rate_hz <= MOST_RATE_HZ:
        return rate_hz
    likely = [unit for unit in SECONDS if LEAST_RATE_HZ <= seconds / (step_s * SECONDS[unit]) <= MOST_RATE_HZ]
    guess = f"if it counts {IN_WORDS[likely[0]]}, call it time_{likely[0]}" if likely else "look at the unit"
    unit = IN_WORDS[unit_of(clock.name) or "s"]
    raise ValueError(f"{where} has {step_s:g} s a picture ({rate_hz:g} Hz), as {clock.name} is in {unit}: {guess}; {bounds()}")


def bounds() -> str:
    return f"rates are {LEAST_RATE_HZ:g} to {MOST_RATE_HZ:g} Hz"


def is_rate(rate_hz: object) -> bool:
    """Whether a value out of a file is a rate that a robot may be recorded at."""
    return isinstance(rate_hz, int | float) and not isinstance(rate_hz, bool) and LEAST_RATE_HZ <= rate_hz <= MOST_RATE_HZ


def seconds_since_1970(text: str) -> float:
    """What a date and time in ISO 8601 means; ValueError where it is none."""
    moment = datetime.datetime.fromisoformat(text.strip())
    return (moment if moment.tzinfo else moment.replace(tzinfo=datetime.UTC)).timestamp()


def evenly_rising(recordings: Sequence[Float[np.ndarray, "_T J"]]) -> Bool[np.ndarray, " J"]:
    """Which columns rise at every step of every episode by about the same, as clocks and counters do and joints hardly ever.

    >>> count, joint = np.arange(20.0), np.sin(np.arange(20.0))
    >>> evenly_rising([np.stack([count, joint], 1)] * 3).tolist()
    [True, False]
    """
    if np.median([len(joints) for joints in recordings]) < LEAST_STEPS:
        return np.zeros(recordings[0].shape[1], bool)
    ticks = [np.diff(joints, axis=0) for joints in recordings if len(joints) > 1]
    paces = np.array([np.median(each, axis=0) for each in ticks])  # (N, J)
    usual = np.median(paces, axis=0)
    rises = np.all([(each > 0).all(0) for each in ticks], axis=0)
    uneven = np.array([np.quantile(np.abs(each - pace), 0.9, axis=0) for each, pace in zip(ticks, paces, strict=True)])  # (N, J)
    return rises & (uneven <= EVEN * paces).all(0) & (np.abs(paces - usual) <= EVEN * usual).all(0)


def asked_about(names: Sequence[str], recordings: Sequence[Float[np.ndarray, "_T J"]]) -> str | None:
    """A sentence on the joints that rise evenly in every episode, where there are any and nobody has named the joints to learn."""
    rising = evenly_rising(recordings)
    clocks = [name for name, evenly in zip(names, rising, strict=True) if evenly and not is_clock(name)]
    if not clocks:
        return None
    others = [name for name, evenly in zip(names, rising, strict=True) if not evenly and not is_clock(name)]
    rise = "rises" if len(clocks) == 1 else "rise"
    choice = f"leave it out by --view.joints {' '.join(others)}, or " if others else ""
    return f"{', '.join(clocks)} {rise} evenly in every episode, as a clock or a counter does: {choice}name all joints there to keep it"
