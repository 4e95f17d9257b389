"""The data sets that the studio was given: their episodes, films locked to joint curves, and what `preimage check` finds in them.

The page names a data set by the name of its folder; no path comes from it. What was read is remembered for the last few episodes.
"""

import threading
from collections import OrderedDict
from collections.abc import Sequence
from http import HTTPStatus
from pathlib import Path
from typing import Any

import numpy as np

from preimage.data.dataset import describe, episode_numbers, load, read_episodes, written_here
from preimage.data.view import View
from preimage.examination import Examination, examine
from preimage.records import Demonstration
from preimage.studio.pictures import strip, text_of
from preimage.studio.problems import Refusal

MOST_REMEMBERED = 8
"""Episodes that stay read; one of 300 steps of 64 x 64 in colour takes 4 MB."""
MOST_SHOWN = 240
"""Frames of an episode that the page gets, evenly chosen: a picture of more would be refused by browsers."""


class Recordings:
    """Data sets by name.

    Args:
        folders: of the data sets.
        view: how the run looks at recordings; those of other joints are looked at as a whole.

    Raises:
        ValueError: a folder is no data set, or two have the same name.
    """

    def __init__(self, folders: Sequence[Path], view: View) -> None:
        self._folders = {folder.resolve().name: folder for folder in folders}
        if len(self._folders) < len(folders):
            raise ValueError(f"two of the data sets have the same name ({', '.join(self._folders)}): rename one, or leave it out")
        self.descriptions = {name: describe(folder) for name, folder in self._folders.items()}
        self._views = {
            name: view if set(view.joints or ()) <= set(about.joint_names) else View() for name, about in self.descriptions.items()
        }
        self._read: OrderedDict[tuple[str, int], Demonstration] = OrderedDict()
        self._examined: dict[str, Examination] = {}
        self._lock = threading.Lock()

    def folder(self, name: str) -> Path:
        """Raises Refusal where the studio was not given such a data set."""
        if name not in self._folders:
            known = ", ".join(self._folders) or "none: start the studio with --data"
            raise Refusal(HTTPStatus.NOT_FOUND, f"there is no data set {name[:80]}; there is {known}")
        return self._folders[name]

    def demonstration(self, name: str, episode: int) -> Demonstration:
        """An episode, as the run looks at recordings.

        Raises:
            ValueError: it is not there, is damaged, or does not fit the run's view.
        """
        folder = self.folder(name)
        with self._lock:
            if (name, episode) not in self._read:
                if episode not in episode_numbers(folder):
                    raise ValueError(f"{name} has no episode {episode}")
                self._read[name, episode] = load(folder, view=self._views[name], only=(episode,))[0]
                while len(self._read) > MOST_REMEMBERED:
                    self._read.popitem(last=False)
            self._read.move_to_end((name, episode))
            return self._read[name, episode]

    def seen_by(self, view: View, name: str, episode: int) -> Demonstration:
        """An episode as another run looks at recordings; ValueError where it does not fit that."""
        return load(self.folder(name), view=view, only=(episode,))[0]

    def listed(self) -> list[dict[str, Any]]:
        """The data sets as the page gets them."""
        return [
            {
                "name": name,
                "folder": str(self._folders[name]),
                "episodes": list(episode_numbers(self._folders[name])),
                "rate_hz": about.rate_hz,
                "version": about.version,
            }
            for name, about in self.descriptions.items()
        ]

    def episode(self, name: str, episode: int) -> dict[str, Any]:
        """An episode as the page gets it: a strip of frames, and the joints of the same steps."""
        recorded = self.demonstration(name, episode)
        steps = np.unique(np.linspace(0, len(recorded) - 1, min(len(recorded), MOST_SHOWN)).round().astype(int))
        return {
            "episode": episode,
            "steps": steps.tolist(),
            "height": recorded.frames.shape[1],
            "width": recorded.frames.shape[2],
            "rate_hz": recorded.rate_hz,
            "film": text_of(strip(recorded.frames[steps])),
            "joints": recorded.joints[steps].round(4).tolist(),
            "joint_names": list(recorded.joint_names),
        }

    def findings(self, name: str) -> dict[str, Any]:
        """What `preimage check` finds in a data set."""
        folder = self.folder(name)
        with self._lock:
            if name not in self._examined:
                self._examined[name] = examine(read_episodes(folder), joints_chosen=written_here(folder))
        examined = self._examined[name]
        found = [
            {
                "severity": one.severity.value, "kind": one.kind.value, "what": one.what, "help": one.help,
                "episodes": list(one.episodes), "places": [list(place) for place in one.places],
            }
            for one in examined.findings
        ]  # fmt: skip
        return {"verdict": examined.verdict, "findings": found}
