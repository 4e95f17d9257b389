"""How a plan is carried out where something may go wrong: blind, predicting a step ahead, or planning anew, all through the same robot."""

import itertools
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from preimage.evaluation.loops import Disturbed, Loop
from preimage.presets import Planner, ReplanConfig
from preimage.records import Demonstration, Percept, Plan, Scene, Trial
from preimage.robot import Arm, Task
from preimage.robot.disturbances import Disturbance, disturbance_of
from preimage.robot.move_object import HALF_OPEN_M
from preimage.robot.protocol import drive
from preimage.robot.simulated import SimulatedRobot

PATIENCE = 2
"""A loop ends after so many times the steps that are imagined to each goal, in any case."""


@dataclass(frozen=True, eq=False)
class Command:
    """What is decided by a loop that believes nothing."""

    command: Float[np.ndarray, " J"]
    done: bool


@dataclass(frozen=True, eq=False)
class Circumstances:
    """What may go wrong, and what is done about it."""

    disturb: Disturbed | None = None
    other: Demonstration | None = None
    """To whose goal the goal is changed."""
    seed: tuple[int, ...] = (0,)
    settings: ReplanConfig | None = None
    then: tuple[Percept, ...] = ()
    """Goals after that of the plan, for a loop that plans anew."""
    clock: Callable[[], float] = time.process_time
    """By default the processor's time: how much is thought must not depend on what else a machine computes meanwhile."""

    def disturbance(self, scene: Scene, found: Plan) -> Disturbance:
        """The disturbance of a trial, half way along its plan."""
        if self.disturb is None:
            return Disturbance()
        half = half_way(found)
        closed = np.flatnonzero(found.joints[:, -1] < HALF_OPEN_M) if "object" in scene.positions_m else np.zeros(0)
        grasp = max(1, int(closed[0]) // 2) if len(closed) else half
        other = self.other.scene if self.other else None
        return disturbance_of(self.disturb, scene, half=half, grasp=grasp, seed=self.seed, other=other)


def half_way(found: Plan) -> int:
    """The step at which half of the way is behind the arm."""
    return max(1, found.arrival_step // 2)


def try_out(
    planner: Planner | None, found: Plan, arm: Arm, task: Task, scene: Scene, loop: Loop, circumstances: Circumstances
) -> tuple[Trial, tuple[Any, ...]]:
    """Carry a plan out in one of the loops, in some circumstances; with what a loop that plans anew believed at each step.

    Args:
        planner: the network that planned; a plan that is played blind needs none.

    Raises:
        ValueError: the loop needs no robot (`recorded`), or the disturbance cannot happen in this scene.
    """
    disturbance = circumstances.disturbance(scene, found)
    robot = SimulatedRobot(arm, task, scene, rate_hz=found.rate_hz, disturbance=disturbance)
    deciders = {"closed": play_back, "open": predict, "replan": plan_anew}
    if loop not in deciders:
        raise ValueError(f"--loop {loop} plays what was recorded, where nothing can go wrong: give {', '.join(deciders)}")
    decide = deciders[loop](planner, found, circumstances)
    driven = drive(robot, decide, period_s=1 / found.rate_hz, most_steps=PATIENCE * len(found) * (1 + len(circumstances.then)))
    return robot.finish(driven.limited), tuple(driven.decisions) if loop == "replan" else ()


def play_back(planner: Planner | None, found: Plan, circumstances: Circumstances) -> Callable[[Percept], Command]:
    """The plan, whatever is sensed."""
    rows = iter(range(1, found.arrival_step + 1))

    def decide(percept: Percept) -> Command:
        row = next(rows, found.arrival_step)
        return Command(found.joints[row], done=row >= found.arrival_step)

    return decide


def predict(planner: Planner | None, found: Plan, circumstances: Circumstances) -> Callable[[Percept], Command]:
    """One-step prediction under the plan's intention; where no frame came, from the last one."""
    assert planner is not None
    policy, last, steps = planner.follow(found), found.start.frame, iter(range(1, len(found)))

    def decide(percept: Percept) -> Command:
        nonlocal last
        last = last if percept.frame is None else percept.frame
        return Command(policy(Percept(last, percept.joints)), done=next(steps) == len(found) - 1)

    return decide


def plan_anew(planner: Planner | None, found: Plan, circumstances: Circumstances) -> Callable[[Percept], Any]:
    """Replanning, and the goal changed half way where that is the disturbance."""
    assert planner is not None
    goals = [found.goal, *circumstances.then]
    replanner = planner.replanner(goals=goals, settings=circumstances.settings, found=found, clock=circumstances.clock)
    half, steps = half_way(found), itertools.count()

    def decide(percept: Percept) -> Any:
        if next(steps) == half and circumstances.disturb == "goal":
            assert circumstances.other is not None
            replanner.change_goal(replace(found.goal, frame=circumstances.other.last.frame))
        return replanner(percept)

    return decide
