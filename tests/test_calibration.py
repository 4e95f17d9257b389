"""Laws of calibration: more evidence never helps, the bound on refusals is the one that is said, and what is kept is what is loaded."""

import json
import shutil
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from preimage.ideas.calibration import Calibration, fit_logistic
from preimage.presets import PlanOptions, load_calibration
from preimage.storage.atomic_write import write_json
from preimage.storage.run_files import CALIBRATION

NAMES = "unexplained", "goal_blend", "disagreement"


def calibrated(seed: int = 0, *, num_possible: int = 60, num_others: int = 40) -> Calibration:
    """By goals that fail where the first two kinds of evidence are large together; the third says nothing."""
    rng = np.random.default_rng(seed)
    rows = np.vstack([rng.normal(size=(num_possible, 3)), rng.normal(2, 1, size=(num_others, 3))])
    reached = rows[:, 0] + rows[:, 1] + 0.3 * rng.normal(size=len(rows)) < 2
    evidence = [dict(zip(NAMES, row.tolist(), strict=True)) for row in rows]
    return Calibration.of(evidence, reached.tolist(), possible=[number < num_possible for number in range(len(rows))])


CALIBRATED = replace(calibrated(), plan=asdict(PlanOptions.full()) | {"precision": None})
NUMBERS = st.floats(-1e6, 1e6)


@given(st.tuples(NUMBERS, NUMBERS, NUMBERS), st.sampled_from(NAMES), st.floats(0, 1e6))
def test_more_of_any_evidence_never_makes_success_likelier(values: tuple[float, ...], name: str, more: float) -> None:
    evidence = dict(zip(NAMES, values, strict=True))
    worse = evidence | {name: evidence[name] + more}
    assert 0 <= CALIBRATED.probability(worse) <= CALIBRATED.probability(evidence) <= 1
    assert CALIBRATED.strangeness(worse) >= CALIBRATED.strangeness(evidence)
    assert CALIBRATED.is_refused(worse) >= CALIBRATED.is_refused(evidence)


def test_probabilities_are_those_of_the_outcomes() -> None:
    rng = np.random.default_rng(1)
    rows = rng.uniform(0, 4, (4000, 1))
    success = rng.random(4000) < 1 / (1 + np.exp(1.5 * rows[:, 0] - 3))
    bias, weights = fit_logistic(rows, success)
    np.testing.assert_allclose([bias, weights[0]], [3, 1.5], atol=0.25)


def test_evidence_of_what_cannot_be_refuses_and_says_nothing_of_how_likely() -> None:
    evidence = [{"error": float(number), "thing": float(number % 3)} for number in range(30)]
    reached = [number < 15 for number in range(30)]
    known = Calibration.of(evidence, reached, possible=reached, refusing=["thing"])
    assert known.weights[0] > 0 == known.weights[1]
    assert known.is_refused({"error": 0.0, "thing": 50.0})
    assert not known.is_refused({"error": 0.0, "thing": 0.0})


def test_evidence_of_how_likely_alone_refuses_nothing() -> None:
    evidence = [{"error": float(number), "start": float(number % 7)} for number in range(30)]
    reached = [number < 15 for number in range(30)]
    known = Calibration.of(evidence, reached, possible=reached, likely_only=["start"])
    assert not known.is_refused({"error": 0.0, "start": 1e3})
    assert known.limit == Calibration.of([{"error": each["error"]} for each in evidence], reached, possible=reached).limit


def test_evidence_that_would_speak_for_a_plan_gets_no_weight() -> None:
    rng = np.random.default_rng(2)
    rows = rng.normal(size=(500, 2))
    _, weights = fit_logistic(rows, rows[:, 0] > rows[:, 1])
    assert weights[0] == 0 < weights[1]


@pytest.mark.parametrize("all_reached", [True, False])
def test_outcomes_that_are_all_alike_give_finite_odds(all_reached: bool) -> None:
    bias, weights = fit_logistic(np.random.default_rng(3).normal(size=(30, 2)), np.full(30, all_reached))
    assert np.isfinite([bias, *weights]).all()
    assert (bias > 1) == all_reached


BOUNDS = [(60, 0, 1 / 41), (147, 0, 1 / 99), (150, 1, 2 / 101), (450, 5, 6 / 301)]


@pytest.mark.parametrize(("num_possible", "stranger", "promised"), BOUNDS)
def test_the_bound_is_the_one_that_is_said(num_possible: int, stranger: int, promised: float) -> None:
    """Every third of the possible goals says what is usual; of the n others the k-th strangest is the limit: k / (n + 1)."""
    made = calibrated(num_possible=num_possible)
    assert (made.num_stranger, made.false_refusals) == (stranger, pytest.approx(promised))
    assert f"less than 1/{made.num_possible + 1} can be promised of no rule" in made.note


def test_possible_goals_are_refused_as_seldom_as_is_said() -> None:
    """Over many calibrations, goals drawn as the possible ones were."""
    rng, refused = np.random.default_rng(4), []
    for seed in range(60):
        made = calibrated(seed)
        refused += [made.is_refused(dict(zip(NAMES, row.tolist(), strict=True))) for row in rng.normal(size=(50, 3))]
    assert np.mean(refused) <= 1 / 41 + 3 * (1 / 41 / len(refused)) ** 0.5


def test_too_few_goals_or_goals_of_different_kinds_are_refused() -> None:
    with pytest.raises(ValueError, match="2 goals that were reached cannot calibrate anything: give 3 or more"):
        Calibration.of([{"a": 0.0}] * 4, [True] * 4, possible=[True, True, False, False])
    with pytest.raises(ValueError, match="the goals have different evidence"):
        Calibration.of([{"a": 0.0}, {"b": 0.0}], [True] * 2, possible=[True] * 2)


# What is kept of a run


@pytest.fixture
def run(run_folder: Path, tmp_path: Path) -> Path:
    shutil.copytree(run_folder, tmp_path / "run")
    write_json(tmp_path / "run" / CALIBRATION, asdict(CALIBRATED))
    return tmp_path / "run"


def test_load_undoes_save(run: Path) -> None:
    assert load_calibration(run) == CALIBRATED


def test_a_run_without_one_has_none(run_folder: Path) -> None:
    assert load_calibration(run_folder) is None


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"weights": [1.0]}, "3 names and 1 weights"),
        ({"spread": [1.0, 0.0, 1.0]}, "a spread is 0"),
        ({"num_possible": "many"}, "num_possible is 'many'"),
        ({"colour": 1}, "colour is not known here"),
    ],
)
def test_a_broken_one_is_told_in_one_sentence(run: Path, change: dict, fault: str) -> None:
    write_json(run / CALIBRATION, asdict(CALIBRATED) | change)
    with pytest.raises(ValueError, match=rf"calibration.json cannot be read \({fault}.*\): remove it, or write it anew"):
        load_calibration(run)


@pytest.mark.parametrize("text", ["", "{", "[1]", json.dumps({"names": []})])
def test_a_file_that_is_none_is_told_too(run: Path, refused, text: str) -> None:
    (run / CALIBRATION).write_text(text)
    code, sentence = refused("plan", run, "--goal", "nowhere.png", "--out", run / "plan")
    assert code == 2
    assert "calibration.json cannot be read" in sentence


def test_it_is_gone_when_the_run_is_trained_on(run: Path, data: Path) -> None:
    from preimage.cli import main

    main(["train", str(data), "--out", str(run), "--size", "tiny", "--updates", "3", "--resume"])
    assert load_calibration(run) is None


def test_a_calibration_for_other_options_is_not_taken(trained, memory) -> None:
    from bars import FULL, bar
    from preimage.presets import Planner

    planner = Planner(trained, memory, replace(FULL, iterations=1), replace(CALIBRATED, plan={"iterations": 12}))
    trust = planner.plan(goal=bar(0.5).last).trust
    assert trust is not None
    assert (trust.probability, trust.refused) == (None, False)
    assert trust.note == "not calibrated for plans with these options: plans are ranked, and none is refused"
