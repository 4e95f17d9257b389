"""What was measured before: the evaluations of a folder of results, their commands, and the films that lie beside them.

Beside `NAME.json` films lie in a folder `NAME`; those of a folder with a `result.json`, which `preimage demo` writes, lie in that folder.
"""

from collections.abc import Iterator
from http import HTTPStatus
from pathlib import Path
from typing import Any

from preimage.report.result_files import is_evaluation, read_result
from preimage.studio.problems import Refusal

NAMES = ("task", "num_demonstrations", "size", "preset", "loop", "seed", "training_seed", "success", "goals", "interval")
"""Of an evaluation, what is shown."""


class Results:
    """The evaluations of a folder.

    Args:
        folder: None where there is none.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder

    def listed(self) -> list[dict[str, Any]]:
        """One row for each evaluation; what is none, or cannot be read, is left out."""
        return list(self._rows())

    @property
    def has_any(self) -> bool:
        return any(True for _ in self._rows())

    def film(self, name: str, film: str) -> bytes:
        """A film of an evaluation; Refusal where there is no such one."""
        for path in films_of(self._paths().get(name)):
            if path.name == film:
                return path.read_bytes()
        raise Refusal(HTTPStatus.NOT_FOUND, f"there is no film {film[:80]} of {name[:80]} any more: open the page of results again")

    def _paths(self) -> dict[str, Path]:
        """The files of results by name."""
        if self._folder is None:
            return {}
        whole = {path.parent.name: path for path in sorted(self._folder.glob("*/result.json"))}
        return {path.stem: path for path in sorted(self._folder.glob("*.json"))} | whole

    def _rows(self) -> Iterator[dict[str, Any]]:
        for name, path in self._paths().items():
            try:
                found = read_result(path)
            except ValueError:
                continue
            if is_evaluation(found):
                command = found.get("provenance", {}).get("command")
                about = {"name": name, "deviation_cm": found["deviation_cm"].get("median"), "command": command}
                yield {key: found.get(key) for key in NAMES} | about | {"films": [film.name for film in films_of(path)]}


def films_of(result: Path | None) -> list[Path]:
    """The films beside a result."""
    if result is None:
        return []
    folder = result.parent if result.name == "result.json" else result.with_suffix("")
    return sorted(path for path in folder.glob("*.mp4") if path.is_file())
