"""A plan that is executed with eyes open, as a job: what is believed at every step, and what whoever looks on does to the arm meanwhile."""

import time
from typing import Any

from preimage.ideas.belief import Belief, Imagined
from preimage.network.coding import to_frames
from preimage.network.pdvmrnn import Generated
from preimage.records import Percept
from preimage.robot import Arm
from preimage.robot.disturbances import Disturbance
from preimage.robot.execution import Stage
from preimage.robot.protocol import drive
from preimage.robot.simulated import SimulatedRobot
from preimage.studio.jobs import Job, Jobs
from preimage.studio.opened import OpenedRun
from preimage.studio.pictures import inline, strip, text_of
from preimage.studio.planning import Planned, executed, on_table
from preimage.studio.table import Touch
from preimage.studio.touches import Seen, Touches, move_object, push, want

PATIENCE = 4
"""It ends after so many times the steps of the plan in any case: whoever pushes the arm keeps it from arriving."""
BELIEVED = ("step", "steps_left", "window_error", "goal_error", "unexplained", "doubt", "moved", "held", "num_imagined", "seconds")
"""Of a belief, what the page gets."""


class Walk:
    """One plan, executed step by step, beside the queue of plans: what it has to compute, the worker does between two steps of a search.

    Args:
        pace: how many times as fast as the robot it goes.

    Raises:
        Refusal: there is no table for it.
    """

    def __init__(self, run: OpenedRun, planned: Planned, jobs: Jobs, *, pace: float = 1.0) -> None:
        self._table, self._scene = on_table(run, planned)
        self._planner, self._planned, self._jobs, self._pace = run.planner(planned.preset), planned, jobs, pace
        self._arm = Arm()  # its own, so that the table can be looked at meanwhile
        self.touches = Touches(self._table.touches)
        self._happened: list[str] = []
        self._next_goal: Percept | None = None
        self._film_of: Generated | None = None
        self._is_judged, self._is_over = planned.goal.is_judged, False

    def go(self, job: Job) -> dict[str, Any]:
        """Go all the way; what became of it."""
        plan, self._step_ends_s = self._planned.plan, time.monotonic()
        happens = Disturbance(happens=lambda arm, stage, step: self._end_step(job, stage))
        robot = SimulatedRobot(self._arm, self._table.task, self._scene, rate_hz=plan.rate_hz, disturbance=happens)
        replanner = self._planner.replanner(goals=[self._planned.goal.goal], found=plan)

        def decide(percept: Percept) -> Belief:
            job.go_on()
            about = {}
            if self._next_goal is not None and self._next_goal.frame is not None:
                replanner.change_goal(self._next_goal)
                about, self._next_goal = {"goal": inline(self._next_goal.frame)}, None
            belief = self._jobs.errand(lambda: replanner(percept)).result()
            self._is_over = belief.done
            job.tell("step", **about, **self._described(belief, replanner.imagined, percept))
            return belief

        driven = drive(robot, decide, period_s=1 / plan.rate_hz, most_steps=PATIENCE * len(plan))
        trial, last = robot.finish(driven.limited), driven.decisions[-1]
        ended = "held" if last.held else "arrived" if last.done else "given up"
        return {"ended": ended, "why": last.held, "execution": executed(self._table, trial, is_judged=self._is_judged)}

    def _end_step(self, job: Job, stage: Stage) -> None:
        """Wait until the step is over, and let happen what was done meanwhile."""
        self._step_ends_s += 1 / (self._planned.plan.rate_hz * self._pace)
        job.rest(max(0.0, self._step_ends_s - time.monotonic()))
        job.go_on()
        self._step_ends_s = max(self._step_ends_s, time.monotonic())  # what thought for too long is not made up for
        for kind, seen in () if self._is_over else self.touches.taken():
            try:
                self._happened.append(self._do(stage, kind, seen))
            except ValueError as error:
                self._happened.append(str(error))

    def _do(self, stage: Stage, kind: Touch, seen: Seen) -> str:
        """What a person did, in words; ValueError where it cannot be done."""
        if kind == "push":
            return push(self._table, self._arm, stage, seen)
        if kind == "object":
            return move_object(self._table, self._arm, stage, seen)
        self._next_goal, words = want(self._table, stage, seen)
        self._is_judged = True
        return words

    def _described(self, belief: Belief, imagined: Imagined, percept: Percept) -> dict[str, Any]:
        """What is believed at a step, as the page gets it; the film only where another way is imagined than before."""
        about = {name: getattr(belief, name) for name in BELIEVED} | {"at": imagined.at, "arrival": imagined.arrival}
        about |= {"picture": inline(self._arm.seen_by(self._table.large_camera)), "happened": self._happened}
        about["hand"] = self._table.camera.project(self._arm.end_effector_m).round(4).tolist()
        about["seen"] = None if percept.frame is None else inline(percept.frame)
        self._happened = []
        if self._film_of is not imagined.generated:
            self._film_of = imagined.generated
            frames = to_frames(imagined.generated.pixels[0]).cpu().numpy()
            about |= {"film": text_of(strip(frames)), "way": self._table.way(imagined.joints).round(4).tolist()}
        return about
