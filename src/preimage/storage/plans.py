"""A plan on disk: a folder that another program, or a person, can read without this one.

plan.json      arrival step, rate, joint names, error, why the search stopped, the scene where it is known
plan.npz       imagined frames and joints, start and goal
joints.csv     the joints to command, one row a step up to the arrival, in the unit of the training data
lerobot/       the same as a LeRobotDataset of one episode, which `lerobot-replay` plays (written by `save_episode`)
imagined.mp4   a film of it, and imagined.png a figure (written by `preimage plan`)
"""

import contextlib
import csv
import io
import json
import math
import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from preimage.data.lerobot_writer import write_files
from preimage.records import HIGHEST_RATE_HZ, LOWEST_RATE_HZ, Body, Demonstration, Percept, Plan, Scene, Stopped, Trust, scene_of
from preimage.storage.atomic_write import atomic_write, write_json
from preimage.storage.output_folders import Kind, is_regular_file, output_folder
from preimage.storage.reading import read_arrays, read_json, record_of

ARRAYS = ("frames", "joints", "errors", "intention")
NUMBERS = ("arrival_step", "rate_hz", "error", "seconds")
FILES = ("plan.json", "plan.npz", "joints.csv")
ONE_FILE = Kind("file", required=("file-000.parquet",))
"""What a data set of one file has in its only chunk."""
EPISODE = Kind(
    "episode",
    required=(),
    folders={
        "meta": Kind(
            "episode",
            required=("info.json", "preimage.json", "planned.json"),
            files=("stats.json", "tasks.parquet"),
            folders={"episodes": Kind("episode", required=(), folders={"chunk-000": ONE_FILE})},
        ),
        "data": Kind("episode", required=(), folders={"chunk-000": ONE_FILE}),
    },
    required_folders=("meta", "data"),
)
"""A planned episode, by its `meta/planned.json`: a recorded data set is never taken for one, and so never replaced by one."""
PLAN = Kind("plan", required=FILES, files=("imagined.mp4", "imagined.png"), folders={"lerobot": EPISODE})


def save_plan(
    plan: Plan,
    folder: Path | str,
    *,
    scene: Scene | None = None,
    commands: Float[np.ndarray, "S J"] | None = None,
    rate_hz: float | None = None,
) -> None:
    """Write a plan, and the scene it was made for where it is known, into a folder: all of its files, or none.

    Args:
        commands: what joints.csv is to hold, as `robot.limits.commands_of` gives it; by default the joints as they were imagined.
        rate_hz: rows a second of the commands; by default the plan's.

    Raises:
        ValueError: the folder holds files of these names that are not those of a plan.
        OSError: the disk is full or read-only.
    """
    folder = Path(folder)
    there = [name for name in FILES if os.path.lexists(folder / name)]
    if there and not all(is_regular_file(folder / name) for name in FILES):
        raise ValueError(f"{folder / there[0]} is not that of a plan, and is kept: give a new folder")
    commands = plan.joints[: plan.arrival_step + 1] if commands is None else commands
    with contextlib.ExitStack() as files:  # every file is complete before the first of them moves into its place
        about, arrays, table = (files.enter_context(atomic_write(folder / name)) for name in FILES)
        with arrays.open("wb") as file:
            np.savez_compressed(file, **{name: getattr(plan, name) for name in ARRAYS}, **known_of(plan))
        with table.open("w", newline="", encoding="utf-8") as file:
            write_commands(file, commands, plan.joint_names, rate_hz=rate_hz or plan.rate_hz)
        facts = {name: getattr(plan, name) for name in (*NUMBERS, "unexplained")}
        facts |= {"joint_names": plan.joint_names, "stopped": plan.stopped.name, "scene": asdict(scene) if scene else None}
        facts |= {"trust": asdict(plan.trust)} if plan.trust else {}
        about.write_text(json.dumps(facts, indent=2) + "\n", encoding="utf-8")


def write_commands(file: io.TextIOBase, commands: Float[np.ndarray, "S J"], joint_names: Sequence[str], *, rate_hz: float) -> None:
    """Joints to command as a table, one row a step, of `rate_hz` rows a second; the file leaves line ends as they are (`newline=""`)."""
    rows = csv.writer(file)
    rows.writerow(["time_s", *joint_names])
    for step, joints in enumerate(commands):
        rows.writerow([round(step / rate_hz, 6), *(round(float(angle), 6) for angle in joints)])


def save_episode(
    plan: Plan,
    folder: Path | str,
    *,
    commands: Float[np.ndarray, "S J"],
    rate_hz: float | None = None,
    body: Body | None = None,
    task: str = "reach the goal",
) -> None:
    """Write what is to be commanded, with the imagined frames, as a LeRobotDataset of one episode; a former one is replaced.

    `lerobot-replay` sends its actions: the joints one step later, the last repeated. Joints have the names and the unit of the training
    data. Where limits added steps, the frame of the arrival stays; depth, which LeRobot's pictures have no channel for, is left out.

    Args:
        commands: as `robot.limits.commands_of` gives them.
        rate_hz: rows a second of the commands; by default the plan's.
        body: all joints of the recordings (`storage.runs.read_body`), of which those that the plan does not move are held; by default the
        plan's. task: what is done, in words.

    Raises:
        ValueError: the folder is neither new nor empty nor a planned episode.
        OSError: the disk is full or read-only.
    """
    rate_hz = rate_hz or plan.rate_hz
    rows = np.arange(max(2, len(commands)))  # an episode has a start and an end, even where the arm stays
    steps = np.round(rows * plan.rate_hz / rate_hz).astype(int)
    frames = plan.frames[np.minimum(steps, plan.arrival_step)]
    frames = frames[..., :3] if frames.shape[-1] >= 3 else frames[..., :1]
    body = body or Body(plan.joint_names)
    joints = body.whole(commands[np.minimum(rows, len(commands) - 1)], plan.joint_names)
    with output_folder(Path(folder), EPISODE, overwrite=True) as draft:
        write_files([Demonstration(frames, joints, rate_hz, body.joint_names)], draft, task=task, joint_unit=body.joint_unit)
        write_json(draft / "meta/planned.json", {"arrival_step": plan.arrival_step, "planned_at_hz": plan.rate_hz})


def known_of(plan: Plan) -> dict[str, Any]:
    """The parts of start and goal, and what was recalled, as far as they are there, by the names they have in plan.npz."""
    ends = (("start", plan.start), ("goal", plan.goal))
    parts = {f"{end}_{part}": getattr(percept, part) for end, percept in ends for part in ("frame", "joints")}
    parts |= {"expected_joints": plan.expected_joints, "imagined_joints": plan.imagined_joints}
    return {name: value for name, value in parts.items() if value is not None}


def load_plan(folder: Path | str) -> tuple[Plan, Scene | None]:
    """The plan in a folder, and the scene it was made for.

    Raises:
        ValueError: there is none, its files are broken or contradict each other, or a number in them is not finite.
    """
    folder = Path(folder)
    if not (folder / "plan.json").is_file():
        raise ValueError(f"{folder} holds no plan (plan.json): give a folder that `preimage plan` wrote")
    try:
        about, parts = read_json(folder / "plan.json"), read_arrays(folder / "plan.npz")
        validate_facts(about)
        validate_arrays(parts, about)
        scene = scene_of(about["scene"])
        trust = None if about.get("trust") is None else record_of(Trust, about["trust"])
    except ValueError as error:
        raise ValueError(f"the plan in {folder} cannot be read ({error}): plan again") from error
    plan = Plan(
        **{name: parts[name] for name in ARRAYS},
        start=Percept(parts.get("start_frame"), parts.get("start_joints")),
        goal=Percept(parts.get("goal_frame"), parts.get("goal_joints")),
        expected_joints=parts.get("expected_joints"),
        imagined_joints=parts.get("imagined_joints"),
        joint_names=tuple(about["joint_names"]),
        stopped=Stopped[about["stopped"]],
        unexplained=about.get("unexplained"),
        trust=trust,
        **{name: about[name] for name in NUMBERS},
    )
    return plan, scene


def validate_facts(about: dict[str, Any]) -> None:
    """Raises ValueError where what plan.json says is missing, of another type, or out of range."""
    for name in (*NUMBERS, "joint_names", "stopped", "scene"):
        if name not in about:
            raise ValueError(f"plan.json has no {name}")
    for name in NUMBERS if about.get("unexplained") is None else (*NUMBERS, "unexplained"):
        value = about[name]
        if isinstance(value, bool) or not isinstance(value, int if name == "arrival_step" else int | float):
            raise ValueError(f"{name} is {value!r:.40}: a {'whole ' if name == 'arrival_step' else ''}number is needed")
    if not LOWEST_RATE_HZ <= about["rate_hz"] <= HIGHEST_RATE_HZ:
        raise ValueError(f"rate_hz is {about['rate_hz']:g}: {LOWEST_RATE_HZ:g} to {HIGHEST_RATE_HZ:g} steps a second are needed")
    if not are_names(about["joint_names"]):
        raise ValueError("joint_names are no names, each once")
    if about["stopped"] not in list(Stopped.__members__):
        raise ValueError(f"stopped is {about['stopped']!r:.40}")
    if about["scene"] is not None:
        validate_scene(about["scene"])


def validate_scene(scene: Any) -> None:
    """Raises ValueError where a scene out of JSON has no task, joints or positions."""
    if not isinstance(scene, dict) or not isinstance(scene.get("task"), str):
        raise ValueError("its scene has no task")
    if not are_numbers(scene.get("start_joints")):
        raise ValueError("its scene has no start_joints")
    positions_m = scene.get("positions_m")
    if not isinstance(positions_m, dict) or not all(are_numbers(position) and len(position) in (2, 3) for position in positions_m.values()):
        raise ValueError("its scene has no positions_m of two or three numbers each")


def are_names(values: Any) -> bool:
    """Whether values out of JSON are a list of names, each once."""
    return (
        isinstance(values, list)
        and bool(values)
        and all(isinstance(each, str) and each for each in values)
        and len(set(values)) == len(values)
    )


def are_numbers(values: Any) -> bool:
    """Whether values out of JSON are a list of finite numbers."""
    return isinstance(values, list) and all(
        isinstance(each, int | float) and not isinstance(each, bool) and abs(each) < math.inf for each in values
    )


def validate_arrays(parts: dict[str, np.ndarray], about: dict[str, Any]) -> None:
    """Raises ValueError where the arrays of a plan are missing, or contradict each other or plan.json."""
    if missing := [name for name in ARRAYS if name not in parts]:
        raise ValueError(f"plan.npz has no {missing[0]}")
    frames, num_joints = parts["frames"], len(about["joint_names"])
    if frames.ndim != 4 or frames.dtype != np.uint8 or not 1 <= frames.shape[-1] <= 4 or not frames.size:
        raise ValueError(f"frames are {frames.dtype} of {frames.shape}")
    shapes: dict[str, tuple[int | None, ...]] = {
        "joints": (len(frames), num_joints),
        "errors": (None,),
        "intention": (None,),
        "start_frame": frames.shape[1:],
        "goal_frame": frames.shape[1:],
        "start_joints": (num_joints,),
        "goal_joints": (num_joints,),
        "expected_joints": (None, num_joints),
        "imagined_joints": (len(frames), num_joints),
    }
    for name, shape in shapes.items():
        array = parts.get(name)
        if array is None:
            continue
        if array.ndim != len(shape) or any(wanted not in (None, given) for wanted, given in zip(shape, array.shape, strict=True)):
            raise ValueError(
                f"{name} are of shape {array.shape}, for {len(frames)} frames of {frames.shape[1:]} and {num_joints} joint names"
            )
        if (array.dtype == np.uint8) != name.endswith("frame") or array.dtype.kind == "b":
            raise ValueError(f"{name} are {array.dtype}")
    if not 0 <= about["arrival_step"] < len(frames):
        raise ValueError(f"arrival_step {about['arrival_step']} of {len(frames)} steps")
