"""Trainings that the page starts: each a `preimage train`, a child of the server, ended by the signal after which it keeps its last update.

The server itself never learns. The child holds the lock of its run folder, so that nobody else writes it meanwhile.
"""

import re
import subprocess
import sys
import tempfile
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from http import HTTPStatus
from pathlib import Path
from typing import IO, Literal

from preimage.storage.locks import writer
from preimage.studio.problems import Refusal

NAME = re.compile(r"[A-Za-z0-9][\w.-]{0,63}", re.ASCII)
"""What a run may be called: the name of a folder on every system, and no way out of where runs are."""
MOST_RUNNING = 1
"""Trainings at a time: each would take the processors of the others, and of the plans."""
PATIENCE_S = 120.0
"""How long the end of the server waits for a training to keep its last update."""
LAST_WORDS = 4096
"""Bytes of what a child said that are read when it failed."""
State = Literal["running", "written", "stopped", "failed"]


@dataclass(eq=False)
class Child:
    """A training that the page started."""

    process: subprocess.Popen[bytes]
    said: IO[bytes]
    was_stopped: bool = False

    @property
    def is_running(self) -> bool:
        return self.process.poll() is None

    def stop(self) -> None:
        """Ask it to end after its running update; a second time would end it at once."""
        if self.is_running and not self.was_stopped:
            self.was_stopped = True
            self.process.terminate()

    @property
    def complaint(self) -> str | None:
        """The sentence with which it failed."""
        if self.is_running or self.was_stopped or self.process.returncode == 0:
            return None
        self.said.seek(max(0, self.said.seek(0, 2) - LAST_WORDS))
        lines = self.said.read().decode(errors="replace").strip().splitlines()
        return lines[-1].removeprefix("preimage: ") if lines else f"it ended with code {self.process.returncode}"


class Trainer:
    """The children of the server.

    Args:
        command: what `preimage` is here.
    """

    def __init__(self, command: Sequence[str] = (sys.executable, "-m", "preimage")) -> None:
        self._command, self._children, self._lock = tuple(command), dict[Path, Child](), threading.Lock()

    @property
    def folders(self) -> tuple[Path, ...]:
        """Of all that were started, in their order."""
        return tuple(self._children)

    def begin(self, data: Path, into: Path, name: str, *, size: str, preset: str, updates: int) -> Path:
        """Train a new run of a name in a folder; where it is.

        Raises:
            Refusal: it would be one too many, its name is none, or there is such a folder already.
        """
        if not NAME.fullmatch(name):
            raise Refusal(HTTPStatus.UNPROCESSABLE_ENTITY, "a run is called by letters, digits, dots and dashes: choose another name")
        out = into / name
        if out.exists():
            raise Refusal(HTTPStatus.CONFLICT, f"there is a {name} in {into} already: choose another name, or resume it")
        self._start(out, [str(data), "--out", str(out), "--size", size, "--as", preset, "--updates", str(updates)])
        return out

    def resume(self, data: Path, out: Path) -> None:
        """Go on with a run; Refusal where somebody writes it, or it would be one too many."""
        if who := writer(out):
            raise Refusal(HTTPStatus.CONFLICT, f"{out.name} is being written by {who}: wait until it ends, or stop it")
        self._start(out, [str(data), "--out", str(out), "--resume"])

    def stop(self, out: Path) -> None:
        """Stop a training after its running update; Refusal where it is none of ours."""
        child = self._children.get(out)
        if child is None or not child.is_running:
            raise Refusal(HTTPStatus.CONFLICT, f"{out.name} is not being trained by this studio: stop it where it was started")
        child.stop()

    def state(self, out: Path) -> tuple[State | None, str | None]:
        """What is known of a training, and more in words: who else writes it, or why it failed."""
        child = self._children.get(out)
        if child is not None and child.is_running:
            return "running", "it keeps its last update …" if child.was_stopped else None
        if who := writer(out):
            return "written", f"by {who}"
        if child is None:
            return None, None
        return ("failed", child.complaint) if child.complaint else ("stopped" if child.was_stopped else None, None)

    def close(self) -> None:
        """Stop all of them, and wait until they kept what they did."""
        for child in self._children.values():
            child.stop()
        for child in self._children.values():
            child.process.wait(PATIENCE_S)
            child.said.close()

    def _start(self, out: Path, words: list[str]) -> None:
        with self._lock:
            running = [path.name for path, child in self._children.items() if child.is_running]
            if len(running) >= MOST_RUNNING:
                raise Refusal(HTTPStatus.CONFLICT, f"{running[0]} is being trained: wait until it ends, or stop it")
            out.parent.mkdir(parents=True, exist_ok=True)
            if former := self._children.get(out):
                former.said.close()
            said = tempfile.TemporaryFile()  # noqa: SIM115, it is read when the child has ended
            process = subprocess.Popen(
                [*self._command, "train", *words],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=said,
                start_new_session=True,  # or Ctrl-C in the terminal would reach it beside our own signal, and end it at once
            )
            self._children[out] = Child(process, said)
