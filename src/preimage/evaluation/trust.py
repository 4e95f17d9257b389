"""Trust, calibrated and examined: plans to goals of which it is known whether they are reached.

Three kinds of goals: those that are drawn as the demonstrations were; those on the rim, a little beyond, some of which are reached; and
pictures that nothing can be brought to. Those of the last that calibration sees are of other kinds than those it is examined by.

>>> roc_area(np.array([0.9, 0.8, 0.3]), np.array([True, False, False]))
1.0
>>> round(calibration_error(np.array([0.9, 0.9, 0.1, 0.1]), np.array([True, True, False, False])), 2)
0.1
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from preimage.evaluation.evaluate import nearest_shown, share
from preimage.evaluation.impossible import BENCH, PRACTICE, Source
from preimage.ideas.calibration import Calibration
from preimage.presets import Planner
from preimage.records import Demonstration, Percept, Plan, Scene, Shown
from preimage.robot import Arm, Task, record
from preimage.robot.execution import execute
from preimage.robot.rim import sample_rim, sense_ends

AREA, RIM = "area", "rim"
"""Goals drawn as those of the demonstrations, and goals beyond them."""
PRACTICE_SHARE = 4
"""For so many goals of the area there is one impossible picture to calibrate by."""
NUM_BINS = 10
"""Bins of the reliability diagram, of equal width."""
SAME_JOINTS_SHARE = 0.05
"""Where nothing can be executed, a plan has reached a recording if its last joints are, on average, nearer to it than so much of the
joints' ranges."""


@dataclass(frozen=True, eq=False)
class Assessed:
    """A goal, the plan to it, and what became of it."""

    kind: str
    """AREA, RIM, or the kind of an impossible picture."""
    plan: Plan
    reached: bool

    @property
    def is_possible(self) -> bool:
        return self.kind in (AREA, RIM)


Progress = Callable[[Assessed], None]


def goals_of_area(planner: Planner, arm: Arm, task: Task, recorded: Sequence[Demonstration]) -> Iterator[Assessed]:
    """Plans to goals that the demonstrator reached, executed."""
    for one in recorded:
        assert one.scene is not None
        yield carried_out(AREA, planner, arm, task, one.scene, one.first, one.last)


def goals_on_rim(planner: Planner, arm: Arm, task: Task, *, goals: int, seed: int) -> Iterator[Assessed]:
    """Plans to goals a little beyond the area of the demonstrations, executed."""
    for number in range(goals):
        scene = sample_rim(task, np.random.default_rng((seed, 1, number)))
        yield carried_out(RIM, planner, arm, task, scene, *sense_ends(arm, task, scene))


def carried_out(kind: str, planner: Planner, arm: Arm, task: Task, scene: Scene, start: Percept, goal: Percept) -> Assessed:
    """A plan to the picture of a goal, executed blind."""
    found = planner.plan(start=start, goal=Percept(goal.frame))
    return Assessed(kind, found, execute(found, arm, scene, task=task, filmed=False).success)


def practice_goals(planner: Planner, recorded: Sequence[Demonstration], *, goals: int, seed: int) -> Iterator[Assessed]:
    """Plans to impossible pictures, each kind of PRACTICE in turn, made of the last frames of recordings."""
    kinds = list(PRACTICE)
    for number in range(goals):
        kind, one = kinds[number % len(kinds)], recorded[number % len(recorded)]
        goal = PRACTICE[kind](one.last.frame, np.random.default_rng((seed, 2, number)))  # pyright: ignore[reportArgumentType]
        yield impossible(kind, planner, one.first, goal)


def bench_goals(planner: Planner, arm: Arm, task: Task, recorded: Sequence[Demonstration], *, goals: int, seed: int) -> Iterator[Assessed]:
    """Plans to impossible pictures of all twelve kinds, so many of each."""
    for number in range(goals):
        one = recorded[number % len(recorded)]
        assert one.scene is not None
        assert one.last.frame is not None
        for kind, make in BENCH.items():
            rng = np.random.default_rng((seed, 2, number))
            yield impossible(kind, planner, one.first, make(Source(arm, task, one.scene, one.first, one.last.frame, rng)))


def impossible(kind: str, planner: Planner, start: Percept, goal: np.ndarray) -> Assessed:
    return Assessed(kind, planner.plan(start=start, goal=Percept(np.ascontiguousarray(goal))), reached=False)


def calibrate(planner: Planner, arm: Arm, task: Task, *, goals: int, seed: int, progress: Progress | None = None) -> Calibration:
    """Learn what the planner's evidence means from goals of the area, as many on the rim and a quarter as many pictures.

    Args:
        goals: how many of the area.
        seed: draws all goals.
        progress: called after each goal.

    Raises:
        ValueError: there are too few goals.
    """
    recorded = record(arm, task, count=goals, seed=seed)
    assessed = [
        *told(goals_of_area(planner, arm, task, recorded), progress),
        *told(goals_on_rim(planner, arm, task, goals=goals, seed=seed), progress),
        *told(practice_goals(planner, recorded, goals=goals // PRACTICE_SHARE, seed=seed), progress),
    ]
    return calibration_of(assessed, planner)


def calibrate_by_recordings(
    planner: Planner, recorded: Sequence[Demonstration], *, seed: int, progress: Progress | None = None
) -> Calibration:
    """The same without a simulator, by recordings that were never trained on: a plan is taken to succeed that ends in the recorded joints.

    Raises:
        ValueError: there are too few recordings.
    """
    sensors = planner.model.sensors
    span = np.subtract(sensors.joint_upper, sensors.joint_lower)

    def compared() -> Iterator[Assessed]:
        for one in recorded:
            found = planner.plan(start=one.first, goal=Percept(one.last.frame))
            off = np.abs(found.joints[found.arrival_step] - one.joints[-1]) / span
            yield Assessed(AREA, found, bool(off.mean() < SAME_JOINTS_SHARE))

    number = max(1, len(recorded) // PRACTICE_SHARE)
    assessed = [*told(compared(), progress), *told(practice_goals(planner, recorded, goals=number, seed=seed), progress)]
    return calibration_of(assessed, planner)


def calibration_of(assessed: Sequence[Assessed], planner: Planner) -> Calibration:
    """What can be learned from goals that were planned to. Not to be refused are those of the area that were reached: to refuse one that
    the plan would have missed is right, and one such goal, if it is strange enough, would let pass all that is less strange. Where more of
    them are missed than reached, there are too few of these, and all of the area count."""
    evidence = [planner.assessment.evidence(one.plan) for one in assessed]
    reached, area = [one.reached for one in assessed], [one.kind == AREA for one in assessed]
    not_missed = [one.kind == AREA and one.reached for one in assessed]
    possible = not_missed if 2 * sum(not_missed) >= sum(area) else area
    made_with, ways = planner.options.calibrated_with(), planner.assessment
    return Calibration.of(evidence, reached, possible=possible, refusing=ways.refusing, likely_only=ways.likely_only, plan=made_with)


def examine(
    planner: Planner,
    arm: Arm,
    task: Task,
    *,
    goals: int,
    pictures: int,
    seed: int,
    progress: Progress | None = None,
) -> list[Assessed]:
    """Plans to goals of the area, three quarters as many on the rim, and impossible pictures of all twelve kinds.

    Args:
        goals: how many of the area; three quarters as many are on the rim.
        pictures: how many of each kind.
        seed: draws all goals; not one that anything was calibrated with.
    """
    recorded = record(arm, task, count=max(goals, pictures), seed=seed)
    return [
        *told(goals_of_area(planner, arm, task, recorded[:goals]), progress),
        *told(goals_on_rim(planner, arm, task, goals=goals * 3 // 4, seed=seed), progress),
        *told(bench_goals(planner, arm, task, recorded, goals=pictures, seed=seed), progress),
    ]


def told(goals: Iterator[Assessed], progress: Progress | None) -> Iterator[Assessed]:
    for one in goals:
        if progress:
            progress(one)
        yield one


def result_of_trust(assessed: Sequence[Assessed], shown: Sequence[Shown], about: Mapping[str, Any]) -> dict[str, Any]:
    """What trust was worth, ready to be written as JSON: beside it two baselines, the plan's error and the nearest demonstration.

    Args:
        shown: the demonstrations the model was trained on.
        about: what was examined and how: task, model, seed and whatever else should be kept.
    """
    possible = [one for one in assessed if one.is_possible]
    reached = np.array([one.reached for one in possible])
    scores = {name: np.array([score(one.plan, shown) for one in possible]) for name, score in SCORES.items()}
    kinds = list(dict.fromkeys(one.kind for one in assessed if not one.is_possible))
    probable = scores["trust"]
    return {
        **about,
        "kind": "trust",
        "success": {kind: share([one.reached for one in possible if one.kind == kind]) for kind in (AREA, RIM)},
        "roc_area": {name: rounded(roc_area(values, reached)) for name, values in scores.items()},
        "roc_area_interval": {name: bootstrap(values, reached) for name, values in scores.items()},
        "calibration_error": rounded(calibration_error(probable, reached)),
        "calibration_error_by_chance": rounded(error_by_chance(probable)),
        "mean_probability": rounded(float(probable.mean())),
        "refused": {kind: refusals([one for one in assessed if one.kind == kind]) for kind in kinds},
        "falsely_refused": refusals([one for one in possible if one.kind == AREA]),
        "refused_on_rim": refusals([one for one in possible if one.kind == RIM]),
        "rows": [row_of(one, shown) for one in assessed],
    }


def refusals(assessed: Sequence[Assessed]) -> dict[str, Any]:
    """k of n refused, with the Wilson interval."""
    counted = share([bool(one.plan.trust and one.plan.trust.refused) for one in assessed])
    return {"refused": counted["success"], "goals": counted["goals"], "interval": counted["interval"]}


def trust_in(plan: Plan) -> float:
    """The probability of success; of a plan that was not calibrated, what ranks it."""
    assert plan.trust is not None
    return -plan.trust.strangeness if plan.trust.probability is None else plan.trust.probability


def distance_to_demonstrations(plan: Plan, shown: Sequence[Shown]) -> float:
    """How far the goal's picture is from the nearest last frame of a demonstration (grey levels, root mean square)."""
    goal = plan.goal.frame
    assert goal is not None
    nearest = nearest_shown(shown, plan.goal).last_frame
    return float(np.sqrt(np.square(goal.astype(float) - nearest).mean()))


SCORES: dict[str, Callable[[Plan, Sequence[Shown]], float]] = {
    "trust": lambda plan, shown: trust_in(plan),
    "plan's error": lambda plan, shown: -plan.error,
    "nearest demonstration": lambda plan, shown: -distance_to_demonstrations(plan, shown),
}
"""What ranks plans: trust and its baselines, the larger the better."""


def row_of(one: Assessed, shown: Sequence[Shown]) -> dict[str, Any]:
    assert one.plan.trust is not None
    row: dict[str, Any] = {"kind": one.kind, "reached": one.reached}
    row |= {name: rounded(score(one.plan, shown)) for name, score in SCORES.items()}
    trust = one.plan.trust
    evidence = {name: rounded(value) for name, value in trust.evidence.items()}
    return row | {"refused": trust.refused, "reasons": trust.reasons, "strangeness": rounded(trust.strangeness), "evidence": evidence}


def roc_area(scores: Float[np.ndarray, " N"], reached: Bool[np.ndarray, " N"]) -> float:
    """How often a plan that succeeds is ranked above one that fails; a half where there is nothing to compare."""
    above = scores[reached][:, None] - scores[~reached]
    return float(((above > 0) + 0.5 * (above == 0)).mean()) if above.size else 0.5


def bootstrap(scores: Float[np.ndarray, " N"], reached: Bool[np.ndarray, " N"], *, draws: int = 1000) -> tuple[float, float]:
    """The 95 % interval of the area under the ROC, goals drawn anew with replacement."""
    rng = np.random.default_rng(0)
    rows = rng.integers(0, len(scores), (draws, len(scores)))
    areas = [roc_area(scores[row], reached[row]) for row in rows if 0 < reached[row].sum() < len(row)] or [0.5]
    return rounded(float(np.quantile(areas, 0.025))), rounded(float(np.quantile(areas, 0.975)))


def reliability(probability: Float[np.ndarray, " N"], reached: Bool[np.ndarray, " N"]) -> list[tuple[float, float, int]]:
    """Mean probability, share reached and number of goals of each bin, the bins being of equal width."""
    bins = np.minimum((probability * NUM_BINS).astype(int), NUM_BINS - 1)
    filled = [bins == number for number in range(NUM_BINS) if (bins == number).any()]
    return [(float(probability[rows].mean()), float(reached[rows].mean()), int(rows.sum())) for rows in filled]


def calibration_error(probability: Float[np.ndarray, " N"], reached: Bool[np.ndarray, " N"]) -> float:
    """The expected calibration error: mean difference of probability and share reached over the bins, each by its number of goals."""
    return sum(number * abs(mean - rate) for mean, rate, number in reliability(probability, reached)) / len(probability)


def error_by_chance(probability: Float[np.ndarray, " N"], *, draws: int = 1000) -> float:
    """The calibration error, on average, where every goal is reached exactly as likely as was said: so much the number of goals alone does.

    >>> error_by_chance(np.full(20, 0.8)) > 0.05 > 0.02 > error_by_chance(np.full(2000, 0.8)) > error_by_chance(np.ones(20))
    True
    """
    rng = np.random.default_rng(0)
    return float(np.mean([calibration_error(probability, rng.random(len(probability)) < probability) for _ in range(draws)]))


def rounded(value: float) -> float:
    return round(float(value), 5)
