"""A plan on disk: a folder that another program, or a person, can read without this one.

plan.json      arrival step, rate, joint names, error, why the search stopped, the scene where it is known
plan.npz       imagined frames and joints, start and goal
joints.csv     the joints to command, one row a step up to the arrival, in rad
"""

import contextlib
import csv
import json
import zipfile
import zlib
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from preimage.records import Percept, Plan, Scene, Stopped
from preimage.whole_file import whole_file

ARRAYS = ("frames", "joints", "errors", "intention")
NUMBERS = ("arrival_step", "rate_hz", "error", "seconds")


def save_plan(plan: Plan, folder: Path | str, *, scene: Scene | None = None) -> None:
    """Write a plan, and the scene it was made for where it is known, into a folder: all of its files, or none.

    Raises:
        OSError: the disk is full or forbidden.
    """
    folder = Path(folder)
    with contextlib.ExitStack() as files:  # every file is whole before the first of them moves into its place
        about, arrays, table = (files.enter_context(whole_file(folder / name)) for name in ("plan.json", "plan.npz", "joints.csv"))
        with arrays.open("wb") as file:
            np.savez_compressed(
                file, frames=plan.frames, joints=plan.joints, errors=plan.errors, intention=plan.intention, **percepts_of(plan)
            )
        with table.open("w", newline="") as file:
            rows = csv.writer(file)
            rows.writerow(["time_s", *plan.joint_names])
            for step, joints in enumerate(plan.joints[: plan.arrival_step + 1]):
                rows.writerow([round(step / plan.rate_hz, 6), *(round(float(angle), 6) for angle in joints)])
        facts = {name: getattr(plan, name) for name in NUMBERS}
        facts |= {"joint_names": plan.joint_names, "stopped": plan.stopped.name, "scene": asdict(scene) if scene else None}
        about.write_text(json.dumps(facts, indent=2) + "\n")


def percepts_of(plan: Plan) -> dict[str, Any]:
    """The parts of start and goal that are there, by the names they have in plan.npz."""
    ends = (("start", plan.start), ("goal", plan.goal))
    parts = {f"{end}_{part}": getattr(percept, part) for end, percept in ends for part in ("frame", "joints")}
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


def scene_of(about: dict | None) -> Scene | None:
    if about is None:
        return None
    positions = {name: tuple(position) for name, position in about["positions_m"].items()}
    return Scene(about["task"], tuple(about["start_joints"]), positions)
