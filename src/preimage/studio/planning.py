"""A plan as a job: what the page sees while it is searched for, what it gets at the end, and what happens when it is executed."""

import io
import shlex
import shutil
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from http import HTTPStatus
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from preimage.presets import PlanOptions, Preset
from preimage.records import NEAR_BELOW, REACHED_BELOW, Demonstration, GoalRefused, Plan, Scene, Trial, Verdict
from preimage.robot.limits import commands_of
from preimage.storage.plans import save_episode, write_commands
from preimage.storage.recordings import save
from preimage.studio.goals import Goal
from preimage.studio.jobs import Job, Jobs
from preimage.studio.opened import OpenedRun
from preimage.studio.pictures import inline, strip, text_of
from preimage.studio.problems import Refusal
from preimage.studio.table import Table

if TYPE_CHECKING:
    from preimage.ideas.watched import Considered

MOST_DOTS = 12
"""Candidates that are told of in one event: what a search evaluates at once are hardly ever more."""
LIKELY = {
    Verdict.REACHED: "what it imagines meets the goal",
    Verdict.NEAR: "what it imagines comes near to the goal, not quite to it",
    Verdict.IN_DOUBT: "what it imagines does not meet the goal: do not trust this plan",
}


@dataclass(eq=False)
class Planned:
    """A plan that was found, and its execution once there is one."""

    plan: Plan
    goal: Goal
    preset: Preset
    trial: Trial | None = None
    anyway: bool = False
    """Whether a person goes on although the goal is refused."""
    lock: threading.Lock = field(default_factory=threading.Lock)

    @property
    def is_refused(self) -> bool:
        return self.plan.trust is not None and self.plan.trust.refused

    def validate_trust(self) -> None:
        """Raises Refusal where the goal is refused, and nobody said to go on anyway."""
        trust = self.plan.trust
        if trust is not None and trust.refused and not self.anyway:
            raise Refusal(HTTPStatus.CONFLICT, str(GoalRefused.by(trust, "choose another, or go on anyway")))


class Onlooker:
    """Writes down for the page what a search evaluates, and ends it where that is asked for."""

    def __init__(self, job: Job, jobs: Jobs, options: PlanOptions) -> None:
        self._job, self._jobs, self._options = job, jobs, options
        self._began_s, self._count, self._lowest = time.monotonic(), 0, float("inf")

    def __call__(self, considered: "Considered") -> None:
        from preimage.network.coding import to_frames
        from preimage.studio.intentions import plane

        self._job.go_on()
        self._jobs.run_errands()
        best = int(considered.error.argmin())
        error, arrival = float(considered.error[best]), int(considered.arrival[best])
        self._count += 1
        about: dict[str, Any] = {"n": self._count, "error": error, "arrival": arrival, "left_s": self._left_s()}
        nearest = considered.error.argsort()[:MOST_DOTS]
        about["errors"] = [round(value, 4) for value in considered.error[nearest].tolist()]
        about["arrivals"] = considered.arrival[nearest].tolist()
        about["point"] = [round(value, 3) for value in plane(considered.points[best][None])[0].tolist()]
        if error < self._lowest:
            self._lowest = error
            about["frame"] = inline(to_frames(considered.generated.pixels[best, arrival]).cpu().numpy())
        self._job.tell("looked", lowest=self._lowest, **about)

    def _left_s(self) -> float:
        """Seconds until all iterations are used, if each takes as long as those before: most searches end sooner."""
        most = self._options.iterations + (2 if self._options.search == "adam" else 1)
        return max(0, most - self._count) * (time.monotonic() - self._began_s) / self._count


def plan_to(run: OpenedRun, goal: Goal, preset: Preset, jobs: Jobs, job: Job) -> dict[str, Any]:
    """Search for a plan; what the page gets of it."""
    planner = run.planner(preset)
    found = planner.watched(Onlooker(job, jobs, planner.options)).plan(start=goal.start, goal=goal.goal)
    job.result = planned = Planned(found, goal, preset)
    return {"plan": described(run, planned)}


def described(run: OpenedRun, planned: Planned) -> dict[str, Any]:
    """A plan as the page gets it."""
    plan, goal, preset = planned.plan, planned.goal, planned.preset
    way = run.table.way(plan.joints).round(4).tolist() if run.table else None
    return {
        "preset": preset,
        "steps": len(plan),
        "height": plan.frames.shape[1],
        "width": plan.frames.shape[2],
        "rate_hz": plan.rate_hz,
        "arrival": plan.arrival_step,
        "error": plan.error,
        "unexplained": plan.unexplained,
        "verdict": plan.verdict.value if plan.verdict else None,
        "trust": trust_in(plan),
        "reasons": list(reasons_of(plan)),
        "seconds": plan.seconds,
        "joints": plan.joints.round(4).tolist(),
        "film": text_of(strip(plan.frames)),
        "way": way,
        "executable": goal.scene is not None,
        "command": command_of(run, goal, preset, anyway=planned.is_refused),
    }


def trust_in(plan: Plan) -> dict[str, Any] | None:
    """How far a plan is to be trusted, as the page gets it."""
    trust = plan.trust
    if trust is None:
        return None
    return {"probability": trust.probability, "refused": trust.refused, "reasons": list(trust.reasons), "note": trust.note}


def reasons_of(plan: Plan) -> Iterator[str]:
    """Why a plan is to be trusted, or not."""
    if plan.verdict and plan.unexplained is not None:
        yield LIKELY[plan.verdict]
        yield (
            f"its error is {100 * plan.unexplained:.1f} % of that of staying at the start; "
            f"below {100 * REACHED_BELOW:.0f} % counts as reached, below {100 * NEAR_BELOW:.0f} % as near"
        )
    yield plan.stopped.value
    if plan.expected_joints is not None and plan.imagined_joints is not None:
        apart = np.abs(plan.imagined_joints[plan.arrival_step] - plan.expected_joints[-1]).max()
        yield f"memory expects joints at the goal that are up to {apart:.3f} away from those imagined"


def on_table(run: OpenedRun, planned: Planned) -> tuple[Table, Scene]:
    """Where a plan can be executed.

    Raises:
        Refusal: nowhere, or its goal is refused and nobody said to go on anyway.
    """
    if run.table is None or planned.goal.scene is None:
        raise Refusal(HTTPStatus.CONFLICT, "there is no simulated arm for this plan: take its joints with you instead")
    planned.validate_trust()
    return run.table, planned.goal.scene


def execute(run: OpenedRun, planned: Planned) -> dict[str, Any]:
    """Let the arm on the table execute a plan, once.

    Raises:
        Refusal: as `on_table`.
    """
    table, scene = on_table(run, planned)
    with planned.lock:
        if planned.trial is None:
            planned.trial = table.execute(planned.plan, scene)
    return executed(table, planned.trial, is_judged=planned.goal.is_judged)


def executed(table: Table, trial: Trial, *, is_judged: bool) -> dict[str, Any]:
    """An execution as the page gets it; where nobody knows where the goal is nothing is judged."""
    about: dict[str, Any] = {
        "steps": len(trial.frames),
        "film": text_of(strip(trial.frames)),
        "joints": trial.joints.round(4).tolist(),
        "way": table.camera.project(trial.end_effector_m).round(4).tolist(),
        "limited": list(trial.limited),
        "deviation_cm": None,
        "success": None,
        "details": [],
    }
    if is_judged:
        about |= {"deviation_cm": 100 * trial.deviation_m, "success": trial.success, "details": details_of(trial)}
    return about


def details_of(trial: Trial) -> list[str]:
    """What else the judge saw, in words."""
    words = []
    for name, value in trial.details.items():
        label = name.removesuffix("_m").replace("_", " ")
        words.append(f"{label}: {100 * value:.1f} cm" if name.endswith("_m") else f"{label}: {'yes' if value else 'no'}")
    return words


def command_of(run: OpenedRun, goal: Goal, preset: Preset, kept: Path | None = None, *, anyway: bool = False) -> str:
    """What repeats a plan on the command line.

    Args:
        kept: the data set of start and goal that `keep` wrote.
        anyway: whether the goal is refused otherwise.
    """
    if goal.source and goal.kind == "frame":
        episode = goal.source.rsplit(":", 1)[0]
        ends = ["--start", f"{episode}:0", "--goal", goal.source]
    elif goal.source:
        ends = ["--goal", goal.source]
    else:
        ends = ["--start", f"{kept or 'GOAL'}:0:0", "--goal", f"{kept or 'GOAL'}:0:1"]
    out = f"plans/{kept.name if kept else f'goal-{goal.number}'}"
    anyhow = ["--anyway"] if anyway else []
    command = shlex.join(["preimage", "plan", run.name, *ends, "--as", preset, "--out", out, *anyhow])
    return f"{command} && {shlex.join(['preimage', 'execute', out, *anyhow])}" if goal.scene else command


def keep(run: OpenedRun, goal: Goal, folder: Path) -> Path:
    """Start and goal as a data set of one episode of two steps, in a new folder inside the one given; where it is."""
    numbers = (number for number in range(1, 10**6) if not (folder / f"goal-{number}").exists())
    place = folder / f"goal-{next(numbers)}"
    start, wanted = goal.start, goal.goal
    assert start.frame is not None, "a start is seen"
    assert start.joints is not None, "and felt"
    assert wanted.frame is not None, "a goal is a picture"
    joints = np.stack([start.joints, start.joints if wanted.joints is None else wanted.joints])
    episode = Demonstration(np.stack([start.frame, wanted.frame]), joints, run.model_rate_hz, run.sensors.joint_names, goal.scene)
    save([episode], place, task=str(run.config.get("task")), joint_unit=run.body.joint_unit)
    return place


def commanded(run: OpenedRun, plan: Plan) -> tuple[np.ndarray, float]:
    """The joints to command within the limits of the demonstrations (S, J), and how many rows a second, as `preimage plan` writes them."""
    rate_hz = max(one.rate_hz for one in run.shown)
    return commands_of(plan, run.limits, rate_hz=rate_hz)[0], rate_hz


def commands_csv(run: OpenedRun, plan: Plan) -> str:
    """The joints to command as a table."""
    commands, rate_hz = commanded(run, plan)
    table = io.StringIO(newline="")
    write_commands(table, commands, plan.joint_names, rate_hz=rate_hz)
    return table.getvalue()


def episode_zip(run: OpenedRun, plan: Plan) -> bytes:
    """The joints to command as a LeRobotDataset of one episode."""
    commands, rate_hz = commanded(run, plan)
    with tempfile.TemporaryDirectory() as folder:
        save_episode(plan, Path(folder) / "lerobot", commands=commands, rate_hz=rate_hz, body=run.body)
        return Path(shutil.make_archive(f"{folder}/episode", "zip", folder, "lerobot")).read_bytes()


def film_of(planned: Planned) -> bytes:
    """The plan as a film, executed beside imagined where it was executed."""
    from preimage.report.films import film  # matplotlib takes a second to load

    with tempfile.TemporaryDirectory() as folder:
        return film(planned.plan, planned.trial, Path(folder) / "plan.mp4").read_bytes()
