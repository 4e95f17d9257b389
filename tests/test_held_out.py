"""Held-out episodes: which they are, how far plans are from them, and what is said about it."""

import json
import shutil
from dataclasses import asdict, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import preimage
from preimage import cli
from preimage.data.dataset import fingerprint
from preimage.evaluation.held_out import (
    Way,
    compare,
    errors_of,
    every_nth,
    lines_of,
    moments,
    never_shown,
    result_of_comparison,
    way_of,
    write_films,
)
from preimage.presets import Planner, PlanOptions, remember
from preimage.records import Percept, Plan, Shown, Stopped
from preimage.report.tables import evaluations_among, held_out_table
from recordings import edit_json
from shared import make_demonstration

QUICK = ["--iterations", "1", "--horizon", "4"]


def shown_of(demonstration) -> Shown:
    return Shown(demonstration.frames[-1], demonstration.joints, demonstration.rate_hz)


@given(st.integers(2, 200).flatmap(lambda count: st.tuples(st.just(count), st.integers(2, count))))
def test_every_nth_is_held_out_and_the_others_are_not(counts):
    count, nth = counts
    held_out = every_nth(count, nth)
    assert len(held_out) == count // nth
    assert all((episode + 1) % nth == 0 for episode in held_out)


@pytest.mark.parametrize("nth", [1, -2, 4])
def test_nothing_to_train_on_or_to_hold_out_is_told(nth):
    with pytest.raises(ValueError, match=rf"hold-out is {nth} with 3 episodes: give 2 to as many as there are, or 0"):
        every_nth(3, nth)


def test_an_episode_that_was_trained_on_is_found_whatever_its_number(demonstrations):
    others = [make_demonstration(seed, num_steps=7) for seed in (20, 21)]
    shown = [shown_of(replace(one, joints=one.joints.astype(np.float32).astype(float))) for one in demonstrations]
    assert never_shown([others[0], *demonstrations, others[1]], shown) == [0, 4]
    assert never_shown(demonstrations, shown) == []


@given(st.integers(2, 30), st.integers(2, 40))
def test_moments_begin_and_end_with_the_way_and_a_line_stays_a_line(steps, count):
    way = np.linspace([0.0, 1.0], [3.0, -1.0], steps)
    np.testing.assert_allclose(moments(way, count), np.linspace([0.0, 1.0], [3.0, -1.0], count), atol=1e-12)


def test_a_way_has_no_error_to_itself_whatever_its_pace():
    """The same straight way in twice the time, frames aside."""
    slow = make_demonstration(num_steps=9)
    fast = replace(slow, frames=slow.frames[::2], joints=slow.joints[::2])
    same = errors_of(slow, Way(slow.joints, slow.frames[-1], slow.frames))
    assert set(asdict(same).values()) == {0.0}
    paced = errors_of(slow, Way(fast.joints, fast.frames[-1]))
    assert (paced.joints_at_arrival, paced.frame_at_arrival, paced.frames_on_the_way) == (0, 0, None)
    assert paced.joints_on_the_way == pytest.approx(0, abs=1e-12)


def test_errors_by_hand():
    recorded = make_demonstration(num_joints=2, num_steps=3, size=(16, 16, 1))
    off = errors_of(recorded, Way(recorded.joints + np.array([3.0, -4.0]), recorded.frames[-1], recorded.frames))
    assert off.joints_at_arrival == pytest.approx(3.5)
    assert off.joints_at_arrival_rms == pytest.approx(np.sqrt(12.5))
    assert (off.joints_on_the_way, off.joints_on_the_way_rms) == (pytest.approx(3.5), pytest.approx(np.sqrt(12.5)))
    darker = recorded.frames - np.uint8(10)
    assert errors_of(recorded, Way(recorded.joints, darker[-1], darker)).frame_at_arrival == pytest.approx(100)


def test_a_plan_without_memory_has_no_baseline_of_it(model, demonstrations):
    planner = Planner(model, None, PlanOptions(iterations=0, candidates=1, horizon=4))
    (one,) = compare(planner, {2: make_demonstration(30, num_steps=7)}, shown=[shown_of(each) for each in demonstrations])
    assert set(one.baselines) == {"nearest_demonstration", "prior_mean", "staying"}


def test_what_a_plan_imagines_after_its_arrival_is_not_looked_at():
    recorded = make_demonstration(num_steps=6)
    frames = np.concatenate([recorded.frames, 255 - recorded.frames])
    joints = np.concatenate([recorded.joints, recorded.joints + 1])
    start, goal = recorded.first, Percept(recorded.last.frame)
    known = {"error": 0.0, "errors": np.zeros(1), "stopped": Stopped.CONVERGED, "seconds": 0.0, "intention": np.zeros(1)}
    plan = Plan(frames, joints, 5, 10.0, recorded.joint_names, start, goal, **known)
    assert set(asdict(errors_of(recorded, way_of(plan))).values()) == {0.0}


@pytest.fixture(scope="module")
def compared(model, demonstrations):
    others = {3: make_demonstration(30, num_steps=7), 8: make_demonstration(31, num_steps=9)}
    planner = Planner(model, remember(demonstrations, model), replace(PlanOptions.full(), iterations=1, horizon=4))
    return compare(planner, others, shown=[shown_of(one) for one in demonstrations])


def test_the_planner_sees_the_two_ends_alone(compared):
    for one in compared:
        np.testing.assert_array_equal(one.plan.goal.frame, one.demonstration.last.frame)
        assert one.plan.goal.joints is None
        assert one.plan.start.joints is not None


def test_baselines_are_those_that_were_named(compared, demonstrations):
    for one in compared:
        stay = one.baselines["staying"]
        assert stay.joints_at_arrival == pytest.approx(np.abs(one.demonstration.joints[-1] - one.demonstration.joints[0]).mean())
        wanted = one.demonstration.last.frame.astype(float)
        nearest = min(demonstrations, key=lambda each, wanted=wanted: np.square(each.frames[-1] - wanted).sum())
        by_hand = np.abs(nearest.joints[-1] - one.demonstration.joints[-1]).mean()
        assert one.baselines["nearest_demonstration"].joints_at_arrival == pytest.approx(by_hand)
        expected = one.baselines["memory_alone"]
        assert expected.joints_at_arrival == pytest.approx(np.abs(one.plan.expected_joints[-1] - one.demonstration.joints[-1]).mean())
        assert (expected.frame_at_arrival, expected.frames_on_the_way) == (None, None)


def test_a_result_survives_json_and_agrees_with_its_rows(compared):
    result = json.loads(json.dumps(result_of_comparison(compared, {"model": "here"})))
    assert (result["model"], result["episodes"], len(result["rows"])) == ("here", [3, 8], 2)
    for name, counted in {"imagined": result["imagined"], **result["baselines"]}.items():
        rows = [row[name] if name == "imagined" else row["baselines"][name] for row in result["rows"]]
        for error, spread in counted.items():
            values = [row[error] for row in rows]
            assert (spread is None) == (None in values)
            if spread:
                assert spread["mean"] == pytest.approx(np.mean(values), abs=1e-5)
                assert spread["median"] == pytest.approx(np.median(values), abs=1e-5)
    mean = result["imagined"]["joints_at_arrival"]["mean"]
    assert np.mean(list(result["imagined_by_joint"].values())) == pytest.approx(mean, abs=1e-5)
    share = result["imagined_as_share_of"]["staying"]["frame_at_arrival"]
    assert share == pytest.approx(
        result["imagined"]["frame_at_arrival"]["mean"] / result["baselines"]["staying"]["frame_at_arrival"]["mean"], abs=1e-3
    )


def test_what_is_printed_claims_no_success(compared):
    result = result_of_comparison(compared, {})
    lines = lines_of(result)
    assert lines[0] == "2 episodes never trained on: 3, 8"
    assert "no success rate" in lines[-1]
    share = result["imagined_as_share_of"]["nearest_demonstration"]["joints_at_arrival"]
    assert lines[7] == f"At arrival the imagined joints are off by {share:.2f} of the error of nearest_demonstration, on average."
    assert lines[8].startswith("At arrival the imagined frame is off by ")
    ways = ["imagined", "nearest_demonstration", "memory_alone", "prior_mean", "staying"]
    assert [line.split()[0] for line in lines[2:7]] == ways


def test_films_show_best_median_and_worst(compared, tmp_path):
    ranked = sorted(compared, key=lambda one: one.imagined.joints_at_arrival)
    assert [path.name for path in write_films(compared, tmp_path)] == [
        f"best-episode-{ranked[0].episode}.mp4",
        f"worst-episode-{ranked[1].episode}.mp4",
    ]
    assert all(path.stat().st_size > 0 for path in tmp_path.iterdir())


@pytest.mark.usefixtures("unchecked")
def test_recordings_of_another_robot_are_told(model):
    with pytest.raises(ValueError, match=r"episode 0 has joints \('joint 0', .*the model was trained with"):
        compare(Planner(model), {0: make_demonstration(num_joints=5)}, shown=[])


# On the command line


@pytest.fixture(scope="module")
def five(tmp_path_factory):
    folder = tmp_path_factory.mktemp("held-out") / "five"
    preimage.save([make_demonstration(seed, num_steps=6) for seed in range(5)], folder, task="reach")
    return folder


@pytest.fixture(scope="module")
def held_out_run(five, tmp_path_factory):
    """Resumed without naming what is held out: it stays held out."""
    folder = tmp_path_factory.mktemp("held-out") / "run"
    cli.main(["train", str(five), "--out", str(folder), "--size", "tiny", "--updates", "2", "--hold-out", "2"])
    cli.main(["train", str(five), "--out", str(folder), "--size", "tiny", "--resume"])
    return folder


def test_a_run_tells_what_it_was_not_trained_on(held_out_run, five):
    config = json.loads((held_out_run / "config.json").read_text())
    assert config["data"]["held_out"] == [1, 3]
    assert config["data"]["fingerprint"] == fingerprint(preimage.load(five))
    assert (config["num_demonstrations"], config["num_sequences"]) == (3, 3)
    recorded = preimage.load(five)
    for one, episode in zip(preimage.read_shown(held_out_run), (0, 2, 4), strict=True):
        np.testing.assert_array_equal(one.last_frame, recorded[episode].frames[-1])


@pytest.mark.parametrize(("held_out", "said"), [(None, "nothing"), ([[1]], "a list"), ("1", "'1'")])
def test_a_run_that_was_changed_goes_on_with_no_other_episodes(refused, held_out_run, five, tmp_path, held_out, said):
    run = shutil.copytree(held_out_run, tmp_path / "run")
    edit_json(run / "config.json", lambda config: config["data"].update(held_out=held_out))
    sentence = f"{run}/config.json holds out {said}, not numbers of episodes: restore it or train again"
    assert refused("train", five, "--out", run, "--resume") == (2, sentence)


@pytest.mark.parametrize("about", [None, [], "x", {"name": []}])
def test_a_run_that_does_not_say_what_it_learned_from_is_compared(held_out_run, five, tmp_path, about):
    run = shutil.copytree(held_out_run, tmp_path / "run")
    edit_json(run / "config.json", lambda config: config.update(data=about))
    cli.main(["evaluate", str(run), "--data", str(five), "--out", str(tmp_path / "result.json"), *QUICK])
    assert json.loads((tmp_path / "result.json").read_text())["episodes"] == [1, 3]


def test_evaluate_plans_for_the_held_out_episodes(capsys, held_out_run, five, tmp_path):
    words = ["--data", str(five), "--out", str(tmp_path / "result.json"), "--films", str(tmp_path / "films"), *QUICK]
    cli.main(["evaluate", str(held_out_run), *words])
    printed = capsys.readouterr().out
    result = json.loads((tmp_path / "result.json").read_text())
    assert result["episodes"] == [1, 3]
    assert result["data"]["rest_was_trained_on"] is True
    assert "success_rate" not in result
    assert printed.startswith("2 episodes never trained on: 1, 3\n")
    assert len(list((tmp_path / "films").glob("*.mp4"))) == 2


def test_evaluate_plans_for_all_episodes_of_other_data(run_folder, tmp_path):
    preimage.save([make_demonstration(seed) for seed in (40, 41)], tmp_path / "other", task="reach")
    cli.main(["evaluate", str(run_folder), "--data", str(tmp_path / "other"), "--out", str(tmp_path / "result.json"), *QUICK])
    result = json.loads((tmp_path / "result.json").read_text())
    assert (result["episodes"], result["data"]["rest_was_trained_on"]) == ([0, 1], False)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--data", "{data}"], "was trained on every episode of {data}: train with --hold-out 4, or give other recordings"),
        (["--films", "films"], "--films shows recorded beside imagined, and there is no recording: give --data too"),
    ],
)
def test_nothing_to_compare_with_is_told(capsys, run_folder, data, words, sentence):
    with pytest.raises(SystemExit) as left:
        cli.main(["evaluate", str(run_folder), *(word.format(data=data) for word in words)])
    assert left.value.code == 2
    assert sentence.format(data=data) in capsys.readouterr().err


def test_the_page_of_results_passes_over_comparisons(compared):
    assert not evaluations_among([result_of_comparison(compared, {"kind": "held-out", "task": "reach"})])


def test_recordings_that_were_held_out_have_a_row_for_each_way():
    errors = {name: {"mean": 0.25, "median": 0.125} for name in ("joints_at_arrival", "joints_on_the_way", "frame_at_arrival")}
    held_out = {
        "kind": "held-out",
        "model": "run",
        "data": {"name": "mine"},
        "episodes": [3, 7],
        "imagined": errors,
        "baselines": {"staying": errors},
    }
    ways = [line.split(" | ")[:5] for line in held_out_table([held_out, {"task": "reach"}]).splitlines() if "| mine" in line]
    assert ways == [["| mine", "run", "2", way, "0.25 (0.125)"] for way in ("imagined", "staying")]
    assert held_out_table([{"task": "reach"}]) == ""
