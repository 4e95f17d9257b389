"""What is wanted: a place on the table, a picture that came from the page, a frame of a recording, or what the camera sees now.

Each becomes a `Goal`, which the page names by its number. The last `MOST_GOALS` are remembered.
"""

import itertools
import threading
from collections import OrderedDict
from dataclasses import dataclass, replace
from http import HTTPStatus
from typing import Any, Literal

import numpy as np

from preimage.data.decoding import NotShown, picture
from preimage.data.view import look
from preimage.records import Percept, Scene
from preimage.studio.opened import OpenedRun
from preimage.studio.pictures import inline
from preimage.studio.problems import Refusal
from preimage.studio.recordings import Recordings
from preimage.studio.table import Table

MOST_GOALS = 64
"""Goals that are remembered, each of two small frames."""
MOST_SEEDS = 2**31
"""Scenes are drawn by seeds below this."""


@dataclass(frozen=True, eq=False)
class Goal:
    """A start and what is wanted, ready to be planned to."""

    kind: Literal["place", "picture", "frame", "current"]
    words: str
    """Where it comes from."""
    start: Percept
    goal: Percept
    scene: Scene | None = None
    """Where a plan can be executed on the table."""
    is_judged: bool = False
    """Whether the scene knows where the goal is, so that a deviation can be measured."""
    source: str | None = None
    """How the command line names it, where it does; its episode begins at the start."""
    number: int = 0
    """By which the page names it."""

    def described(self, run: OpenedRun) -> dict[str, Any]:
        """As the page gets it."""
        assert self.start.frame is not None, "a start is seen"
        assert self.goal.frame is not None, "a goal is a picture"
        about = {"id": self.number, "kind": self.kind, "words": self.words, "executable": self.scene is not None}
        about |= {"start": inline(self.start.frame), "goal": inline(self.goal.frame), "place": None}
        if run.table and self.scene and self.is_judged:
            at = run.table.camera.project(np.array(self.scene.positions_m[run.table.goal_name]))
            about["place"] = at.tolist()
        return about


class Goals:
    """The goals that are remembered, and the ways to a new one."""

    def __init__(self, run: OpenedRun, recordings: Recordings) -> None:
        self._run, self._recordings = run, recordings
        self._goals: OrderedDict[int, Goal] = OrderedDict()
        self._numbers = itertools.count(1)
        self._lock, self._decoding = threading.Lock(), threading.Lock()

    def find(self, number: int) -> Goal:
        """Raises Refusal where it is not remembered."""
        with self._lock:
            if number not in self._goals:
                raise Refusal(HTTPStatus.NOT_FOUND, "this goal is not remembered any more: choose one again")
            return self._goals[number]

    def at_place(self, seed: int, seen: tuple[float, float]) -> Goal:
        """The goal at a place of the table's picture.

        Raises:
            ValueError: the arm does not get there.
            Refusal: there is no table.
        """
        table = self._table()
        scene = table.with_goal_at(table.scene(seed), seen)
        x, y, _ = scene.positions_m[table.goal_name]
        words = f"a place {100 * x:.0f} cm from the near edge, {100 * abs(y):.0f} cm to the {'left' if y >= 0 else 'right'}"
        return self._keep(Goal("place", words, table.start(scene), table.goal(scene), scene, is_judged=True))

    def of_picture(self, content: bytes, name: str, seed: int) -> Goal:
        """The goal that a picture shows.

        Raises:
            ValueError: it is no picture, or has other proportions than the recordings.
        """
        sensors = self._run.sensors
        with self._decoding:  # one at a time, for unpacked it takes a hundred times as much
            try:
                whole = picture(content)
            except NotShown as error:
                raise ValueError(f"{name} is not an image that can be read: it {error}") from error
            frame = np.array(look(whole, self._run.view, name))  # a copy: the whole picture is let go of
        if frame.shape[-1] != sensors.channels:
            raise ValueError(f"{name} has {frame.shape[-1]} channels, the model sees {sensors.channels}: give a picture of the same kind")
        start, scene = self._start_of(seed)
        return self._keep(Goal("picture", f"the picture {name}", start, Percept(frame), scene, source=None if scene else name))

    def of_frame(self, data: str, episode: int, step: int) -> Goal:
        """The goal that a frame of a recording shows, from where its episode begins.

        Raises:
            ValueError: there is no such episode or step.
        """
        recorded = self._recordings.demonstration(data, episode)
        if not 0 <= step < len(recorded):
            raise ValueError(f"episode {episode} has steps 0 to {len(recorded) - 1}, not {step}")
        table, scene = self._run.table, recorded.scene
        is_here = table is not None and scene is not None and scene.task == table.task.name
        source = f"{self._recordings.folder(data)}:{episode}:{step}"
        words = f"step {step} of episode {episode} of {data}"
        is_last = step == len(recorded) - 1
        wanted = Goal("frame", words, recorded.first, recorded[step], scene if is_here else None, is_here and is_last, source)
        return self._keep(wanted)

    def of_now(self, frame: np.ndarray | None, seed: int) -> Goal:
        """The goal of getting to what the camera sees now: the frame after an execution, else the start."""
        start, scene = self._start_of(seed)
        return self._keep(Goal("current", "what the camera sees now", start, Percept(start.frame if frame is None else frame), scene))

    def start(self, seed: int) -> dict[str, Any]:
        """What the camera sees before anything is wanted, as the page gets it."""
        table = self._run.table
        start, scene = self._start_of(seed)
        assert start.frame is not None, "a start is seen"
        large = inline(table.large(scene)) if table and scene else None
        return {"seed": seed, "start": inline(start.frame), "large": large}

    def _start_of(self, seed: int) -> tuple[Percept, Scene | None]:
        table = self._run.table
        if table is None:
            from preimage.network.inputs import home

            return home(self._run.planner("paper").model), None
        scene = table.scene(seed)
        return table.start(scene), scene

    def _table(self) -> Table:
        if self._run.table is None:
            raise Refusal(HTTPStatus.NOT_FOUND, "this run has no simulated table: give its goal as a picture or a frame of a recording")
        return self._run.table

    def _keep(self, goal: Goal) -> Goal:
        with self._lock:
            goal = replace(goal, number=next(self._numbers))
            self._goals[goal.number] = goal
            while len(self._goals) > MOST_GOALS:
                self._goals.popitem(last=False)
            return goal
