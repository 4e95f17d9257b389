"""A plan that was saved is the plan that is loaded; broken files are told in one sentence."""

import csv
import dataclasses
import json

import numpy as np
import pytest

from preimage.data.dataset import load
from preimage.records import Percept, Plan, Scene, Stopped
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
