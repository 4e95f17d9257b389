"""What the verbs show on the screen while they work: a bar that moves, or, in a log, where none could, a line now and then."""

import itertools
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

Thing = TypeVar("Thing")

console = Console(stderr=True)
LINE_EVERY_S = 30.0
"""Seconds between two lines of a log: often enough to see that the work goes on, seldom enough for a night's log to be read."""

Follow = Callable[..., None]
"""Takes how much is done, how much there is, and what else there is to say, by the names `done`, `total` and `text`."""


@contextmanager
def following(what: str, *, total: int | None = None, shown: bool = True) -> Iterator[Follow]:
    """Lends a function by which a work says how far it is.

    Args:
        what: it does, in a word or two.
        total: how much there is to be done, where it is known beforehand.
        shown: whether this process is the one that shows it.
    """
    if not shown:
        yield lambda **_: None
    elif console.is_terminal:
        columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn()
        with Progress(*columns, console=console, transient=True) as bar:
            task = bar.add_task(what, total=total)

            def move(*, done: int, total: int | None = None, text: str = "") -> None:
                bar.update(task, completed=done, total=total, description=f"{what}  {text}" if text else what)

            yield move
    else:
        yield in_lines(what, total)


def in_lines(what: str, total: int | None = None) -> Follow:
    """A function by which a work says how far it is, in a line of the log now and then."""
    began = last = time.monotonic()
    of_all, before = total, None  # what was done before, where a work goes on, took none of this time, and preparations are no part of it

    def say(*, done: int, total: int | None = None, text: str = "") -> None:
        nonlocal began, last, of_all, before
        of_all, now = total or of_all, time.monotonic()
        if before is None:
            began, before = now, done
        if now - last < LINE_EVERY_S:
            return
        last = now
        left = f", about {duration((now - began) * (of_all - done) / (done - before))} left" if of_all and before < done < of_all else ""
        print(f"{what}: {done}{f' of {of_all}' if of_all else ''}{left}{f'; {text}' if text else ''}", file=sys.stderr, flush=True)

    return say


@contextmanager
def waiting(what: str) -> Iterator[None]:
    """Shows that a work goes on that cannot say how far it is."""
    if console.is_terminal:
        columns = SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn()
        with Progress(*columns, console=console, transient=True) as spinner:
            spinner.add_task(what, total=None)
            yield
        return
    ended, began = threading.Event(), time.monotonic()

    def say() -> None:
        while not ended.wait(LINE_EVERY_S):
            print(f"{what}: {duration(time.monotonic() - began)} so far", file=sys.stderr, flush=True)

    thread = threading.Thread(target=say, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def followed(things: Iterable[Thing], what: str, *, total: int | None = None) -> Iterator[Thing]:
    """The things one by one, with their number shown."""
    with following(what, total=total) as follow:
        for done, thing in enumerate(things, start=1):
            follow(done=done)
            yield thing


def counted(follow: Follow) -> Callable[..., None]:
    """A function that counts its calls, for works that tell of each thing they have done."""
    done = itertools.count(1)
    return lambda *_: follow(done=next(done))


def duration(seconds: float) -> str:
    """A time to wait, in words.

    >>> duration(42.3), duration(150), duration(9000)
    ('42 s', '2.5 minutes', '2.5 hours')
    """
    if seconds < 60:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.2g} minutes" if seconds < 5400 else f"{seconds / 3600:.2g} hours"


def remark(line: str) -> None:
    """A line about how the work is done, apart from what comes of it."""
    console.print(line, highlight=False, soft_wrap=True)


def validate_goals(goals: int, *, fewest: int = 1, most: int) -> None:
    """Raises ValueError where so many goals cannot be planned to."""
    if not fewest <= goals <= most:
        raise ValueError(f"--goals is {goals}: give {fewest} to {most}")


def validate_seed(seed: int) -> None:
    """Raises ValueError where nothing can be drawn by a seed."""
    if not 0 <= seed < 2**63:
        raise ValueError(f"--seed is {seed}: give a whole number from 0 to {2**63 - 1}")


def known_task(task: str) -> None:
    """Raises ValueError where there is no task of this name."""
    from preimage.robot import TASKS

    if task not in TASKS:
        raise ValueError(f"{task} is no task; known are {', '.join(TASKS)}")
