"""A plan that was saved is the plan that is loaded; broken files are told in one sentence."""

import csv
import dataclasses
import json
import os
import zipfile
from pathlib import Path

import numpy as np
import pytest

from preimage.cli.acting import sentences_of
from preimage.data.dataset import load
from preimage.records import Percept, Plan, Scene, Stopped
from preimage.report import figures
from preimage.report.figures import figure
from preimage.storage.plans import load_plan, save_episode, save_plan

SCENE = Scene("reach", (0.1, -0.2), {"goal": (0.5, 0.25, 0.03)})


def make_plan(*, seed=0, goal=None, num_steps=5, arrival_step=3) -> Plan:
    rng = np.random.default_rng(seed)
    frames, joints = rng.integers(0, 256, (num_steps, 8, 6, 1), np.uint8), rng.normal(size=(num_steps, 2))
    start = Percept(frames[0], joints[0])
    goal = goal or Percept(frame=frames[-1])
    errors = np.array([3.0, 1.25])
    return Plan(frames, joints, arrival_step, 5.0, ("yaw", "elbow"), start, goal, 1.25, errors, Stopped.CONVERGED, 0.5, np.arange(3.0))


def assert_equal(one, other) -> None:
    """Field by field, records within records too."""
    for field in dataclasses.fields(one):
        left, right = getattr(one, field.name), getattr(other, field.name)
        if dataclasses.is_dataclass(left):
            assert_equal(left, right)
        elif isinstance(left, np.ndarray):
            np.testing.assert_array_equal(left, right)
            assert left.dtype == right.dtype
        else:
            assert left == right


@pytest.mark.parametrize("goal", [None, Percept(joints=np.zeros(2)), Percept(np.zeros((8, 6, 1), np.uint8), np.ones(2))])
@pytest.mark.parametrize("scene", [None, SCENE])
@pytest.mark.parametrize("expected_joints", [None, np.array([[0.1, -0.2], [0.3, 0.4]])])
def test_load_undoes_save(tmp_path, goal, scene, expected_joints):
    plan = dataclasses.replace(make_plan(goal=goal), expected_joints=expected_joints)
    save_plan(plan, tmp_path / "new" / "plan", scene=scene)
    loaded, loaded_scene = load_plan(tmp_path / "new" / "plan")
    assert_equal(plan, loaded)
    assert loaded_scene == scene


def test_the_joints_to_command_can_be_read_without_this_program(tmp_path):
    plan = make_plan()
    save_plan(plan, tmp_path)
    with (tmp_path / "joints.csv").open() as file:
        head, *rows = csv.reader(file)
    assert head == ["time_s", "yaw", "elbow"]
    assert [row[0] for row in rows] == ["0.0", "0.2", "0.4", "0.6"]  # up to the arrival
    np.testing.assert_allclose(np.array(rows, float)[:, 1:], plan.joints[:4], atol=1e-6)


def test_commands_take_the_place_of_the_imagined_joints_in_the_table(tmp_path):
    save_plan(make_plan(), tmp_path, commands=np.full((6, 2), 0.5))
    assert np.loadtxt(tmp_path / "joints.csv", delimiter=",", skiprows=1)[:, 1:].tolist() == [[0.5, 0.5]] * 6
    assert_equal(load_plan(tmp_path)[0], make_plan())


@pytest.mark.parametrize("num_commands", [1, 4, 7])
def test_an_episode_holds_what_is_commanded_beside_what_is_imagined(tmp_path, num_commands):
    plan = make_plan()
    commands = np.random.default_rng(9).normal(size=(num_commands, 2))
    save_episode(plan, tmp_path / "plan" / "lerobot", commands=commands)
    (episode,) = load(tmp_path / "plan" / "lerobot")
    assert (episode.joint_names, episode.rate_hz, len(episode)) == (plan.joint_names, plan.rate_hz, max(2, num_commands))
    np.testing.assert_allclose(episode.joints[:num_commands], commands, atol=1e-6)
    np.testing.assert_allclose(episode.joints[-1], commands[-1], atol=1e-6)
    for step, frame in enumerate(episode.frames):
        np.testing.assert_array_equal(frame, plan.frames[min(step, plan.arrival_step)])


def test_an_episode_replaces_the_former_one_and_leaves_nothing_beside(tmp_path):
    for seed in range(2):
        save_episode(make_plan(seed=seed), tmp_path / "lerobot", commands=make_plan(seed=seed).joints[:4])
    np.testing.assert_allclose(load(tmp_path / "lerobot")[0].joints, make_plan(seed=1).joints[:4], atol=1e-6)
    assert [path.name for path in tmp_path.iterdir()] == ["lerobot"]


@pytest.mark.parametrize(("channels", "kept"), [(3, 3), (4, 3)])
def test_depth_has_no_place_in_the_pictures_of_an_episode(tmp_path, channels, kept):
    frames = np.random.default_rng(0).integers(0, 256, (5, 8, 6, channels), np.uint8)
    save_episode(dataclasses.replace(make_plan(), frames=frames), tmp_path / "lerobot", commands=np.zeros((4, 2)))
    np.testing.assert_array_equal(load(tmp_path / "lerobot")[0].frames, frames[:4, ..., :kept])


def test_saving_again_replaces(tmp_path):
    save_plan(make_plan(seed=0), tmp_path)
    save_plan(make_plan(seed=1), tmp_path)
    assert_equal(load_plan(tmp_path)[0], make_plan(seed=1))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["joints.csv", "plan.json", "plan.npz"]


def test_a_save_that_fails_midway_leaves_the_former_plan_whole(tmp_path, monkeypatch):
    save_plan(make_plan(seed=0), tmp_path)

    def full(*_arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(csv, "writer", full)
    with pytest.raises(OSError, match="No space left on device"):
        save_plan(make_plan(seed=1), tmp_path)
    assert_equal(load_plan(tmp_path)[0], make_plan(seed=0))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["joints.csv", "plan.json", "plan.npz"]


def edit(folder, **changes) -> None:
    path = folder / "plan.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


def without(folder, name) -> None:
    path = folder / "plan.json"
    path.write_text(json.dumps({key: value for key, value in json.loads(path.read_text()).items() if key != name}))


def arrays(folder, **changes) -> None:
    with np.load(folder / "plan.npz") as file:
        parts = dict(file)
    np.savez(folder / "plan.npz", **parts | changes)


def bomb(path, size) -> None:
    """An npz of a few megabytes whose only array unpacks to `size` bytes."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file, file.open("frames.npy", "w", force_zip64=True) as member:
        np.lib.format.write_array_header_1_0(member, {"descr": "|u1", "fortran_order": False, "shape": (size,)})
        for _ in range(size >> 24):
            member.write(bytes(1 << 24))


def long_header(path) -> None:
    """An npz whose array says that it has many more numbers than there are."""
    with zipfile.ZipFile(path, "w") as file, file.open("frames.npy", "w") as member:
        np.lib.format.write_array_header_1_0(member, {"descr": "<f8", "fortran_order": False, "shape": (10**12,)})
        member.write(bytes(80))


def open_header(path) -> None:
    """An npz whose array has a header with a bracket too many."""
    with zipfile.ZipFile(path, "w") as file, file.open("frames.npy", "w") as member:
        member.write(b"\x93NUMPY\x01\x00\x10\x00{'shape': (((,  \n")


DAMAGES = {
    "no arrays": lambda folder: (folder / "plan.npz").unlink(),
    "arrays cut short": lambda folder: (folder / "plan.npz").write_bytes((folder / "plan.npz").read_bytes()[:-200]),
    "arrays empty": lambda folder: (folder / "plan.npz").write_bytes(b""),
    "arrays of noise": lambda folder: (folder / "plan.npz").write_bytes(bytes(range(256)) * 20),
    "facts cut short": lambda folder: (folder / "plan.json").write_text((folder / "plan.json").read_text()[:40]),
    "facts not text": lambda folder: (folder / "plan.json").write_bytes(b"\xff\xfe\x00"),
    "facts a list": lambda folder: (folder / "plan.json").write_text("[1, 2]"),
    "facts null": lambda folder: (folder / "plan.json").write_text("null"),
    "no error": lambda folder: without(folder, "error"),
    "no scene": lambda folder: without(folder, "scene"),
    "unknown reason": lambda folder: edit(folder, stopped="TIRED"),
    "scene a word": lambda folder: edit(folder, scene="here"),
    "scene half": lambda folder: edit(folder, scene={"task": "reach"}),
    "names missing": lambda folder: edit(folder, joint_names=["yaw"]),
    "arrival beyond the end": lambda folder: edit(folder, arrival_step=99),
    "arrival a word": lambda folder: edit(folder, arrival_step="late"),
    "no rate": lambda folder: edit(folder, rate_hz=0),
    "joints not finite": lambda folder: arrays(folder, joints=np.full((5, 2), np.nan)),
    "joints beyond float32": lambda folder: arrays(folder, joints=np.full((5, 2), 1e200)),
    "rate infinite": lambda folder: edit(folder, rate_hz=float("inf")),
    "rate huge": lambda folder: edit(folder, rate_hz=1e300),
    "rate tiny": lambda folder: edit(folder, rate_hz=1e-4),
    "rate a truth": lambda folder: edit(folder, rate_hz=True),
    "rate a huge whole number": lambda folder: edit(folder, rate_hz=10**400),
    "arrival between two steps": lambda folder: edit(folder, arrival_step=3.5),
    "arrival before the start": lambda folder: edit(folder, arrival_step=-1),
    "arrival a truth": lambda folder: edit(folder, arrival_step=True),
    "error not finite": lambda folder: edit(folder, error=float("nan")),
    "seconds a word": lambda folder: edit(folder, seconds="two"),
    "share a word": lambda folder: edit(folder, unexplained="none"),
    "names twice": lambda folder: edit(folder, joint_names=["yaw", "yaw"]),
    "names numbers": lambda folder: edit(folder, joint_names=[1, 2]),
    "names a word": lambda folder: edit(folder, joint_names="ab"),
    "reason a list": lambda folder: edit(folder, stopped=["CONVERGED"]),
    "scene without start": lambda folder: edit(folder, scene={"task": "reach", "start_joints": None, "positions_m": {}}),
    "scene not finite": lambda folder: edit(folder, scene={"task": "reach", "start_joints": [float("nan")], "positions_m": {}}),
    "scene with a word": lambda folder: edit(folder, scene={"task": "reach", "start_joints": [0], "positions_m": {"goal": "here"}}),
    "scene in four dimensions": lambda folder: edit(folder, scene={"task": "reach", "start_joints": [0], "positions_m": {"a": [0] * 4}}),
    "facts nested deep": lambda folder: (folder / "plan.json").write_text("[" * 10_000 + "]" * 10_000),
    "facts of digits": lambda folder: (folder / "plan.json").write_text('{"error": 1' + "0" * 10_000 + "}"),
    "facts a pipe": lambda folder: ((folder / "plan.npz").unlink(), os.mkfifo(folder / "plan.npz")),
    "start not finite": lambda folder: arrays(folder, start_joints=np.array([np.inf, 0])),
    "goal of other joints": lambda folder: arrays(folder, goal_joints=np.zeros(3)),
    "errors not finite": lambda folder: arrays(folder, errors=np.array([np.nan])),
    "intention not finite": lambda folder: arrays(folder, intention=np.array([np.inf])),
    "expected joints of other joints": lambda folder: arrays(folder, expected_joints=np.zeros((1, 3))),
    "frames of numbers": lambda folder: arrays(folder, frames=np.zeros((5, 8, 6, 1))),
    "frames flat": lambda folder: arrays(folder, frames=np.zeros((5, 48), np.uint8)),
    "no frames": lambda folder: arrays(folder, frames=np.zeros((0, 8, 6, 1), np.uint8), joints=np.zeros((0, 2))),
    "start of another size": lambda folder: arrays(folder, start_frame=np.zeros((8, 8, 1), np.uint8)),
    "joints of words": lambda folder: arrays(folder, joints=np.array([["a", "b"]] * 5)),
    "joints of objects": lambda folder: arrays(folder, joints=np.array([[None, None]] * 5)),
    "joints complex": lambda folder: arrays(folder, joints=np.zeros((5, 2), complex)),
    "arrays that unpack to more than there is room for": lambda folder: bomb(folder / "plan.npz", 528 << 20),
    "an array that says it is longer": lambda folder: long_header(folder / "plan.npz"),
    "a header that does not end": lambda folder: open_header(folder / "plan.npz"),
    "fewer joints than frames": lambda folder: arrays(folder, joints=np.zeros((4, 2))),
}


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES.keys())
def test_damage_is_told_in_one_sentence(tmp_path, damage):
    save_plan(make_plan(), tmp_path, scene=SCENE)
    damage(tmp_path)
    with pytest.raises(ValueError, match=r"the plan in .* cannot be read \(.*\): plan again") as told:
        load_plan(tmp_path)
    assert "\n" not in str(told.value)


def test_a_folder_without_a_plan_is_told(tmp_path):
    with pytest.raises(ValueError, match=r"holds no plan .* give a folder that `preimage plan` wrote"):
        load_plan(tmp_path)


# What is said of a plan


@pytest.mark.parametrize(
    ("share", "sentence"),
    [
        (None, "arrives at step 3 (0.6 s), error 1.250, planned in 0.5 s, in plan"),
        (0.012, "reached: arrives at step 3 (0.6 s), error 1.250, 1.2 % of that of staying at the start, planned in 0.5 s, in plan"),
        (0.1, "near: arrives at step 3 (0.6 s), not quite at the goal, error 1.250, 10.0 % of that of staying at the start"),
        (0.96, "in doubt: does not arrive, and is nearest at step 3 (0.6 s), error 1.250, 96.0 % of that of staying at the start"),
    ],
)
def test_a_plan_that_goes_nowhere_does_not_arrive(tmp_path, share, sentence):
    plan = dataclasses.replace(make_plan(), unexplained=share)
    assert sentences_of([plan], plan, Path("plan"))[0].startswith(sentence)
    save_plan(plan, tmp_path)
    loaded, _ = load_plan(tmp_path)
    assert (loaded.unexplained, loaded.verdict) == (share, plan.verdict)


def test_a_plan_from_before_its_share_was_kept_is_loaded(tmp_path):
    save_plan(make_plan(), tmp_path)
    without(tmp_path, "unexplained")
    assert load_plan(tmp_path)[0].verdict is None


def test_the_figure_shows_what_is_commanded_beside_what_is_imagined(tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(figures, "save", lambda drawing, path: drawn.append(drawing) or path)
    plan = make_plan()
    figure(plan, None, tmp_path / "plan.png", commands=plan.joints[:4] + 1, commands_hz=10.0)
    (axes,) = [axes for axes in drawn[0].axes if axes.get_legend()]
    assert [text.get_text() for text in axes.get_legend().get_texts()][:2] == ["imagined", "commanded"]
    dashed = [line for line in axes.get_lines() if line.get_linestyle() == "--"]
    np.testing.assert_allclose([line.get_ydata() for line in dashed], (plan.joints[:4] + 1).T)
    assert dashed[0].get_xdata()[-1] == pytest.approx(0.3)
