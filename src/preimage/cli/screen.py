"""What the verbs show on the screen while they work, and what they refuse alike."""

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

console = Console(stderr=True)


def bar(*, shown: bool = True) -> Progress:
    """A progress bar with the time left; in a log, where it could not move, there is none."""
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn()
    return Progress(*columns, console=console, disable=not (shown and console.is_terminal))


def known_task(task: str) -> None:
    """Raises ValueError where there is no task of this name."""
    from preimage.robot import TASKS

    if task not in TASKS:
        raise ValueError(f"{task} is no task; known are {', '.join(TASKS)}")
