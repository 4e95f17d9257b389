"""Clocks and counters among the columns, under any name and in any unit; `check` and `train` agree."""

import numpy as np
import pyarrow.parquet as pq
import pytest

from planar_arm import EIGHT, INFO, NAMES, as_table, assert_read_right, assert_refused_alike, checked, kinds, write_plain, write_v2
from preimage.data.clocks import find_clock, unit_that_agrees
from preimage.data.dataset import load, open_recordings, read_episodes
from preimage.data.view import View
from preimage.examination import Kind
from recordings import edit_json, write_rows

CLOCKS = {
    "timestamp": 1.0,
    "time": 1.0,
    "Time_s": 1.0,
    "stamp": 1.0,
    "t": 1.0,
    "time_ms": 1e3,
    "Time [ms]": 1e3,
    "timestamp_us": 1e6,
    "stamp_ns": 1e9,
    "elapsed_ns": 1e9,
}


@pytest.mark.parametrize("name", CLOCKS)
@pytest.mark.parametrize("column", [0, 1, 2])
@pytest.mark.parametrize("rate", ["10", None])
def test_a_clock_is_no_joint_in_any_column_and_unit(tmp_path, name, column, rate):
    names, now = [*NAMES[:column], name, *NAMES[column:]], 0 if "ns" in name else 1_700_000_000

    def columns(step: int, joints: np.ndarray) -> list:
        values = [f"{value:.6f}" for value in joints]
        return [*values[:column], f"{(now + step / 10) * CLOCKS[name]:.3f}", *values[column:]]

    folder = write_plain(tmp_path / "data", as_table(names, columns), rate=rate, episodes=EIGHT[:1])
    (one,) = load(folder)
    assert (one.joint_names, one.rate_hz) == (("shoulder", "elbow"), 10.0)
    (episode,) = read_episodes(folder)
    np.testing.assert_allclose(np.diff(episode.timestamps_s), 0.1, atol=1e-3)


@pytest.mark.parametrize("names", [("header.stamp.secs", "header.stamp.nsecs"), ("sec", "nanosec"), ("secs", "nsecs")])
@pytest.mark.parametrize("rate", ["10", None])
def test_a_clock_of_ros_in_two_columns_is_one(tmp_path, names, rate):
    """Once the nanoseconds, which fall every second, were a joint where nothing else in their name told of time."""
    ros = as_table([*names, *NAMES], lambda step, joints: [step // 10, step % 10 * 10**8, *joints])
    assert_read_right(write_plain(tmp_path / "ros", ros, rate=rate))


def test_a_date_is_a_clock(tmp_path):
    date = as_table(["time", *NAMES], lambda step, joints: [f"2024-05-01 12:00:{step // 10:02d}.{step % 10}00", *joints])
    assert_read_right(write_plain(tmp_path / "date", date, rate=None))


def test_a_clock_without_a_unit_counts_in_that_which_agrees_with_the_rate(tmp_path):
    table = as_table(["timestamp", *NAMES], lambda step, joints: [100 * step, *joints])
    folder = write_plain(tmp_path / "data", table)
    assert_read_right(folder)
    assert Kind.CLOCK not in kinds(checked(folder))


@pytest.mark.parametrize(("unit", "count"), [("milliseconds", 100), ("microseconds", 100_000), ("nanoseconds", 10**8)])
@pytest.mark.parametrize("name", ["time_s", "timestamp", "time"])
def test_a_rate_that_no_robot_has_is_refused_with_the_unit_to_check(tmp_path, unit, count, name):
    table = as_table([name, *NAMES], lambda step, joints: [17 + count * step, *joints])
    short = {"milliseconds": "ms", "microseconds": "us", "nanoseconds": "ns"}[unit]
    assert_refused_alike(
        write_plain(tmp_path / "data", table, rate=None, episodes=EIGHT[:1]),
        f"as {name} is in seconds: if it counts {unit}, call it time_{short}",
    )


@pytest.mark.parametrize("rate", ["0.01", "33333", "0", "-10", "nan", "fast"])
def test_a_rate_outside_of_what_robots_have_is_refused(tmp_path, rate):
    assert_refused_alike(
        write_plain(tmp_path / "data", rate=rate), "it should hold the number of pictures a second \\(rates are 0.2 to 1000 Hz\\)"
    )
    folder = write_v2(tmp_path / "lerobot", EIGHT[:1])
    edit_json(folder / INFO, lambda info: info.update(fps=float(rate) if rate != "fast" else rate))
    assert_refused_alike(folder, "it should be the number of steps a second; rates are 0.2 to 1000 Hz")


@pytest.mark.parametrize("name", ["frame", "row", "seq", "trigger"])
@pytest.mark.parametrize("layout", ["plain", "v2"])
def test_a_column_that_rises_evenly_is_asked_about(tmp_path, name, layout):
    if layout == "plain":
        folder = write_plain(tmp_path / "data", as_table([*NAMES, name], lambda step, joints: [*joints, 3 * step]))
    else:
        counted = [(frames, np.c_[joints, np.arange(len(joints)) / 7]) for frames, joints in EIGHT]
        folder = write_v2(tmp_path / "data", counted, names=[*NAMES, name])
    assert_refused_alike(folder, f"{name} rises evenly in every episode, .*: leave it out by --view.joints shoulder elbow")
    assert_read_right(folder, view=View(joints=("shoulder", "elbow")))


def test_a_clock_within_the_state_is_left_out(tmp_path):
    timed = [(frames, np.c_[np.arange(len(joints)) / 10, joints]) for frames, joints in EIGHT]
    folder = write_v2(tmp_path / "data", timed, names=["timestamp", *NAMES])
    assert_read_right(folder)
    assert "left out as a clock: timestamp" in open_recordings(folder).summary[-1]
    assert Kind.COUNTER in kinds(checked(folder))


@pytest.mark.parametrize(("seconds", "count"), [(1, 0.1), (10**3, 100), (10**6, 10**5), (10**9, 10**8)])
@pytest.mark.parametrize("name", ["%time", "timestamp", "date"])
def test_a_clock_that_counts_since_1970_says_its_unit_itself(tmp_path, seconds, count, name):
    table = as_table([name, *NAMES], lambda step, joints: [1_700_000_000 * seconds + count * step, *joints])
    assert_read_right(write_plain(tmp_path / "data", table, rate=None))


def test_stamps_of_lerobot_in_milliseconds_are_no_other_rate(tmp_path):
    folder = write_v2(tmp_path / "data")
    for path in folder.glob("data/*/*.parquet"):
        write_rows(path, [row | {"timestamp": 1000 * row["timestamp"]} for row in pq.read_table(path).to_pylist()])
    assert_read_right(folder)
    assert Kind.CLOCK not in kinds(checked(folder))


def test_episodes_of_another_rate_are_named_with_theirs(tmp_path):
    folder = write_plain(tmp_path / "data", as_table(["time_s", *NAMES], lambda step, joints: [step / 10, *joints]), rate=None)
    faster = as_table(["time_s", *NAMES], lambda step, joints: [step / 30, *joints])
    for number in (5, 6):
        (folder / f"take {number}/joints.csv").write_text(faster(EIGHT[number][1]))
    (finding,) = [finding for finding in checked(folder).findings if finding.kind is Kind.CLOCK]
    assert finding.what == "samples of episodes 5, 6 come at 30 Hz, of the others at 10 Hz"
    assert "--without-episodes 5 6" in finding.help


@pytest.mark.parametrize("name", ["remaining_s", "ticks left", "Unnamed: 0"])
def test_what_counts_down_is_asked_about(tmp_path, name):
    counted = [(frames, np.c_[joints, np.arange(len(joints))[::-1]]) for frames, joints in EIGHT]
    folder = write_v2(tmp_path / "data", counted, names=["shoulder", "elbow (right)", name])
    assert_refused_alike(folder, f"{name} falls evenly in every episode, .*: leave it out by --view.joints shoulder 'elbow \\(right\\)'")
    (finding,) = [finding for finding in checked(folder).findings if finding.kind is Kind.COUNTER]
    assert finding.what.startswith(f"{name} falls evenly")


@pytest.mark.parametrize("interleaved", [False, True])
@pytest.mark.parametrize(
    ("beside", "said"),
    [
        (lambda joints: 10 * np.gradient(joints, axis=0), "the speeds of "),
        (lambda joints: np.concatenate([joints[1:], joints[-1:]]), ""),
        (lambda joints: np.concatenate([joints[:1], joints[:-1]]), ""),
    ],
    ids=["speeds", "commands", "the step before"],
)
def test_a_half_that_says_the_other_again_is_asked_about(tmp_path, beside, said, interleaved):
    order = [0, 2, 1, 3] if interleaved else [0, 1, 2, 3]
    folder = write_v2(tmp_path / "data", [(frames, np.c_[joints, beside(joints)][:, order]) for frames, joints in EIGHT], names=[*"abcd"])
    positions = ("a", "c") if interleaved else ("a", "b")
    others = ", ".join(name for name in "abcd" if name not in positions)
    assert_refused_alike(
        folder, f"{others} go as {said}{', '.join(positions)} do, .*: leave them out by --view.joints {' '.join(positions)}"
    )
    assert_read_right(folder, positions, View(joints=positions))
    assert open_recordings(folder, view=View(joints=tuple("abcd"))).demonstrations[0].joint_names == tuple("abcd")


def test_velocities_and_efforts_beside_positions_are_asked_about(tmp_path):
    measured = [(frames, np.c_[joints, 10 * np.gradient(joints, axis=0), np.sin(5 * joints[:, 0])]) for frames, joints in EIGHT]
    names = ["j1.pos", "j2.pos", "j1.vel", "j2.vel", "effort_1"]
    folder = write_v2(tmp_path / "data", measured, names=names)
    assert_refused_alike(folder, "j1.vel, j2.vel, effort_1 are no positions by name, .*: leave them out by --view.joints j1.pos j2.pos")
    assert open_recordings(folder, view=View(joints=tuple(names))).demonstrations[0].joint_names == tuple(names)
    alone = write_v2(tmp_path / "alone", names=["x.vel", "y.vel"])  # a robot that is commanded velocities has nothing else
    assert_read_right(alone, ("x.vel", "y.vel"))


def test_commands_are_asked_about_where_velocities_are_too_and_the_answer_leaves_out_both(tmp_path):
    """Once who did as the question said, and left the velocities out, had named the commands as joints."""
    commanded = [(frames, np.c_[joints, np.r_[joints[1:], joints[-1:]], np.gradient(joints, axis=0)]) for frames, joints in EIGHT]
    names = ["a", "b", "action_a", "action_b", "vel_a", "vel_b"]
    folder = write_v2(tmp_path / "data", commanded, names=names)
    assert_refused_alike(folder, "vel_a, vel_b are no positions by name, .*: leave them out by --view.joints a b")
    (_, commands) = (each for each in checked(folder).findings if each.kind is Kind.COUNTER)
    assert commands.joints == ("action_a", "action_b")


def test_what_an_environment_says_of_a_step_is_asked_about(tmp_path):
    told = as_table([*NAMES, "done", "success"], lambda step, joints: [*joints, step > 7, step > 7])
    folder = write_plain(tmp_path / "data", told)
    assert_refused_alike(folder, f"done, success are no positions by name, .*: leave them out by --view.joints {' '.join(NAMES)}")


@pytest.mark.parametrize("values", [[0.0, np.inf, np.inf, 3.0], [np.nan, 0.1, 0.2, 0.3]])
def test_a_clock_that_is_not_finite_is_none(values):
    times = np.array(values)
    assert unit_that_agrees(times, 10.0) == "s"
    assert find_clock({"time_s": times}, rate_hz=10.0) is None
