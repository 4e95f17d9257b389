"""A plan on disk: a folder that another program, or a person, can read without this one.

plan.json      arrival step, rate, joint names, error, why the search stopped, the scene where it is known
plan.npz       imagined frames and joints, start and goal
joints.csv     the joints to command, one row a step up to the arrival, in the unit of the training data
lerobot/       the same as a LeRobotDataset of one episode, which `lerobot-replay` plays (written by `save_episode`)
"""

import contextlib
import csv
import json
import shutil
import tempfile
import zipfile
import zlib
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from preimage.data.dataset import save
from preimage.records import Body, Demonstration, Percept, Plan, Scene, Stopped, scene_of
from preimage.storage.atomic_write import atomic_write

ARRAYS = ("frames", "joints", "errors", "intention")
NUMBERS = ("arrival_step", "rate_hz", "error", "seconds")


def save_plan(plan: Plan, folder: Path | str, *, scene: Scene | None = None, commands: Float[np.ndarray, "S J"] | None = None) -> None:
    """Write a plan, and the scene it was made for where it is known, into a folder: all of its files, or none.

    Args:
        commands: what joints.csv is to hold, as `robot.limits.commands_of` gives it; by default the joints as they were imagined.

    Raises:
        OSError: the disk is full or forbidden.
    """
    folder = Path(folder)
    commands = plan.joints[: plan.arrival_step + 1] if commands is None else commands
    with contextlib.ExitStack() as files:  # every file is whole before the first of them moves into its place
        about, arrays, table = (files.enter_context(atomic_write(folder / name)) for name in ("plan.json", "plan.npz", "joints.csv"))
        with arrays.open("wb") as file:
            np.savez_compressed(file, **{name: getattr(plan, name) for name in ARRAYS}, **known_of(plan))
        with table.open("w", newline="") as file:
            rows = csv.writer(file)
            rows.writerow(["time_s", *plan.joint_names])
            for step, joints in enumerate(commands):
                rows.writerow([round(step / plan.rate_hz, 6), *(round(float(angle), 6) for angle in joints)])
        facts = {name: getattr(plan, name) for name in NUMBERS}
        facts |= {"joint_names": plan.joint_names, "stopped": plan.stopped.name, "scene": asdict(scene) if scene else None}
        about.write_text(json.dumps(facts, indent=2) + "\n")


def save_episode(
    plan: Plan, folder: Path | str, *, commands: Float[np.ndarray, "S J"], body: Body | None = None, task: str = "reach the goal"
) -> None:
    """Write what is to be commanded, with the imagined frames, as a LeRobotDataset of one episode; a former one is replaced.

    `lerobot-replay` sends its actions: the joints one step later, the last repeated. Joints have the names and the unit of the training
    data. Where limits added steps, the frame of the arrival stays; depth, which LeRobot's pictures have no channel for, is left out.

    Args:
        commands: as `robot.limits.commands_of` gives them.
        body: all joints of the recordings (`storage.runs.read_body`), of which those that the plan does not move are held; by default the
        plan's. task: what is done, in words.

    Raises:
        OSError: the disk is full or forbidden.
    """
    folder = Path(folder).resolve()
    steps = np.arange(max(2, len(commands)))  # an episode has a start and an end, even where the arm stays
    frames = plan.frames[np.minimum(steps, plan.arrival_step)]
    frames = frames[..., :3] if frames.shape[-1] >= 3 else frames[..., :1]
    body = body or Body(plan.joint_names)
    joints = body.whole(commands[np.minimum(steps, len(commands) - 1)], plan.joint_names)
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{folder.name}-", dir=folder.parent) as scratch:
        draft = Path(scratch) / folder.name
        save([Demonstration(frames, joints, plan.rate_hz, body.joint_names)], draft, task=task, joint_unit=body.joint_unit)
        shutil.rmtree(folder, ignore_errors=True)
        draft.replace(folder)


def known_of(plan: Plan) -> dict[str, Any]:
    """The parts of start and goal, and what was recalled, as far as they are there, by the names they have in plan.npz."""
    ends = (("start", plan.start), ("goal", plan.goal))
    parts = {f"{end}_{part}": getattr(percept, part) for end, percept in ends for part in ("frame", "joints")}
    parts["recalled"] = plan.recalled
    return {name: value for name, value in parts.items() if value is not None}


def load_plan(folder: Path | str) -> tuple[Plan, Scene | None]:
    """The plan in a folder, and the scene it was made for.

    Raises:
        ValueError: there is none, or its files are broken.
    """
    folder = Path(folder)
    if not (folder / "plan.json").is_file():
        raise ValueError(f"{folder} holds no plan (plan.json): give a folder that `preimage plan` wrote")
    try:
        about = json.loads((folder / "plan.json").read_text())
        with (folder / "plan.npz").open("rb") as file, np.load(file) as arrays:
            parts = dict(arrays)
        plan = Plan(
            **{name: parts[name] for name in ARRAYS},
            start=Percept(parts.get("start_frame"), parts.get("start_joints")),
            goal=Percept(parts.get("goal_frame"), parts.get("goal_joints")),
            recalled=parts.get("recalled"),
            joint_names=tuple(about["joint_names"]),
            stopped=Stopped[about["stopped"]],
            **{name: about[name] for name in NUMBERS},
        )
        scene = scene_of(about["scene"])
        check_whole(plan)
    except (OSError, KeyError, ValueError, TypeError, AttributeError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise ValueError(f"the plan in {folder} cannot be read ({type(error).__name__}: {error}): plan again") from error
    return plan, scene


def check_whole(plan: Plan) -> None:
    """Raises ValueError where the files of a plan contradict each other, or a joint is not finite."""
    if plan.joints.shape != (len(plan.frames), len(plan.joint_names)):
        raise ValueError(f"joints of {plan.joints.shape} for {len(plan.frames)} frames and {len(plan.joint_names)} names")
    if not 0 <= plan.arrival_step < len(plan):
        raise ValueError(f"arrival_step {plan.arrival_step} of {len(plan)} steps")
    if not np.isfinite(plan.joints).all():
        raise ValueError("joints that are not finite")
    if not plan.rate_hz > 0:
        raise ValueError(f"rate_hz {plan.rate_hz}")
