"""Laws of trust: it reads a plan and changes nothing, it knows what cannot be, and what is refused does not move."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from bars import FULL, REGRESSION, bar
from preimage.cli import main
from preimage.evaluation.impossible import BENCH, PRACTICE, Source
from preimage.evaluation.trust import AREA, RIM, Assessed, bootstrap, calibration_error, reliability, result_of_trust, roc_area
from preimage.ideas.calibration import Calibration
from preimage.ideas.trust import ALREADY_THERE, NOT_IMAGINED, OFF_DEMONSTRATED, REASONS, START_UNLIKE, Assessment
from preimage.ideas.waypoints import join, least_of
from preimage.method.plan import plan as plan_by_the_method
from preimage.presets import Planner, PlanOptions, load_calibration, load_planner
from preimage.records import GoalRefused, Percept, Plan, Shown, Trust
from preimage.report.results import write_results
from preimage.robot import TASKS, Arm, Reach
from preimage.robot.rim import RIM_M, beyond_area_m, end_of, sample_rim, sense_ends
from preimage.storage.bundled import BUNDLED
from preimage.storage.plans import load_plan, save_plan
from preimage.storage.run_files import CALIBRATION

QUICK = replace(FULL, iterations=2)


@pytest.fixture(scope="module")
def planner(trained, memory) -> Planner:
    return Planner(trained, memory, QUICK)


def refusing(planner: Planner, *, above: float = 3.0) -> Planner:
    """The same, calibrated by a hand: whatever is far beyond what the six bars show is refused."""
    shown = [planner.assessment.evidence(planner.plan(start=bar(far).first, goal=Percept(bar(far).last.frame))) for far in (0.4, 0.6, 0.8)]
    names = tuple(shown[0])
    usual = tuple(max(one[name] for one in shown) for name in names)
    ones = (1.0,) * len(names)
    options = asdict(planner.options) | {"precision": None}
    return Planner(planner.model, planner.memory, QUICK, Calibration(names, usual, ones, ones, 3.0, above, 50, 0, 60, 55, options))


# It only reads


@pytest.mark.parametrize("options", [QUICK, replace(REGRESSION, iterations=2)])
def test_a_plan_is_the_same_to_the_bit_with_trust_and_without(trained, memory, options: PlanOptions) -> None:
    planner, ends = Planner(trained, memory, options), {"start": bar(0.5).first, "goal": Percept(bar(0.7).last.frame)}
    found = planner.plan(**ends)
    alone = plan_by_the_method(trained, **ends, config=planner.options, ideas=planner.ideas)
    assert alone.trust is None
    assert found.trust is not None
    for name in ("frames", "joints", "intention", "errors", "imagined_joints", "error", "arrival_step"):
        np.testing.assert_array_equal(getattr(found, name), getattr(alone, name))


def test_without_calibration_it_says_so_and_refuses_nothing(planner: Planner) -> None:
    trust = planner.plan(goal=Percept(np.zeros((16, 16, 1), np.uint8))).trust
    assert trust is not None
    assert (trust.probability, trust.refused, trust.reasons) == (None, False, ())
    assert trust.note == "not calibrated: plans are ranked, and none is refused"
    assert trust.sentence == "trust: not calibrated, no probability"


def test_uncalibrated_ranks_still_put_what_cannot_be_last(planner: Planner) -> None:
    black, noise = np.zeros((16, 16, 1), np.uint8), np.random.default_rng(0).integers(0, 256, (16, 16, 1), np.uint8)
    frames = bar(0.7).last.frame, black, noise
    possible, black, noise = (planner.plan(start=bar(0.5).first, goal=Percept(frame)).trust for frame in frames)
    assert possible is not None
    assert black is not None
    assert noise is not None
    assert possible.strangeness < min(black.strangeness, noise.strangeness)


def test_all_evidence_has_words(planner: Planner) -> None:
    assert set(planner.assessment.evidence(planner.plan(goal=Percept(bar(0.5).last.frame)))) <= set(REASONS)


def test_a_way_that_passes_elsewhere_than_demonstrations_pause_is_told(planner: Planner) -> None:
    found = planner.plan(start=bar(0.5).first, goal=Percept(bar(0.7).last.frame))
    aside = replace(found, joints=found.joints + 0.3 * np.ptp(found.joints, axis=0))
    evidence, of_aside = (planner.assessment.evidence(one) for one in (found, aside))
    assert of_aside["off_pause"] > evidence["off_pause"]
    assert of_aside["pause_uncertainty"] == evidence["pause_uncertainty"]


def test_of_many_demonstrations_some_tell_where_there_is_a_pause(trained, memory, monkeypatch: pytest.MonkeyPatch) -> None:
    """All of them would have their matrices inverted for seconds, or, those chosen by the start, at every plan."""
    monkeypatch.setattr("preimage.ideas.trust.MAX_FIT_POINTS", 5)
    few = Planner(trained, memory, QUICK)
    evidence = few.assessment.evidence(few.plan(start=bar(0.5).first, goal=Percept(bar(0.7).last.frame)))
    demonstrated = few.assessment.demonstrated
    assert demonstrated is not None
    assert [len(each.features) for each in demonstrated.looks] == [5] * 4
    assert np.isfinite([evidence["off_pause"], evidence["pause_uncertainty"]]).all()


def test_plans_without_memory_or_without_a_picture_have_less_evidence(trained, memory) -> None:
    bare = Planner(trained, None, replace(REGRESSION, iterations=1)).plan(goal=Percept(bar(0.5).last.frame)).trust
    felt = Planner(trained, memory, replace(QUICK, modalities="joints")).plan(goal=Percept(joints=bar(0.5).last.joints)).trust
    assert bare is not None
    assert felt is not None
    assert set(bare.evidence) == {"unexplained", "start_residual", "goal_residual", "goal_worst_place"}
    assert set(felt.evidence) == {"unexplained", "start_residual"}


# What cannot be


def test_black_noise_and_the_start_are_refused_and_possible_goals_are_not(planner: Planner) -> None:
    strict, start = refusing(planner), bar(0.5).first
    noise = np.random.default_rng(0).integers(0, 256, (16, 16, 1), np.uint8)
    wanted = {NOT_IMAGINED: np.zeros((16, 16, 1), np.uint8), OFF_DEMONSTRATED: noise, ALREADY_THERE: start.frame}
    for reason, frame in wanted.items():
        trust = strict.plan(start=start, goal=Percept(frame)).trust
        assert trust is not None
        assert trust.refused
        assert reason in trust.reasons
    for far in (0.5, 0.7):
        trust = strict.plan(start=start, goal=Percept(bar(far).last.frame)).trust
        assert trust is not None
        assert not trust.refused
        assert 0 <= trust.probability <= 1


def test_a_start_that_nothing_began_like_is_a_reason(planner: Planner) -> None:
    start = Percept(255 - bar(0.5).first.frame, bar(0.5).first.joints + 0.4)
    trust = refusing(planner).plan(start=start, goal=Percept(bar(0.5).last.frame)).trust
    assert trust is not None
    assert START_UNLIKE in trust.reasons


def test_legs_are_trusted_as_the_least_of_them(planner: Planner) -> None:
    legs = planner.plan_in_turn(goals=[Percept(bar(far).last.frame) for far in (0.4, 0.8)])
    assert join(legs).trust in [leg.trust for leg in legs]
    assert legs[1].trust is not None
    assert legs[1].trust.note == "not calibrated for goals after the first: plans are ranked, and none is refused"
    sure, unsure, refused = Trust(0.9), Trust(0.4), Trust(0.6, refused=True)
    assert least_of([sure, unsure]) is unsure
    assert least_of([sure, unsure, refused]) is refused
    assert least_of([sure, None]) is None


# The bundled models


@pytest.fixture(scope="module")
def to_a_goal() -> tuple[Planner, Plan, Source]:
    """A plan of the bundled model of reach to a goal that can be reached."""
    planner, arm, task = load_planner("reach"), Arm(), Reach()
    scene = task.sample(np.random.default_rng(700))
    start, goal = sense_ends(arm, task, scene)
    found = planner.plan(start=start, goal=Percept(goal.frame))
    return planner, found, Source(arm, task, scene, start, goal.frame, np.random.default_rng(0))


@pytest.mark.parametrize("name", BUNDLED)
def test_the_bundled_models_come_calibrated(name: str) -> None:
    known = load_calibration(name)
    assert known is not None
    assert known.num_reached < known.num_goals, "some goals failed, or nothing could be learned"
    assert known.plan == asdict(PlanOptions.full()) | {"precision": None}


def test_a_possible_goal_is_trusted(to_a_goal) -> None:
    _, found, _ = to_a_goal
    assert not found.trust.refused
    assert found.trust.probability > 0.5


@pytest.mark.parametrize("kind", ["black", "noise", "rotated", "the start", "negative"])
def test_the_same_plan_for_another_goal_is_refused(to_a_goal, kind: str) -> None:
    planner, found, source = to_a_goal
    goal = PRACTICE[kind](source.goal, source.rng) if kind in PRACTICE else BENCH[kind](source)
    trust = planner.assessment(replace(found, goal=Percept(np.ascontiguousarray(goal))))
    assert trust.refused
    assert trust.reasons


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["black", "noise", "the start"])
def test_the_bundled_model_refuses_what_cannot_be(to_a_goal, kind: str) -> None:
    planner, _, source = to_a_goal
    assert planner.plan(start=source.start, goal=Percept(BENCH[kind](source))).trust.refused


# Refusing


@pytest.fixture
def refused_plan(planner: Planner) -> Plan:
    found = planner.plan(start=bar(0.5).first, goal=Percept(bar(0.7).last.frame))
    return replace(found, trust=Trust(0.03, True, (NOT_IMAGINED,), "calibrated by 60 goals", 9.5, {"unexplained": 1.5}))


@pytest.mark.parametrize("trust", [None, Trust(), Trust(0.25, True, ("one", "other"), "note", 4.5, {"unexplained": -1.5})])
def test_trust_is_saved_and_loaded(tmp_path: Path, refused_plan: Plan, trust: Trust | None) -> None:
    save_plan(replace(refused_plan, trust=trust), tmp_path / "plan")
    assert load_plan(tmp_path / "plan")[0].trust == trust


def test_broken_trust_is_told_in_one_sentence(tmp_path: Path, refused_plan: Plan) -> None:
    save_plan(refused_plan, tmp_path)
    about = json.loads((tmp_path / "plan.json").read_text())
    for broken, fault in ({"probability": "high"}, "probability is 'high'"), ({"probability": 1.5}, "probability is 1.5"):
        (tmp_path / "plan.json").write_text(json.dumps(about | {"trust": about["trust"] | broken}))
        with pytest.raises(ValueError, match=rf"cannot be read \({fault}.*\): plan again"):
            load_plan(tmp_path)


def test_a_refused_plan_is_not_executed(tmp_path: Path, refused_plan: Plan, scene, refused) -> None:
    save_plan(refused_plan, tmp_path, scene=scene)
    assert refused("execute", tmp_path) == (
        1,
        f"the goal is refused: {NOT_IMAGINED} (calibrated by 60 goals); execute all the same with --anyway",
    )
    code, sentence = refused("execute", tmp_path, "--anyway")
    assert code == 2, "it is of another arm, but it is taken"
    assert "reach needs joint1" in sentence


def test_plan_refuses_with_exit_code_1_and_writes_anyway(
    tmp_path: Path, run_folder: Path, data: Path, monkeypatch, refused, capsys
) -> None:
    verdict = Trust(0.02, True, (NOT_IMAGINED,), "calibrated by 60 goals")
    monkeypatch.setattr(Assessment, "__call__", lambda self, plan: verdict)
    words = "plan", run_folder, "--goal", f"{data}:0", "--out", tmp_path / "plan", "--iterations", "1"
    code, sentence = refused(*words)
    assert (code, sentence) == (1, f"the goal is refused: {NOT_IMAGINED} (calibrated by 60 goals); plan all the same with --anyway")
    assert not (tmp_path / "plan").exists()
    main([*map(str, words), "--anyway"])
    assert "trust: 2 % likely to succeed (the goal is not found in what can be imagined)" in capsys.readouterr().out
    assert load_plan(tmp_path / "plan")[0].trust == verdict


def test_refusing_is_work_that_failed_not_words_that_are_off() -> None:
    assert not issubclass(GoalRefused, ValueError)


# The goals it is calibrated and examined by


@pytest.mark.parametrize("name", TASKS)
def test_the_rim_is_beyond_what_is_demonstrated_and_within_reach(name: str) -> None:
    task = TASKS[name]
    for seed in range(5):
        scene = sample_rim(task, np.random.default_rng(seed))
        beyond = [beyond_area_m(task, place) for place in scene.positions_m.values()]
        assert 0 < max(beyond) <= RIM_M
        assert sum(each > 0 for each in beyond) == 1
        assert np.isfinite(end_of(task, scene)[0]).all()
    inside = task.sample(np.random.default_rng(0))
    assert not any(beyond_area_m(task, place) for place in inside.positions_m.values())


@pytest.mark.parametrize("name", BUNDLED)
def test_a_solved_scene_is_solved(name: str) -> None:
    """What is photographed as the end is one in the judge's eyes, as far as it looks at the end alone."""
    task, arm = TASKS[name], Arm()
    scene = task.sample(np.random.default_rng(3))
    sense_ends(arm, task, scene)
    judged = task.judge(scene, [arm.ground_truth()])
    assert judged.deviation_m < 1e-3


def test_the_bench_has_twelve_kinds_that_calibration_has_not() -> None:
    assert len(BENCH) == 12
    assert not set(BENCH) & set(PRACTICE)


@pytest.mark.parametrize("name", BUNDLED)
def test_impossible_goals_are_pictures_unlike_the_goal_and_their_own(name: str) -> None:
    task, arm = TASKS[name], Arm()
    scene = task.sample(np.random.default_rng(5))
    start, goal = sense_ends(arm, task, scene)
    frames = {kind: make(Source(arm, task, scene, start, goal.frame, np.random.default_rng(1))) for kind, make in BENCH.items()}
    frames |= {kind: make(goal.frame, np.random.default_rng(1)) for kind, make in PRACTICE.items()}
    for kind, frame in frames.items():
        assert (frame.shape, frame.dtype) == (goal.frame.shape, np.uint8), kind
        assert np.abs(frame.astype(int) - goal.frame).max() > 30, kind
        others = [other for other_kind, other in frames.items() if other_kind != kind]
        assert not any(np.array_equal(frame, other) for other in others), kind


# What it is worth


def test_the_area_under_the_roc_is_that_of_pairs() -> None:
    rng = np.random.default_rng(0)
    scores, reached = rng.normal(size=40), rng.random(40) < 0.6
    pairs = [(good > bad) + 0.5 * (good == bad) for good in scores[reached] for bad in scores[~reached]]
    assert roc_area(scores, reached) == pytest.approx(np.mean(pairs))
    assert roc_area(-scores, reached) == pytest.approx(1 - np.mean(pairs))
    assert roc_area(scores, np.ones(40, bool)) == 0.5
    low, high = bootstrap(scores, reached)
    assert low <= roc_area(scores, reached) <= high


def test_the_calibration_error_is_0_where_what_is_said_comes_true() -> None:
    said, reached = np.repeat([0.25, 0.75], 4), np.array([True, False, False, False, True, True, True, False])
    assert calibration_error(said, reached) == 0
    assert calibration_error(1 - said, reached) == pytest.approx(0.5)
    assert reliability(said, reached) == [(0.25, 0.25, 4), (0.75, 0.75, 4)]


def test_results_have_a_table_a_figure_and_baselines(tmp_path: Path, planner: Planner, refused_plan: Plan) -> None:
    trusted = replace(refused_plan, trust=Trust(0.97))
    assessed = [Assessed(AREA, trusted, True)] * 3 + [Assessed(RIM, refused_plan, False), Assessed(RIM, trusted, True)]
    assessed += [Assessed("black", refused_plan, False), Assessed("noise", trusted, False)]
    shown = [Shown(bar(0.5).frames[-1], bar(0.5).joints, 2.5)]
    about = {"task": "reach", "model": "reach", "seed": 5100, "num_calibrated_by": 60}
    result = result_of_trust(assessed, shown, about)
    assert result["roc_area"] == {"trust": 1.0, "plan's error": 0.5, "nearest demonstration": 0.5}
    assert (result["refused"]["black"]["refused"], result["refused"]["noise"]["refused"]) == (1, 0)
    assert (result["falsely_refused"]["refused"], result["falsely_refused"]["goals"]) == (0, 3)
    json.dumps(result, allow_nan=False)
    (tmp_path / "trust.json").write_text(json.dumps(result))
    (tmp_path / "other.json").write_text((Path(__file__).parents[1] / "results" / "reach-100-small-closed-5073.json").read_text())
    page = write_results(tmp_path, tmp_path / "docs" / "results.md").read_text()
    assert "## Trust" in page
    assert "| black | 1/1" in page
    assert (tmp_path / "docs" / "figures" / "trust.png").stat().st_size > 0


def test_calibrate_and_evaluate_refuse_what_makes_no_sense(run_folder: Path, tmp_path: Path, refused) -> None:
    assert refused("calibrate", run_folder, "--goals", "3") == (2, "--goals is 3: give 12 to 10000")
    code, sentence = refused("evaluate", run_folder, "--impossible", "--out", tmp_path / "trust.json")
    assert code == 2
    assert sentence.startswith(f"{run_folder} is not calibrated for plans with these options: run `preimage calibrate {run_folder}`")


@pytest.mark.slow
def test_calibrate_leaves_a_calibration_that_plans_speak_by(run_folder: Path, tmp_path: Path, capsys) -> None:
    import shutil

    shutil.copytree(run_folder, tmp_path / "run")
    search = ["--iterations", "1", "--horizon", "4"]
    main(["calibrate", str(tmp_path / "run"), "--goals", "12", *search])
    assert "calibrated by 27 goals" in capsys.readouterr().out
    assert (tmp_path / "run" / CALIBRATION).is_file()
    main(["evaluate", str(tmp_path / "run"), "--impossible", "--goals", "10", "--out", str(tmp_path / "trust.json"), *search])
    assert len(json.loads((tmp_path / "trust.json").read_text())["rows"]) == 10 + 7 + 12
