"""The ablation: every idea alone and left out, on the same goals, row by row."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from preimage.evaluation import ablation
from preimage.evaluation.ablation import Variant, ablate, sign_test, summed_up, variants_of
from preimage.evaluation.recipes import Cell, cells_of, learning_of, network_of
from preimage.presets import PlanOptions
from preimage.report.tables import ablation_table, presets_table


def options_of(variant: Variant) -> PlanOptions:
    return replace(PlanOptions.of(variant.preset), **variant.options)


def test_every_idea_that_full_has_over_regression_is_switched_by_one_row_each_way() -> None:
    variants = variants_of(Cell("move-object"))
    added = {"guess", "candidates", *(name for fields in ablation.SWITCHES.values() for name in fields)}
    regression, full = PlanOptions.regression(), PlanOptions.full()
    assert {name for name in vars(full) if getattr(full, name) != getattr(regression, name)} - {"tolerance"} == added
    by_name = {one.name: options_of(one) for one in variants}
    for name, fields in ablation.SWITCHES.items():
        plus, minus = by_name[f"regression + {name}"], by_name[f"full - {name}"]
        for field in fields:
            assert getattr(plus, field) == getattr(full, field) != getattr(regression, field) == getattr(minus, field)
    assert len({one.name for one in variants}) == len(variants)


def test_an_idea_of_training_is_left_out_of_the_training_alone() -> None:
    with_it, without = (Cell("reach", 25, without=idea) for idea in ("", "mixup"))
    assert learning_of(with_it).mixup > 0 == learning_of(without).mixup
    assert network_of(replace(with_it, task="two-circles")).keypoints > 0 == network_of(Cell("two-circles", without="keypoints")).keypoints
    assert with_it.run != without.run


def test_gains_and_losses_are_counted_goal_by_goal() -> None:
    before, after = ([one_row(letter == "y") for letter in letters] for letters in ("yynn", "ynyy"))
    row = summed_up(after, before)
    assert (row["success"], row["gained"], row["lost"], row["p"]) == (3, 2, 1, 1.0)


def one_row(won: bool) -> dict:
    return {"success": won, "deviation_cm": 1.0, "seconds": 1.0, "iterations": 3, "error": 0.1}


@pytest.mark.parametrize(("gained", "lost", "p"), [(0, 0, 1.0), (5, 5, 1.0), (10, 0, 2 / 1024), (0, 10, 2 / 1024)])
def test_the_sign_test_is_that_of_a_fair_coin(gained: int, lost: int, p: float) -> None:
    assert sign_test(gained=gained, lost=lost) == pytest.approx(p)


@pytest.mark.slow
def test_a_table_goes_on_row_by_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cells = [Cell("reach", num_demonstrations=4, size="tiny", updates=2, goals=2, seed=seed) for seed in (0, 1)]
    rows = [Variant("regression"), Variant("regression", "- hold at the goal", {"hold_goal": False}), Variant("full")]
    rows += [Variant("regression", "+ kriged guess", {"guess": "kriged", "candidates": 1})]  # asks a memory, which regression does not
    monkeypatch.setattr(ablation, "variants_of", lambda cell: rows[:2])
    told: list[str] = []
    ablate(cells, work=tmp_path / "work", out=tmp_path, tell=told.append)
    (file,) = tmp_path.glob("ablation-*.json")
    first = json.loads(file.read_text())
    assert list(first["rows"]) == ["regression", "regression - hold at the goal"]
    assert first["rows"]["regression"]["goals"] == 4
    assert first["training_seeds"] == [0, 1]
    monkeypatch.setattr(ablation, "variants_of", lambda cell: rows)
    ablate(cells, work=tmp_path / "work", out=tmp_path, tell=told.append)
    second = json.loads(file.read_text())
    assert {name: second["rows"][name] for name in first["rows"]} == first["rows"]
    assert "full" in second["rows"]
    assert second["rows"]["regression + kriged guess"]["goals"] == 4
    assert "| reach | 4 | closed | regression - hold at the goal |" in ablation_table([second])


def test_a_bundled_model_has_the_rows_that_need_no_training(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    of_trained, of_bundled = ({one.name for one in variants_of(Cell("move-object", bundled=bundled))} for bundled in (False, True))
    assert of_trained - of_bundled == {"paper", "full - keypoints"}
    monkeypatch.setattr(ablation, "variants_of", lambda cell: [Variant("full")])
    ablate([Cell("reach", goals=1, bundled=True)], work=tmp_path / "work", out=tmp_path, tell=lambda text: None)
    (file,) = tmp_path.glob("ablation-*.json")
    assert json.loads(file.read_text())["rows"]["full"]["goals"] == 1
    assert not (tmp_path / "work").exists()  # nothing was recorded or trained


def test_the_tasks_of_the_table_are_those_asked_for() -> None:
    assert {(cell.task, cell.num_demonstrations) for cell in cells_of("ablation", "small")} == {
        *(("reach", count) for count in (100, 25)),
        *((task, 100) for task in ("two-points", "move-object", "two-circles")),
    }


def test_a_preset_in_an_ablation_counts_among_the_presets() -> None:
    about = {"kind": "ablation", "task": "reach", "num_demonstrations": 25, "size": "small", "loop": "closed", "training_seeds": [0, 1]}
    rows = {name: {"success": 3, "goals": 8} for name in ("paper", "full", "full - expected joints")}
    assert "| reach | 25 | closed |  | 3/8 (38 %, 2 training seeds) |  | 3/8 (38 %, 2 training seeds) |" in presets_table(
        [about | {"rows": rows}]
    )
