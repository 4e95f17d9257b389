"""Trainings: run folders whose logs are read as they grow and whose checkpoints are looked at; the page begins, stops and resumes them."""

import threading
from collections.abc import Sequence
from http import HTTPStatus
from pathlib import Path
from typing import Any

from preimage.records import Demonstration
from preimage.storage.run_files import HELD_OUT, LOG, WEIGHTS
from preimage.storage.runs import part_of, read_config, read_log, read_view
from preimage.studio.pictures import strip, text_of
from preimage.studio.problems import Refusal
from preimage.studio.recordings import Recordings
from preimage.studio.trainer import Trainer

MOST_POINTS = 400
"""Updates that the page gets of a training: more are not to be told apart on a screen."""
RECENT = 20
"""Updates whose mean duration says how long the rest takes."""


class Trainings:
    """Run folders by name.

    Args:
        folders: run folders, or folders of them.
        recordings: data sets to learn from.
        into: folder for new runs, where none of `folders` is one of runs.
    """

    def __init__(self, folders: Sequence[Path], recordings: Recordings, *, into: Path) -> None:
        self._into = next((folder for folder in folders if not is_run(folder)), into)
        self._folders = (*folders, self._into)
        self._recordings, self.trainer = recordings, Trainer()
        self._films: dict[Path, tuple[int, dict[str, Any]]] = {}
        self._lock = threading.Lock()

    @property
    def has_any(self) -> bool:
        return bool(self._runs() or self._recordings.descriptions)

    def begin(self, data: str, name: str, *, size: str, preset: str, updates: int) -> dict[str, Any]:
        """Train a new run on a data set that the studio was given; Refusal where that cannot be."""
        there = self._runs().get(name)
        if there is not None and (is_run(there) or self.trainer.state(there)[0] == "running"):
            raise Refusal(HTTPStatus.CONFLICT, f"there is a run {name} already: choose another name, or resume it")
        folder = self.trainer.begin(self._recordings.folder(data), self._into, name, size=size, preset=preset, updates=updates)
        return {"name": name, "folder": str(folder)}

    def resume(self, name: str) -> dict[str, Any]:
        """Go on with a run on the data it learned from; Refusal where the studio was not given them, or somebody writes it."""
        folder = self._folder(name)
        self.trainer.resume(self._recordings.folder(str(part_of(read_config(folder), "data").get("name"))), folder)
        return self.described(name)

    def stop(self, name: str) -> dict[str, Any]:
        """Stop a training that the page started; Refusal where it is another."""
        self.trainer.stop(self._folder(name))
        return self.described(name)

    def listed(self) -> list[dict[str, Any]]:
        """The runs there are now, as the page gets them."""
        return [self.described(name) for name in self._runs()]

    def described(self, name: str) -> dict[str, Any]:
        """How far a training is, and its errors so far; Refusal where there is no such run."""
        folder = self._folder(name)
        config = read_config(folder) if is_run(folder) else {}
        lines, unseen = (errors_in(folder, name) for name in (LOG, HELD_OUT))
        wanted = part_of(config, "train").get("updates")
        done = lines[-1]["update"] if lines else 0
        recent = [line["seconds"] for line in lines[-RECENT:]]
        left_s = sum(recent) / len(recent) * max(0, wanted - done) if recent and isinstance(wanted, int) else None
        shown = lines[:: max(1, len(lines) // MOST_POINTS)]
        state, words = self.trainer.state(folder)
        if state == "stopped" and not is_run(folder):
            words = "before there was anything to resume: begin it again"
        weights = folder / WEIGHTS
        about = {"name": name, "updates": wanted, "done": done, "left_s": left_s, "state": state, "words": words}
        about["weights"] = str(weights.stat().st_mtime_ns) if weights.is_file() else None
        about["resumable"] = done < (wanted or 0) and part_of(config, "data").get("name") in self._recordings.descriptions
        return about | series(shown) | {"held_out": series(unseen)}

    def film(self, name: str) -> dict[str, Any]:
        """The first training sequence as the last checkpoint regenerates it, beside what was recorded; Refusal where there is none."""
        folder = self._folder(name)
        if not (folder / WEIGHTS).is_file():
            raise Refusal(HTTPStatus.NOT_FOUND, f"{name} has no checkpoint yet: wait for the first")
        stamp = (folder / WEIGHTS).stat().st_mtime_ns
        with self._lock:
            kept = self._films.get(folder)
            if kept is None or kept[0] != stamp:
                kept = self._films[folder] = stamp, self._regenerated(folder) | {"weights": str(stamp)}
            return kept[1]

    def _regenerated(self, folder: Path) -> dict[str, Any]:
        from preimage.data.sequences import at_rate
        from preimage.storage.networks import load_model
        from preimage.studio.intentions import regenerate_first

        model, shown = load_model(folder), self._first_shown(folder)
        shown = None if shown is None else at_rate(shown, model.config.rate_hz)
        frames = regenerate_first(model, None if shown is None else shown.first)
        recorded = None if shown is None else text_of(strip(shown.frames))
        return {"height": frames.shape[1], "width": frames.shape[2], "film": text_of(strip(frames)), "recorded": recorded}

    def _first_shown(self, folder: Path) -> Demonstration | None:
        """The first demonstration that a run learned from, where the studio was given its data and they can be read as they were."""
        learned_from = part_of(read_config(folder), "data")
        left_out = learned_from.get("held_out", [])
        episodes = [episode for episode in learned_from.get("episodes", []) if episode not in left_out]
        if learned_from.get("name") not in self._recordings.descriptions or not episodes:
            return None
        return self._recordings.seen_by(read_view(folder), learned_from["name"], episodes[0])

    def _folder(self, name: str) -> Path:
        """Raises Refusal where there is no such run."""
        folder = self._runs().get(name)
        if folder is None:
            raise Refusal(HTTPStatus.NOT_FOUND, f"there is no run {name[:80]} in the folders that the studio was given by --runs")
        return folder

    def _runs(self) -> dict[str, Path]:
        there = [path for folder in self._folders for path in (folder, *sorted(folder.glob("*"))) if is_run(path)]
        return {path.resolve().name: path for path in (*self.trainer.folders, *there)}  # one that just begins has written nothing yet


def is_run(folder: Path) -> bool:
    return (folder / "config.json").is_file()


def errors_in(folder: Path, name: str) -> list[dict[str, Any]]:
    """The lines of one of a run's logs; none where it has not begun."""
    try:
        return read_log(folder, name=name)
    except ValueError:
        return []


def series(lines: Sequence[dict[str, Any]]) -> dict[str, list[float]]:
    """Both errors, and the updates they are of."""
    return {key: [line[key] for line in lines] for key in ("update", "visual", "proprioceptive")}
