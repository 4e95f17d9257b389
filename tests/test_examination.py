"""The doctor finds each fault that is planted, names it and finds nothing else; in healthy recordings it finds nothing to mend."""

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from preimage.cli import main
from preimage.examination import Examination, Kind, Severity, examine
from preimage.examination.seen import largest_blob
from preimage.examination.viewpoint import find_shift
from preimage.records import Description, Episode
from preimage.report.examined import examined_page
from recordings import CAMERA, write_v21

NUM_EPISODES, RATE_HZ, NAMES = 20, 10.0, ("yaw", "shoulder", "gripper")
SIZE = 48, 64
ILL = 5
"""The episode that a fault is planted in."""

Fault = Callable[[list[Episode]], list[Episode]]


def room(shift: tuple[int, int] = (0, 0)) -> np.ndarray:
    """What the camera sees of the room without the robot: patches of many shades."""
    patches = np.random.default_rng(1).integers(60, 140, (12, 12))
    return np.roll(np.kron(patches, np.ones((6, 6), int))[: SIZE[0], : SIZE[1]], shift, (0, 1))


@cache
def healthy(seed: int = 0) -> list[Episode]:
    """Smooth ways from one start to goals all over the room, with a rest; a bright hand shows where the first two joints are, the third
    closes at once."""
    rng = np.random.default_rng(seed)
    return [episode(index, rng) for index in range(NUM_EPISODES)]


def episode(index: int, rng: np.random.Generator) -> Episode:
    num_steps = int(rng.integers(24, 36))
    way = np.clip(np.arange(num_steps) / (num_steps - 6), 0, 1)[:, None]
    goal = rng.uniform((-0.8, 0.2), (0.8, 1.2))
    hand = np.array([0.0, 0.1]) + (10 * way**3 - 15 * way**4 + 6 * way**5) * (goal - (0.0, 0.1))
    joints = np.column_stack([hand, (way[:, 0] > 0.5) * 0.04]) + rng.normal(0, 1e-4, (num_steps, 3))
    frames = np.repeat(room()[None], num_steps, 0)
    for frame, (yaw, shoulder, _) in zip(frames, joints, strict=True):
        row, column = 2 + int(28 * shoulder), 28 + int(30 * yaw)
        frame[row : row + 8, column : column + 8] = 220
    frames = np.clip(frames + rng.normal(0, 1, frames.shape), 0, 255).astype(np.uint8)[..., None]
    return Episode(index, frames, joints, NAMES, np.arange(num_steps) / RATE_HZ, num_steps, RATE_HZ, "reach")


def found(examination: Examination, *severities: Severity) -> set[Kind]:
    return {finding.kind for finding in examination.findings if finding.severity in (severities or tuple(Severity))}


def in_one(change: Callable[[Episode], Episode]) -> Fault:
    """The fault planted in one episode."""
    return lambda episodes: [change(one) if one.index == ILL else one for one in episodes]


def in_all(change: Callable[[Episode], Episode]) -> Fault:
    return lambda episodes: [change(one) for one in episodes]


def with_joint(one: Episode, joint: int, values, steps=slice(None)) -> Episode:
    joints = one.joints.copy()
    joints[steps, joint] = values(joints[steps, joint])
    return replace(one, joints=joints)


def with_times(one: Episode, change: Callable[[np.ndarray], np.ndarray]) -> Episode:
    assert one.timestamps_s is not None
    return replace(one, timestamps_s=change(one.timestamps_s.copy()))


def cut(one: Episode, num_steps: int) -> Episode:
    times = None if one.timestamps_s is None else one.timestamps_s[:num_steps]
    return replace(one, frames=one.frames[:num_steps], joints=one.joints[:num_steps], timestamps_s=times, declared_length=num_steps)


def seen_from(one: Episode, shift: tuple[int, int]) -> Episode:
    return replace(one, frames=np.roll(one.frames, shift, (1, 2)))


def repeated(one: Episode, times: int) -> Episode:
    """The same way, so many times as slow."""
    assert one.timestamps_s is not None
    num_steps = times * len(one.joints)
    way = np.linspace(0, len(one.joints) - 1, num_steps)
    joints = np.column_stack([np.interp(way, np.arange(len(one.joints)), joint) for joint in one.joints.T])
    noise = np.random.default_rng(0).integers(0, 2, (num_steps, *one.frames.shape[1:]), np.uint8)
    frames = one.frames[way.round().astype(int)] + noise
    return replace(one, joints=joints, frames=frames, timestamps_s=np.arange(num_steps) / RATE_HZ, declared_length=num_steps)


def again(episodes: list[Episode]) -> list[Episode]:
    """Episode 5 shows what episode 2 has shown."""
    return [replace(episodes[2], index=ILL) if one.index == ILL else one for one in episodes]


def elsewhere(one: Episode) -> Episode:
    """Starts at another place each time; comes to the same goal on the same clock."""
    aside = np.clip(1 - np.arange(len(one.joints)) / 10, 0, 1) * np.random.default_rng(one.index).uniform(-0.5, 0.5)
    return with_joint(one, 0, lambda joint: joint + aside)


def out_of_sight(one: Episode) -> Episode:
    """The hand has left the picture when the last frame is taken."""
    last = room() + np.random.default_rng(one.index).normal(0, 1, SIZE)
    return replace(one, frames=np.concatenate([one.frames[:-1], last.astype(np.uint8)[None, ..., None]]))


FAULT, WARNING, NOTE = Severity
PLANTED: dict[str, tuple[Kind, Severity, Fault]] = {
    "a frame was lost": (Kind.LENGTHS, FAULT, in_one(lambda one: replace(one, frames=np.delete(one.frames, 9, 0)))),
    "a frame too many": (Kind.LENGTHS, FAULT, in_one(lambda one: replace(one, frames=np.concatenate([one.frames, one.frames[-1:]])))),
    "the index counts otherwise": (Kind.LENGTHS, FAULT, in_one(lambda one: replace(one, declared_length=one.declared_length + 1))),
    "no frames": (Kind.DURATION, FAULT, in_one(lambda one: cut(one, 1))),
    "a damaged picture": (Kind.UNREADABLE, FAULT, in_one(lambda one: replace(one, frames=one.frames[:-1], faults=("step 9 is torn",)))),
    "another size": (Kind.UNLIKE, FAULT, in_one(lambda one: replace(one, frames=one.frames[:, :40]))),
    "another rate": (Kind.UNLIKE, FAULT, in_one(lambda one: replace(one, rate_hz=5.0))),
    "no number": (Kind.NOT_FINITE, FAULT, in_one(lambda one: with_joint(one, 1, lambda _: np.nan, 7))),
    "left running": (Kind.DURATION, WARNING, in_one(lambda one: repeated(one, 4))),
    "a dropped sample": (Kind.CLOCK, WARNING, in_one(lambda one: with_times(one, lambda t: t + (np.arange(len(t)) > 9) / RATE_HZ))),
    "jitter": (Kind.CLOCK, WARNING, in_one(lambda one: with_times(one, lambda t: t + 0.04 * (np.arange(len(t)) % 2)))),
    "another clock": (Kind.CLOCK, WARNING, in_all(lambda one: with_times(one, lambda t: 1.2 * t))),
    "a clock that stands": (Kind.CLOCK, WARNING, in_all(lambda one: with_times(one, lambda t: 0 * t))),
    "a clock without end": (Kind.CLOCK, WARNING, in_one(lambda one: with_times(one, lambda t: np.where(np.arange(len(t)) > 8, np.inf, t)))),
    "a frozen joint": (Kind.FROZEN, NOTE, in_all(lambda one: with_joint(one, 1, lambda joint: 0 * joint + 0.3))),
    "a spike": (Kind.JUMP, WARNING, in_one(lambda one: with_joint(one, 1, lambda joint: joint + 0.8, 8))),
    "a leap": (Kind.JUMP, WARNING, in_one(lambda one: with_joint(one, 0, lambda joint: joint - 2.5, slice(8, 12)))),
    "full turns": (Kind.RANGE, WARNING, in_all(lambda one: with_joint(one, 0, lambda joint: joint + 4 * np.pi))),
    "cut off": (Kind.UNREST, WARNING, in_one(lambda one: cut(one, len(one.joints) // 2))),
    "starts differ": (Kind.STARTS, NOTE, in_all(elsewhere)),
    "a black episode": (Kind.BLANK, WARNING, in_one(lambda one: replace(one, frames=np.zeros_like(one.frames)))),
    "a dark camera": (Kind.BLANK, FAULT, in_all(lambda one: replace(one, frames=one.frames // 128))),
    "a stuck camera": (Kind.STUCK, WARNING, in_one(lambda one: replace(one, frames=np.repeat(one.frames[:1], len(one.frames), 0)))),
    "a camera that is pushed": (Kind.MOVED, WARNING, lambda some: [seen_from(one, (3, -2)) if one.index >= ILL else one for one in some]),
    "a goal shown twice": (Kind.DUPLICATES, WARNING, again),
    "a hand out of sight": (Kind.UNTOLD, WARNING, in_all(out_of_sight)),
}


@cache
def ill(name: str | None) -> Examination:
    return examine(PLANTED[name][2](healthy()) if name else healthy())


@pytest.mark.parametrize("seed", range(4))
def test_healthy_recordings_have_nothing_to_mend(seed):
    examination = examine(iter(healthy(seed)))
    assert not found(examination, FAULT, WARNING), [str(finding) for finding in examination.findings]
    assert examination.trainable
    assert examination.verdict.startswith("Ready to train")


@pytest.mark.parametrize("name", PLANTED)
def test_a_planted_fault_is_found_and_nothing_else(name):
    kind, severity, _ = PLANTED[name]
    before, after = ill(None), ill(name)
    assert found(after, FAULT, WARNING) | (found(after) - found(before)) == {kind}, [str(finding) for finding in after.findings]
    assert {finding.severity for finding in after.findings if finding.kind is kind} == {severity}
    assert after.trainable == (severity is not FAULT)
    assert after.verdict.startswith({FAULT: "Mend first: ", WARNING: "Will train, but: ", NOTE: "Ready to train"}[severity])
    assert severity is NOTE or kind.value in after.verdict


@pytest.mark.parametrize(
    ("name", "places", "joints"),
    [
        ("no number", ((ILL, 7),), ("shoulder",)),
        ("a spike", ((ILL, 8),), ("shoulder",)),
        ("a leap", ((ILL, 8), (ILL, 12)), ("yaw",)),
        ("a dropped sample", ((ILL, 10),), ()),
        ("a stuck camera", ((ILL, 0),), ()),
    ],
)
def test_a_fault_is_found_where_it_is(name, places, joints):
    (finding,) = [finding for finding in ill(name).findings if finding.kind is PLANTED[name][0]]
    assert (finding.episodes, finding.places, finding.joints) == ((ILL,), places, joints)


@pytest.mark.parametrize("name", [name for name, (_, severity, _) in PLANTED.items() if severity is not NOTE])
def test_every_fault_says_which_episode_and_what_would_help(name):
    kind = PLANTED[name][0]
    for finding in ill(name).findings:
        if finding.kind is kind:
            assert finding.help
            everywhere = kind in (Kind.CLOCK, Kind.RANGE, Kind.BLANK, Kind.UNTOLD) and len(finding.episodes) != 1
            assert everywhere or finding.episodes == (ILL,)


@pytest.mark.parametrize("name", PLANTED)
def test_verbs_agree_with_the_number_of_joints(name):
    for finding in ill(name).findings:
        if len(finding.joints) == 1 and (verb := re.match(rf"{finding.joints[0]} (?:hardly )?(\w+)", finding.what)):
            assert verb[1].endswith("s"), finding.what


def test_two_faults_are_both_found():
    planted = PLANTED["a spike"][2](PLANTED["a camera that is pushed"][2](healthy()))
    assert found(examine(planted), FAULT, WARNING) == {Kind.JUMP, Kind.MOVED}


def test_degrees_are_as_good_as_radians():
    in_degrees = in_all(lambda one: replace(one, joints=np.degrees(one.joints)))
    for name in ("a spike", "a frozen joint", "cut off"):
        assert found(examine(in_degrees(PLANTED[name][2](healthy())))) == found(ill(name))


@pytest.mark.parametrize("shift", [(2, 0), (0, 2), (-3, 1), (4, 4), (6, -6)])
def test_a_shift_of_the_camera_is_measured(shift):
    before, after = room().astype(np.float32), room(shift).astype(np.float32)
    assert find_shift(before, after, np.ones(SIZE, bool)) == shift


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6, 1.0])
def test_the_largest_patch_is_the_largest_that_a_flood_fills(share):
    rng = np.random.default_rng(0)
    for mask in (rng.random(rng.integers(1, 12, 2)) < share for _ in range(50)):
        left, sizes = {*zip(*np.nonzero(mask), strict=True)}, [0]
        while left:
            reached = [left.pop()]
            for row, column in reached:
                beside = {(row - 1, column), (row + 1, column), (row, column - 1), (row, column + 1)} & left
                left -= beside
                reached += beside
            sizes.append(len(reached))
        assert largest_blob(mask) == max(sizes)


@pytest.mark.parametrize("shift", [(0, 0), (1, 0), (0, -1)])
def test_a_camera_that_trembles_by_a_pixel_has_not_moved(shift):
    before, after = room().astype(np.float32), room(shift).astype(np.float32)
    assert find_shift(before, after, np.ones(SIZE, bool)) is None


def test_light_and_things_put_elsewhere_are_no_camera_that_moved():
    def changed(one: Episode) -> Episode:
        frames = one.frames + np.uint8(25)
        frames[:, 30:46, 4:20] = 40
        return replace(one, frames=frames)

    assert Kind.MOVED not in found(examine(in_one(changed)(healthy())))


def test_a_camera_move_says_between_which_episodes_and_who_shares_a_viewpoint():
    examination = ill("a camera that is pushed")
    (move,) = examination.moves
    assert (move.before, move.after, move.shift) == (ILL - 1, ILL, (3, -2))
    (finding,) = [finding for finding in examination.findings if finding.kind is Kind.MOVED]
    assert "between episodes 4 and 5; 15 of 20 episodes in a row share a viewpoint (episodes 5 to 19)" in finding.what


def test_goals_on_a_table_lie_as_densely_as_they_are_many():
    """The yardstick of coverage, on a table: joints that are the place of the goal itself."""
    rng = np.random.default_rng(0)
    some = healthy()[:1] * 200
    spread = [
        replace(one, index=index, frames=one.frames[:, :8, :8], joints=np.linspace([0, 0], rng.uniform(0, 1, 2), len(one.joints)))
        for index, one in enumerate(some)
    ]
    spread = [replace(one, joint_names=NAMES[:2]) for one in spread]
    (finding,) = [finding for finding in examine(spread).findings if finding.kind is Kind.GOALS]
    assert 140 < float(finding.what.split("lie as densely as ")[1].split()[0]) < 270


def test_the_scene_tells_the_size_of_what_moves_and_what_a_crop_would_make_of_it():
    """In the upper left quarter a square of 6 pixels moves by its own width and more: two squares differ, one of them counts."""

    def small(one: Episode) -> Episode:
        frames = np.full((len(one.frames), 64, 64, 1), 90, np.uint8)
        for step, frame in enumerate(frames):
            row, column = step * 7 % 26, step * 11 % 26
            frame[row : row + 6, column : column + 6] = 220
        return replace(one, frames=frames)

    (finding,) = [finding for finding in examine(in_all(small)(healthy())).findings if finding.kind is Kind.SCENE]
    assert "what moves is 6 pixels wide; cropped to 0 to 48 % of the height and 0 to 48 % of the width it would be 12" in finding.what


def test_without_episodes_there_is_nothing_to_say():
    with pytest.raises(ValueError, match="there is no episode to look at: record one or more"):
        examine([])


@pytest.mark.parametrize("count", [1, 2])
def test_few_episodes_are_examined(count):
    assert examine(healthy()[:count]).trainable


@pytest.mark.parametrize("size", [(1, 3), (3, 1), (1, 1)], ids=str)
def test_pictures_of_one_row_are_examined(size):
    assert examine([replace(one, frames=one.frames[:, : size[0], : size[1]]) for one in healthy()[:3]]).findings


@pytest.mark.parametrize("name", ["another size", "no frames", "a leap", "a camera that is pushed", "a dark camera"])
def test_the_page_holds_its_pictures(name, tmp_path):
    examination = ill(name)
    words = examined_page(examination, tmp_path / "check.html", title="<mine>").read_text()
    assert words.count('src="data:image/png;base64,') == words.count("src=") == 3 + bool(examination.moves)
    assert "&lt;mine&gt;" in words
    assert examination.verdict in words
    assert all(finding.kind.value in words for finding in examination.findings)


def test_a_page_without_any_frame_is_a_page(tmp_path):
    empty = in_all(lambda one: replace(one, frames=one.frames[:0]))
    examination = examine(empty(healthy()))
    assert not examination.trainable
    assert "src=" not in examined_page(examination, tmp_path / "check.html", title="empty").read_text()


@pytest.mark.parametrize("damaged", [(0,), (0, 1)])
def test_videos_that_cannot_be_read_are_told_even_where_the_first_is_one(damaged, tmp_path, capsys):
    folder = write_v21(tmp_path / "data")
    for number in damaged:
        (folder / f"videos/chunk-000/{CAMERA}/episode_{number:06d}.mp4").write_bytes(b"cut short")
    with pytest.raises(SystemExit):
        main(["check", str(folder), "--out", str(tmp_path / "check.html")])
    *_, verdict = capsys.readouterr().out.splitlines()
    assert verdict.startswith("Mend first: unreadable parts.")


def test_the_verb_prints_a_finding_a_line_and_the_verdict_last(data, tmp_path, capsys):
    main(["check", str(data), "--out", str(tmp_path / "check.html")])
    *lines, verdict = capsys.readouterr().out.splitlines()
    assert verdict.startswith(("Ready to train", "Will train, but"))
    assert all(line.startswith(("warning: ", "note: ", "the pictures are in ")) for line in lines)
    assert (tmp_path / "check.html").is_file()


def test_the_verb_ends_with_1_when_a_fault_makes_training_impossible(monkeypatch, tmp_path, capsys):
    description = Description("folder", {"camera": (48, 64, 1)}, NAMES, 10.0, 20)
    monkeypatch.setattr("preimage.data.dataset.describe", lambda *_, **__: description)
    monkeypatch.setattr("preimage.data.dataset.episode_numbers", lambda *_, **__: list(range(20)))
    monkeypatch.setattr("preimage.data.dataset.read_episodes", lambda *_, **__: iter(PLANTED["a frame was lost"][2](healthy())))
    with pytest.raises(SystemExit) as stopped:
        main(["check", "mine", "--out", str(tmp_path / "check.html")])
    assert stopped.value.code == 1
    assert capsys.readouterr().out.splitlines()[-1].startswith("Mend first: missing or extra frames.")
