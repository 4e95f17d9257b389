"""How often plans arrive: trials on goals that were never shown, counted with an interval, beside what luck would give.

A success rate alone says little. Beside it stand the arm that does nothing, the arm that replays the demonstration whose last frame looks
most like the goal, the arm that goes straight through the joints that memory expects, and the same model with no goal, its intention at
the prior mean.

>>> [round(100 * bound) for bound in wilson_interval(84, 100)]
[76, 90]
"""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from preimage.compute.processes import ProcessGroup
from preimage.data.joint_range import nearest_in_range
from preimage.data.sequences import at_rate
from preimage.evaluation.loops import Disturbed, Loop
from preimage.evaluation.trials import Circumstances, try_out
from preimage.presets import Planner, ReplanConfig
from preimage.records import Demonstration, Percept, Plan, Shown, Trial
from preimage.robot import Arm, Task, record, succeeds_within
from preimage.robot.execution import execute, execute_open_loop, play

PIXEL_M = 0.013
"""A pixel of the paper's camera (m)."""
Policies = Mapping[str, Callable[[Percept], Callable[[Percept], Float[np.ndarray, " J"]]]]
"""Other ways to go to a goal: from the goal to a policy that is given what is sensed, step by step."""


@dataclass(frozen=True)
class Row:
    """What became of one goal."""

    goal: int
    deviation_cm: float
    success: bool
    arrival_step: int
    """Step of the plan at which the goal is imagined."""
    demonstration_steps: int
    """Steps that the demonstrator took to the same goal, at the plan's rate."""
    error: float
    """Prediction error of the plan."""
    seconds: float
    """Wall time of planning."""
    stopped: str
    limited: tuple[str, ...]
    details: dict[str, float]
    """What else the judge saw."""
    held: str | None = None
    """Why a loop that plans anew held the robot, if it did."""
    step_seconds: tuple[float, ...] = ()
    """The processor's time for each step of a loop that plans anew, the first excepted, before which a plan is made."""
    doubts: tuple[float, ...] = ()
    """What was sensed and not imagined, at each of its steps, as a share of the error of staying at the start."""


@dataclass(frozen=True, eq=False)
class Evaluated:
    """One goal with its plan, its trial and the baselines' trials."""

    demonstration: Demonstration
    """What the demonstrator did; the planner saw the first percept of it and the last frame."""
    plan: Plan
    trial: Trial
    baselines: Mapping[str, Trial]
    beliefs: tuple[Any, ...] = ()
    """What was believed at each step of a loop that plans anew (`ideas.replanning.Belief`)."""


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
    planner: Planner,
    arm: Arm,
    task: Task,
    *,
    goals: int,
    seed: int,
    shown: Sequence[Shown],
    loop: Loop = "closed",
    policies: Policies | None = None,
    disturb: Disturbed | None = None,
    replan: ReplanConfig | None = None,
    with_baselines: bool = True,
    progress: Callable[[Evaluated], None] | None = None,
    group: ProcessGroup = ProcessGroup(),  # noqa: B008, frozen
) -> list[Evaluated]:
    """Plan to goals that a demonstrator reached, execute in physics and judge.

    Args:
        goals: how many.
        seed: draws the goals; not the one the demonstrations were recorded with.
        shown: the demonstrations the model was trained on, for the baseline that replays one of them.
        policies: more baselines, by name.
        disturb: what goes wrong half way (`robot.disturbances`).
        replan: how a loop that plans anew goes about it.
        with_baselines: whether what would have been reached otherwise is executed too.
        progress: called after each goal of this process.
        group: the processes that share the goals; each gets the results of all.

    Raises:
        ProcessLost: another process of the group is no longer there.
    """
    recorded, evaluated = record(arm, task, count=goals, seed=seed), dict[int, Evaluated]()
    for goal in group.share(goals).tolist():
        demonstration = recorded[goal]
        found = planner.plan(start=demonstration.first, goal=goal_of(demonstration, planner))
        beliefs = ()
        if disturb or loop == "replan":
            assert demonstration.scene is not None
            circumstances = Circumstances(disturb, recorded[(goal + 1) % goals], (seed, goal), replan)
            trial, beliefs = try_out(planner, found, arm, task, demonstration.scene, loop, circumstances)
        else:
            trial = carry_out(planner, found, arm, task, demonstration, loop)
        baselines = baselines_of(planner, arm, task, demonstration, found, shown, policies or {}) if with_baselines else ()
        evaluated[goal] = Evaluated(demonstration, found, trial, dict(baselines), beliefs)
        if progress:
            progress(evaluated[goal])
    return group.gather(evaluated)


def carry_out(
    planner: Planner, found: Plan, arm: Arm, task: Task, demonstration: Demonstration, loop: Loop, *, filmed: bool = True
) -> Trial:
    """Execute a plan in one of the loops, filmed or, where the loop is blind, not."""
    assert demonstration.scene is not None
    if loop == "closed":
        return execute(found, arm, demonstration.scene, task=task, filmed=filmed)
    policy = planner.follow(found)
    if loop == "recorded":
        recorded = at_rate(demonstration, found.rate_hz)
        joints = np.stack([recorded.joints[0], *(policy(recorded[step]) for step in range(len(recorded) - 1))])
        return play(joints, found.rate_hz, arm, demonstration.scene, task=task, filmed=filmed)
    num_steps = len(found) - 1
    return execute_open_loop(policy, arm, demonstration.scene, num_steps=num_steps, rate_hz=found.rate_hz, task=task)


def baselines_of(
    planner: Planner,
    arm: Arm,
    task: Task,
    demonstration: Demonstration,
    found: Plan,
    shown: Sequence[Shown],
    policies: Policies,
) -> Iterator[tuple[str, Trial]]:
    """What would have been reached otherwise; of blind ones nobody looks at a film."""
    scene, num_steps = demonstration.scene, len(found)
    assert scene is not None
    yield "do_nothing", play(demonstration.joints[:1], demonstration.rate_hz, arm, scene, task=task, filmed=False)
    nearest = nearest_shown(shown, demonstration.last)
    yield "nearest_demonstration", play(nearest.joints, nearest.rate_hz, arm, scene, task=task, filmed=False)
    if found.expected_joints is not None:
        assert planner.memory is not None
        gripper = planner.memory.event_joint if len(found.expected_joints) > 1 else None
        straight = straight_through(np.vstack([demonstration.joints[:1], found.expected_joints]), num_steps, gripper=gripper)
        yield "memory_alone", play(straight, found.rate_hz, arm, scene, task=task, filmed=False)
    yield "prior_mean", execute(planner.imagine_without_goal(demonstration.first), arm, scene, task=task, filmed=False)
    for name, policy_to in policies.items():
        policy = policy_to(Percept(demonstration.last.frame))
        yield name, execute_open_loop(policy, arm, scene, num_steps=num_steps - 1, rate_hz=found.rate_hz, task=task)


def straight_through(points: Float[np.ndarray, "M J"], num_steps: int, *, gripper: int | None) -> Float[np.ndarray, "T J"]:
    """A way straight from each point to the next, in equally many steps each.

    Args:
        gripper: the joint that stays as it was until a point is reached, and then changes in one step.
    """
    legs = [points[:1]]
    for here, there in itertools.pairwise(points):
        reached = there.copy()
        if gripper is not None:
            reached[gripper] = here[gripper]
        legs += [np.linspace(here, reached, max(2, num_steps // (len(points) - 1)))[1:], there[None]]
    return np.concatenate(legs)


def goal_of(demonstration: Demonstration, planner: Planner) -> Percept:
    """The last percept, without the modalities that the planner is not to see; joints as near to it as it can imagine."""
    last, modalities = demonstration.last, planner.options.modalities
    goal = Percept(last.frame if modalities != "joints" else None, last.joints if modalities != "vision" else None)
    return nearest_in_range(goal, planner.model.sensors)


def nearest_shown(shown: Sequence[Shown], goal: Percept) -> Shown:
    """The demonstration whose last frame is nearest to the goal's, pixel by pixel."""
    assert goal.frame is not None
    wanted = goal.frame.astype(float)
    return shown[int(np.argmin([np.square(one.last_frame - wanted).sum() for one in shown]))]


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
        details=dict(one.trial.details),
        held=one.beliefs[-1].held if one.beliefs else None,
        step_seconds=tuple(round(belief.seconds, 4) for belief in one.beliefs[1:]),
        doubts=tuple(round(belief.doubt, 4) for belief in one.beliefs),
    )


def replanned(rows: Sequence[Row]) -> dict[str, Any]:
    """How long the steps of a loop that plans anew took (the processor's time), and how often it held the robot."""
    seconds = [each for row in rows for each in row.step_seconds]
    if not seconds:
        return {}
    median, late = np.quantile(seconds, (0.5, 0.99)).round(4).tolist()
    return {"held": sum(row.held is not None for row in rows), "seconds_per_step": {"median": median, "99 %": late, "max": max(seconds)}}


def count(trials: Sequence[Trial]) -> dict[str, Any]:
    """k successes in n trials with their interval, how far off they ended, and what else the judge saw."""
    deviations = np.array([100 * trial.deviation_m for trial in trials])
    spread = {"mean": deviations.mean(), "median": np.median(deviations), "max": deviations.max()}
    counted = share([trial.success for trial in trials])
    counted["deviation_cm"] = {name: round(float(value), 3) for name, value in spread.items()}
    if "touched" in trials[0].details:
        counted["touched"] = share([bool(trial.details["touched"]) for trial in trials])
    if "grasped" in trials[0].details:
        counted |= grasps(trials)
    return counted


def share(successes: Sequence[bool]) -> dict[str, Any]:
    """k of n with the Wilson interval."""
    k, n = sum(successes), len(successes)
    return {"success": k, "goals": n, "success_rate": k / n, "interval": wilson_interval(k, n)}


def grasps(trials: Sequence[Trial]) -> dict[str, Any]:
    """The rows of Table III: grasped at all, within a few pixels, and placed once grasped."""
    grasped = [trial for trial in trials if trial.details["grasped"]]
    rows: dict[str, Any] = {
        "within_pixels": {
            str(pixels): share([succeeds_within(trial.details, pixels * PIXEL_M) for trial in trials]) for pixels in (1, 2, 3)
        },
        "grasped": share([bool(trial.details["grasped"]) for trial in trials]),
        "grasp_error_cm_median": round(100 * float(np.median([trial.details["grasp_error_m"] for trial in trials])), 3),
    }
    if grasped:
        rows["placed_once_grasped"] = share([trial.success for trial in grasped])
        rows["placed_once_grasped_cm_mean"] = round(100 * float(np.mean([trial.details["place_error_m"] for trial in grasped])), 3)
    return rows


def result_of(evaluated: Sequence[Evaluated], about: dict[str, Any]) -> dict[str, Any]:
    """The counts and rows of an evaluation, ready to be written as JSON.

    Args:
        about: what was evaluated and how: task, model, size, num_demonstrations, seed, loop and whatever else should be kept.
    """
    rows = [row_of(index, one) for index, one in enumerate(evaluated)]
    seconds = np.array([row.seconds for row in rows])
    names = list(evaluated[0].baselines)
    return {
        **about,
        **replanned(rows),
        **count([one.trial for one in evaluated]),
        "seconds_per_plan": round(float(seconds.mean()), 3),
        "seconds_per_plan_max": round(float(seconds.max()), 3),
        "steps": {
            "plan": float(np.mean([row.arrival_step for row in rows])),
            "demonstration": float(np.mean([row.demonstration_steps for row in rows])),
        },
        "baselines": {name: count([one.baselines[name] for one in evaluated]) for name in names},
        "rows": [asdict(row) for row in rows],
    }
