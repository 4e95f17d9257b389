"""A plan on disk: a folder that another program, or a person, can read without this one.

plan.json      arrival step, rate, joint names, error, why the search stopped, the scene where it is known
plan.npz       imagined frames and joints, start and goal
joints.csv     the joints to command, one row a step up to the arrival, in rad
"""

import csv
import json
import zipfile
from dataclasses import asdict
from pathlib import Path

import numpy as np

from preimage.records import Percept, Plan, Scene, Stopped
from preimage.whole_file import whole_file

NUMBERS = ("arrival_step", "rate_hz", "error", "seconds")


def save_plan(plan: Plan, folder: Path | str, *, scene: Scene | None = None) -> None:
    """Write a plan, and the scene it was made for where it is known, into a folder."""
    folder = Path(folder)
    about = {name: getattr(plan, name) for name in NUMBERS}
    about |= {"joint_names": plan.joint_names, "stopped": plan.stopped.name, "scene": asdict(scene) if scene else None}
    percepts = {
        f"{end}_{part}": value
        for end, percept in (("start", plan.start), ("goal", plan.goal))
        for part, value in (("frame", percept.frame), ("joints", percept.joints))
        if value is not None
    }
    with whole_file(folder / "plan.npz") as path, path.open("wb") as file:
        np.savez_compressed(file, frames=plan.frames, joints=plan.joints, errors=plan.errors, **percepts)
    with whole_file(folder / "joints.csv") as path, path.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["time_s", *plan.joint_names])
        for step, joints in enumerate(plan.joints[: plan.arrival_step + 1]):
            rows.writerow([round(step / plan.rate_hz, 6), *(round(float(angle), 6) for angle in joints)])
    with whole_file(folder / "plan.json") as path:
        path.write_text(json.dumps(about, indent=2) + "\n")


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
        with np.load(folder / "plan.npz") as arrays:
            parts = dict(arrays)
        plan = Plan(
            frames=parts["frames"],
            joints=parts["joints"],
            errors=parts["errors"],
            start=Percept(parts.get("start_frame"), parts.get("start_joints")),
            goal=Percept(parts.get("goal_frame"), parts.get("goal_joints")),
            joint_names=tuple(about["joint_names"]),
            stopped=Stopped[about["stopped"]],
            **{name: about[name] for name in NUMBERS},
        )
        return plan, scene_of(about["scene"])
    except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"the plan in {folder} cannot be read ({error}): plan again") from error


def scene_of(about: dict | None) -> Scene | None:
    if about is None:
        return None
    positions = {name: tuple(position) for name, position in about["positions_m"].items()}
    return Scene(about["task"], tuple(about["start_joints"]), positions)
