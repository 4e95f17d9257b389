"""How often plans arrive: trials on goals that were never shown, counted with an interval, beside what luck would give.

A success rate alone says little. Two baselines stand beside it: the arm that does nothing, and the arm that replays the demonstration
whose last frame looks most like the goal.

>>> [round(100 * bound) for bound in wilson_interval(84, 100)]
[76, 90]
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from preimage.execution import execute, play
from preimage.model import PDVMRNN
from preimage.planning import PlanConfig, imagine_library, plan
from preimage.records import Demonstration, Percept, Plan, Scene, Shown, Trial
from preimage.robot import Arm, Task, record
from preimage.sequences import at_rate


@dataclass(frozen=True)
class Row:
    """What became of one goal."""

    goal: int
    deviation_cm: float
    success: bool
    arrival_step: int
    """Step of the plan at which the goal is imagined."""
    demonstration_steps: int
    """Steps that the tutor took to the same goal, at the plan's rate."""
    error: float
    """Prediction error of the plan."""
    seconds: float
    """Wall time of planning."""
    stopped: str
    limited: tuple[str, ...]


@dataclass(frozen=True)
class Count:
    """k successes among n trials."""

    success: int
    goals: int
    success_rate: float
    interval: tuple[float, float]
    """Wilson interval, 95 %."""
    deviation_cm: dict[str, float]
    """mean, median and max"""


@dataclass(frozen=True, eq=False)
class Evaluated:
    """One goal with its plan, its trial and the baselines' trials."""

    demonstration: Demonstration
    """What the tutor did; the planner saw its first percept and its last frame."""
    plan: Plan
    trial: Trial
    do_nothing: Trial
    nearest_demonstration: Trial


def wilson_interval(successes: int, trials: int, z: float = 1.959964) -> tuple[float, float]:
    """The 95 % interval of a success rate (Wilson 1927).

    Raises:
        ValueError: there is no trial.
    """
    if trials < 1:
        raise ValueError(f"an interval needs 1 trial or more, there are {trials}")
    rate, spread = successes / trials, z**2 / trials
    centre = (rate + spread / 2) / (1 + spread)
    half = z / (1 + spread) * (rate * (1 - rate) / trials + spread / (4 * trials)) ** 0.5
    return max(0.0, centre - half), min(1.0, centre + half)


def evaluate(
    model: PDVMRNN,
    arm: Arm,
    task: Task,
    *,
    goals: int,
    seed: int,
    shown: Sequence[Shown],
    config: PlanConfig | None = None,
    progress: Callable[[Evaluated], None] | None = None,
) -> list[Evaluated]:
    """Plan to goals that a tutor reached, execute blind in physics and judge.

    Args:
        goals: how many.
        seed: draws the goals; not the one the demonstrations were recorded with.
        shown: the demonstrations the model was trained on, for the baseline that replays one of them.
        progress: called after each goal.
    """
    config = config or PlanConfig()
    library = imagine_library(model, config=config)
    evaluated = []
    for demonstration in record(arm, task, count=goals, seed=seed):
        assert demonstration.scene is not None
        found = plan(model, start=demonstration.first, goal=goal_of(demonstration, config), config=config, library=library)
        one = Evaluated(
            demonstration=demonstration,
            plan=found,
            trial=execute(found, arm, demonstration.scene),
            do_nothing=play(demonstration.joints[:1], demonstration.rate_hz, arm, demonstration.scene),
            nearest_demonstration=replay_nearest(shown, demonstration.last, arm, demonstration.scene),
        )
        evaluated.append(one)
        if progress:
            progress(one)
    return evaluated


def goal_of(demonstration: Demonstration, config: PlanConfig) -> Percept:
    """The last percept, without the modalities that the planner is not to see."""
    last = demonstration.last
    return Percept(last.frame if config.goal != "joints" else None, last.joints if config.goal != "vision" else None)


def replay_nearest(shown: Sequence[Shown], goal: Percept, arm: Arm, scene: Scene) -> Trial:
    """Execute the demonstration whose last frame is nearest to the goal's, pixel by pixel."""
    assert goal.frame is not None
    wanted = goal.frame.astype(float)
    distances = [np.square(one.last_frame - wanted).sum() for one in shown]
    nearest = shown[int(np.argmin(distances))]
    return play(nearest.joints, nearest.rate_hz, arm, scene)


def row_of(index: int, one: Evaluated) -> Row:
    return Row(
        goal=index,
        deviation_cm=round(100 * one.trial.deviation_m, 3),
        success=one.trial.success,
        arrival_step=one.plan.arrival_step,
        demonstration_steps=len(at_rate(one.demonstration, one.plan.rate_hz)) - 1,
        error=one.plan.error,
        seconds=round(one.plan.seconds, 3),
        stopped=one.plan.stopped.name.lower(),
        limited=one.trial.limited,
    )


def count(trials: Sequence[Trial]) -> Count:
    deviations = np.array([100 * trial.deviation_m for trial in trials])
    successes = sum(trial.success for trial in trials)
    spread = {"mean": deviations.mean(), "median": np.median(deviations), "max": deviations.max()}
    return Count(
        success=successes,
        goals=len(trials),
        success_rate=successes / len(trials),
        interval=wilson_interval(successes, len(trials)),
        deviation_cm={name: round(float(value), 3) for name, value in spread.items()},
    )


def result_of(evaluated: Sequence[Evaluated], about: dict[str, Any]) -> dict[str, Any]:
    """The counts and rows of an evaluation, ready to be written as JSON.

    Args:
        about: what was evaluated and how: task, model, size, num_demonstrations, seed, loop and whatever else should be kept.
    """
    rows = [row_of(index, one) for index, one in enumerate(evaluated)]
    seconds = np.array([row.seconds for row in rows])
    return (
        about
        | asdict(count([one.trial for one in evaluated]))
        | {
            "seconds_per_plan": round(float(seconds.mean()), 3),
            "seconds_per_plan_max": round(float(seconds.max()), 3),
            "baselines": {
                "do_nothing": asdict(count([one.do_nothing for one in evaluated])),
                "nearest_demonstration": asdict(count([one.nearest_demonstration for one in evaluated])),
            },
            "rows": [asdict(row) for row in rows],
        }
    )
