"""Trainings watched from outside: the logs of run folders, as they grow."""

from collections.abc import Sequence
from http import HTTPStatus
from pathlib import Path
from typing import Any

from preimage.storage.runs import part_of, read_config, read_log
from preimage.studio.problems import Refusal

MOST_POINTS = 400
"""Updates that the page gets of a training: more are not to be told apart on a screen."""
RECENT = 20
"""Updates whose mean duration says how long the rest takes."""


class Trainings:
    """Run folders by name.

    Args:
        folders: run folders, or folders of them.
    """

    def __init__(self, folders: Sequence[Path]) -> None:
        self._folders = folders

    @property
    def has_any(self) -> bool:
        return bool(self._runs())

    def listed(self) -> list[dict[str, Any]]:
        """The runs there are now, as the page gets them."""
        return [self.described(name) for name in self._runs()]

    def described(self, name: str) -> dict[str, Any]:
        """How far a training is, and its errors so far.

        Raises:
            Refusal: there is no such run.
        """
        folder = self._runs().get(name)
        if folder is None:
            raise Refusal(HTTPStatus.NOT_FOUND, f"there is no run {name[:80]} in the folders that the studio was given by --runs")
        try:
            lines = read_log(folder)
        except ValueError:  # it has not begun
            lines = []
        wanted = part_of(read_config(folder), "train").get("updates")
        done = lines[-1]["update"] if lines else 0
        recent = [line["seconds"] for line in lines[-RECENT:]]
        left_s = sum(recent) / len(recent) * max(0, wanted - done) if recent and isinstance(wanted, int) else None
        shown = lines[:: max(1, len(lines) // MOST_POINTS)]
        about = {"name": name, "updates": wanted, "done": done, "left_s": left_s}
        return about | {key: [line[key] for line in shown] for key in ("update", "visual", "proprioceptive")}

    def _runs(self) -> dict[str, Path]:
        there = [path for folder in self._folders for path in (folder, *sorted(folder.glob("*"))) if (path / "config.json").is_file()]
        return {path.resolve().name: path for path in there}
