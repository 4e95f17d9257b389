"""The experiments: which cells there are, their figures by hand, and one of them from nothing to its JSON, stopped everywhere."""

import json
import multiprocessing
import shutil
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from preimage.evaluation.experiments import goals_of, principal_plane, rank_correlation, reproduce
from preimage.evaluation.recipes import GRIPPING, Cell, cells_of, learning_of, network_of
from preimage.network.config import ModelConfig, Sensors
from preimage.network.pdvmrnn import PDVMRNN
from preimage.presets import SIZES, Preset, TrainOptions
from preimage.records import Demonstration
from preimage.report.results import fill_readme, write_results
from preimage.robot import TASKS

FORKS = multiprocessing.get_context("forkserver")
FORKS.set_forkserver_preload([__name__])
"""Processes that begin where another has loaded already what takes seconds: one is killed often, and starts in some milliseconds."""


def test_all_cells_of_the_paper() -> None:
    assert [(cell.num_demonstrations, cell.seed) for cell in cells_of("table-2", "small")] == [
        (n, s) for n in (100, 50, 25) for s in range(3)
    ]
    assert {cell.task for cell in cells_of("all", "paper")} == {"reach", "two-points", "move-object", "two-circles"}
    with pytest.raises(ValueError, match="table-9 is no table"):
        cells_of("table-9", "small")


def test_larger_frames_are_a_cell_of_their_own() -> None:
    larger = [cell for cell in cells_of("table-3", "small") if cell.pixels != 64]
    assert [(cell.name, cell.filmed.workspace.camera.height) for cell in larger] == [("move-object-100-128px-small-seed0", 128)]
    network = network_of(larger[0])
    ladder = PDVMRNN(network, Sensors(128, 128, 1, ("a",), (0.0,), (1.0,))).state_shapes
    plain = PDVMRNN(ModelConfig.small(), Sensors(64, 64, 1, ("a",), (0.0,), (1.0,))).state_shapes
    assert ladder["top"] == plain["top"]
    assert ladder["vision4"] == plain["vision3"]


def test_neighbours_that_stay_neighbours_correlate_fully() -> None:
    places = np.array([[0.0, 0.0], [1.0, 0.0], [3.0, 0.0], [7.0, 0.0]])
    assert rank_correlation(2 * places, places.tolist()) == 1.0


def test_the_plane_holds_what_differs_most() -> None:
    rows = np.array([[0.0, 0.0, 1.0], [10.0, 0.0, 1.0], [0.0, 5.0, 1.0], [10.0, 5.0, 1.0]])
    flat = np.array(principal_plane(rows)(rows))
    assert np.ptp(np.abs(flat), axis=0).max() < 1e-9
    assert np.abs(flat[0]).tolist() == pytest.approx([5.0, 2.5])


def test_presets_share_what_they_train_alike_and_nothing_else() -> None:
    full, regression, paper = (Cell("reach", preset=preset) for preset in ("full", "regression", "paper"))
    assert paper.run == regression.run == paper.name != full.run == full.name
    assert network_of(regression) == network_of(paper) != network_of(full)
    gripping = Cell("move-object", preset="regression")
    assert gripping.run == Cell("move-object").run
    assert network_of(gripping) == network_of(Cell("move-object"))
    assert regression.name not in (full.name, full.run)
    paper_on_two, on_two = (Cell("two-points", preset=preset) for preset in ("paper", "regression"))
    assert on_two.run == on_two.name != paper_on_two.run
    assert network_of(on_two) == network_of(paper_on_two)
    assert learning_of(on_two) == replace(learning_of(paper_on_two), later_starts=learning_of(Cell("two-points")).later_starts)
    assert len({each.name for each in (full, regression, paper)}) == 3


def test_the_paper_is_trained_with_its_network_and_with_no_idea() -> None:
    for task in TASKS:
        cell = Cell(task, num_demonstrations=25, size="tiny", preset="paper", seed=2)
        assert learning_of(cell) == TrainOptions(seed=2)
        network, usual = network_of(cell), ModelConfig.tiny().as_paper()
        assert replace(network, intention_layers=usual.intention_layers, intention_noise=usual.intention_noise) == usual
        assert (network == usual) is (task not in GRIPPING)
    assert network_of(Cell("reach", size="paper", preset="paper")) == ModelConfig.paper()
    assert learning_of(Cell("reach", num_demonstrations=25)).mixup > 0


def test_updates_that_are_asked_for_stand_above_the_recipe() -> None:
    assert learning_of(Cell("two-points", updates=7)).updates == 7
    assert learning_of(Cell("two-points")).updates != TrainOptions().updates


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["paper", "regression"])
def test_a_cell_of_another_preset_plans_without_memory(preset: Preset, tmp_path) -> None:
    cell = Cell("reach", num_demonstrations=4, size="tiny", updates=2, goals=1, preset=preset, seed=1)
    reproduce([cell], work=tmp_path / "work", out=tmp_path / "results", tell=lambda text: None)
    result = json.loads((tmp_path / "results" / f"{cell.name}-closed.json").read_text())
    assert result["preset"] == preset
    assert set(result["baselines"]) == {"do_nothing", "nearest_demonstration", "prior_mean"}
    assert (result["plan"]["search"], result["plan"]["guess"]) == ("adam", {"paper": "random", "regression": "nearest"}[preset])


@pytest.mark.slow
def test_a_cell_from_nothing_to_the_page_and_not_twice(tmp_path, monkeypatch) -> None:
    cell = Cell("reach", num_demonstrations=4, size="tiny", updates=3, goals=3, loops=("closed", "open"))
    told: list[str] = []
    reproduce([cell], work=tmp_path / "work", out=tmp_path / "results", tell=told.append)
    closed = json.loads((tmp_path / "results" / f"{cell.name}-closed.json").read_text())
    baselines = {"do_nothing", "nearest_demonstration", "memory_alone", "prior_mean", "behaviour_cloning"}
    assert baselines == closed["baselines"].keys()
    assert (tmp_path / "results" / f"{cell.name}-recognition.json").exists()
    (tmp_path / "results" / f"{cell.name}-recognition.json").unlink()  # as if stopped before it was written
    shutil.rmtree(tmp_path / "work" / "runs" / cell.name)  # and its training before the first checkpoint
    (tmp_path / "work" / "runs" / cell.name).mkdir()
    reproduce([cell], work=tmp_path / "work", out=tmp_path / "results", tell=told.append)
    assert (tmp_path / "results" / f"{cell.name}-recognition.json").exists()
    told.clear()
    reproduce([cell], work=tmp_path / "work", out=tmp_path / "results", tell=told.append)
    assert told == [f"{cell.name}: done before"]
    with pytest.raises(ValueError, match="with other settings: remove it, or give another --work"):
        reproduce([replace(cell, updates=4)], work=tmp_path / "work", out=tmp_path / "others", tell=told.append)
    monkeypatch.setitem(SIZES, "tiny", lambda: replace(ModelConfig.tiny(), motor_units=(14, 8)))
    with pytest.raises(ValueError, match="with other settings: remove it, or give another --work"):
        reproduce([cell], work=tmp_path / "work", out=tmp_path / "others", tell=told.append)
    page = write_results(tmp_path / "results", tmp_path / "results.md").read_text()
    assert f"{closed['success']}/3" in page
    readme = tmp_path / "README.md"
    readme.write_text("before <!-- results:begin -->old<!-- results:end --> after")
    fill_readme(tmp_path / "results", readme)
    assert "old" not in readme.read_text()
    assert readme.read_text().startswith("before")
    assert readme.read_text().endswith("after")


def reproduce_in(place: Path) -> None:
    cell = Cell("reach", num_demonstrations=4, size="tiny", updates=3, goals=1, preset="paper", seed=1)
    reproduce([cell], work=place / "work", out=place / "results", tell=lambda text: None)


@pytest.mark.slow
def test_killed_at_any_moment_a_reproduction_goes_on_and_leaves_nothing_behind(tmp_path) -> None:
    def begun(place: Path):
        process = FORKS.Process(target=reproduce_in, args=[place])
        process.start()
        return process

    def ends(place: Path) -> int | None:
        process = begun(place)
        process.join()
        return process.exitcode

    def left(place: Path) -> set[str]:
        return {str(path.relative_to(place)) for path in place.rglob("*")}

    began = time.monotonic()
    assert ends(tmp_path / "whole") == 0
    took = time.monotonic() - began
    for share in (0.05, 0.2, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9):
        process = begun(tmp_path / "killed")
        time.sleep(share * took)
        process.kill()
        process.join()
        results = tmp_path / "killed" / "results"
        assert all(json.loads(path.read_text()) for path in results.glob("*.json"))
    assert ends(tmp_path / "killed") == 0
    assert left(tmp_path / "killed") == left(tmp_path / "whole")


def test_goals_are_where_the_judge_measures_from() -> None:
    for task, wanted in (("reach", "goal"), ("two-points", "goal"), ("move-object", "circle"), ("two-circles", "circle")):
        scene = TASKS[task].sample(np.random.default_rng(0))
        shown = Demonstration(np.zeros((2, 8, 8, 1), np.uint8), np.zeros((2, 1)), 1.0, ("a",), scene)
        assert goals_of([shown]) == [list(scene.positions_m[wanted][:2])]


def test_a_folder_without_evaluations_makes_no_page(tmp_path) -> None:
    with pytest.raises(ValueError, match="holds no evaluation"):
        write_results(tmp_path, tmp_path / "results.md")
