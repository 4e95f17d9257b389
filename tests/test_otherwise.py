"""Episodes that were recorded otherwise than the rest are named, by `check` and `train` alike; sound recordings never are."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from planar_arm import Recorded, checked, recorded, write_v2
from preimage.cli.training import open_to_learn_from
from preimage.data.view import View
from preimage.examination import Kind
from preimage.examination.otherwise import recorded_otherwise
from preimage.robot import TASKS, Arm, record, with_frames
from preimage.storage.recordings import save


@dataclass(frozen=True, eq=False)
class Begun:
    index: int
    joint_names: tuple[str, ...]
    joints: np.ndarray
    first: np.ndarray


ODD = (1, 4, 6)
Change = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]

CHANGES: dict[str, tuple[str, Change]] = {
    "degrees": ("times larger .*: degrees beside radians", lambda frames, joints: (frames, np.degrees(joints))),
    "millimetres": ("times larger .*: thousandths beside ones", lambda frames, joints: (frames, 1000 * joints)),
    "exchanged": (
        r"in other columns \(shoulder, elbow\)",
        lambda frames, joints: (frames, joints[:, ::-1]),
    ),
    "mirrored": ("are mirrored beside", lambda frames, joints: (frames[:, :, ::-1], joints)),
    "upside down": ("are upside down beside", lambda frames, joints: (frames[:, ::-1, ::-1], joints)),
    "BGR": ("with red and blue exchanged beside", lambda frames, joints: (frames[..., ::-1], joints)),
}


def textured() -> Recorded:
    """The recordings, on a table that is no even surface, as any that a camera sees."""
    patches = np.random.default_rng(1).integers(-30, 30, (12, 16, 3)).repeat(4, 0).repeat(4, 1)
    return [(np.clip(frames.astype(int) + patches, 0, 255).astype(np.uint8), joints) for frames, joints in recorded()]


@pytest.mark.parametrize("odd", [ODD, (0,), (0, 2, 5)], ids=str)
@pytest.mark.parametrize("change", CHANGES)
def test_episodes_recorded_otherwise_are_named(tmp_path, change, odd):
    sentence, changed = CHANGES[change]
    episodes = [changed(*each) if number in odd else each for number, each in enumerate(textured())]
    data = write_v2(tmp_path / "data", episodes)
    (finding,) = [each for each in checked(data).findings if each.kind is Kind.OTHERWISE]
    assert finding.episodes == odd
    with pytest.raises(ValueError, match=f"{sentence}.*--without-episodes {' '.join(map(str, odd))}") as told:
        open_to_learn_from(data, View(), rate_hz=2.5)
    assert str(told.value) == f"{finding.what}: {finding.help}"
    open_to_learn_from(data, View(), rate_hz=2.5, without=odd)


@pytest.mark.parametrize(
    ("change", "joint"),
    [
        (lambda joints: joints + np.array([0.5, 0]), "shoulder"),
        (lambda joints: joints * (1, -1), "elbow"),
        (lambda joints: (0, 1) - joints, ""),
    ],
    ids=["an offset", "the other way round", "both"],
)
def test_an_arm_that_was_calibrated_anew_in_between_is_told(tmp_path, change, joint):
    """By one joint that starts elsewhere in the same picture; where several do, nobody can say."""
    episodes = [(frames, change(joints) if number in ODD else joints) for number, (frames, joints) in enumerate(textured())]
    found = [each for each in checked(write_v2(tmp_path / "data", episodes)).findings if each.kind is Kind.ZERO]
    assert [(each.joints, each.episodes) for each in found] == ([((joint,), ODD)] if joint else [])
    assert len(checked(tmp_path / "data").warnings) == len(found)
    _, told = open_to_learn_from(tmp_path / "data", View(), rate_hz=2.5)
    says = f"preimage check {tmp_path / 'data'} says where, and what would help"
    assert told == ([f"1 warning (another zero): {says}"] if found else []), "training tells how many warnings there are"


@pytest.mark.parametrize("odd", [(1, 3, 5, 7), (2,)], ids=str)
def test_episodes_that_were_played_backwards_are_told(tmp_path, odd):
    episodes = [(frames[::-1], joints[::-1]) if number in odd else (frames, joints) for number, (frames, joints) in enumerate(recorded())]
    found = [each for each in checked(write_v2(tmp_path / "data", episodes)).warnings if each.kind is Kind.BACKWARDS]
    assert [each.episodes for each in found] == [odd]
    there_and_back = [(np.concatenate([frames, frames[::-1]]), np.concatenate([joints, joints[::-1]])) for frames, joints in recorded()]
    for name, sound in (("sound", recorded()), ("there and back", there_and_back)):
        assert Kind.BACKWARDS not in {each.kind for each in checked(write_v2(tmp_path / name, sound)).findings}


@pytest.mark.parametrize("steps", [slice(0, 2), slice(-1, None), slice(2, 4)], ids=str)
@pytest.mark.parametrize("odd", [range(8), (3,)], ids=str)
def test_rows_of_zeros_are_no_joints(tmp_path, steps, odd):
    episodes = [(frames, joints.copy()) for frames, joints in recorded()]
    for number in odd:
        episodes[number][1][steps] = 0
    data = write_v2(tmp_path / "data", episodes)
    (finding,) = [each for each in checked(data).findings if each.kind is Kind.UNRECORDED]
    assert finding.episodes == tuple(odd)
    assert finding.places == tuple((number, step) for number in odd for step in range(20)[steps])
    with pytest.raises(ValueError, match="all joints are zero at episode") as told:
        open_to_learn_from(data, View(), rate_hz=2.5)
    assert str(told.value) == f"{finding.what}: {finding.help}"


@pytest.mark.parametrize("task", TASKS)
def test_sound_recordings_are_left_alone(task, tmp_path):
    save(record(Arm(), with_frames(TASKS[task], 32), count=8, seed=3), tmp_path / "data", task=task)
    opened, _ = open_to_learn_from(tmp_path / "data", View(), rate_hz=2.5)
    assert len(opened.demonstrations) == 8


def test_a_lamp_a_thing_that_is_put_elsewhere_and_another_pose_are_no_other_recording():
    """Warm light in half of the episodes, a large thing that lies left or right of an even table, half of the arms begun elsewhere."""
    rng = np.random.default_rng(0)
    table = np.full((48, 64, 3), (140, 120, 100), np.uint8)
    begun = []
    for number in range(12):
        frame = table.copy()
        column = 4 if number % 2 else 44
        frame[10:30, column : column + 16] = (200, 180, 60)
        warm = np.clip(frame * (1.15, 1.0, 0.8) if number % 3 else frame, 0, 255).astype(np.uint8)
        joints = np.linspace(rng.uniform(-1, 1, 4), rng.uniform(-1, 1, 4), 20)
        begun.append(Begun(number, tuple("abcd"), joints, warm))
    assert not [*recorded_otherwise(begun)]
