"""What each idea brings: the paper's method, regression with each idea alone, and full without each, on the same goals.

Ideas of planning share the trained models of a task. Ideas of training have models of their own, on the tasks they were made for
(`recipes.TRAINING_IDEAS`). Every row is compared goal by goal with the preset it changes: goals that it gains and goals that it loses.

>>> round(sign_test(gained=1, lost=7), 3), sign_test(gained=0, lost=0)
(0.07, 1.0)
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from math import comb
from pathlib import Path
from typing import Any

import numpy as np
import torch

from preimage.compute.devices import CPU
from preimage.evaluation.evaluate import carry_out, goal_of, share
from preimage.evaluation.experiments import TELL, demonstrations_of, planner_of
from preimage.evaluation.loops import Loop
from preimage.evaluation.recipes import GRIPPING, TEST_GOALS, TEST_SEED, TRAINING_IDEAS, Cell, paper_of
from preimage.method.learner import Progress
from preimage.presets import Planner, PlanOptions, Preset, load_memory, load_planner
from preimage.records import Demonstration
from preimage.robot import Arm, record
from preimage.storage.atomic_write import write_json
from preimage.storage.provenance import provenance
from preimage.storage.reading import read_json
from preimage.storage.runs import find_run, made_from

PAPER, REGRESSION, FULL = PlanOptions.paper(), PlanOptions.regression(), PlanOptions.full()
SWITCHES: dict[str, tuple[str, ...]] = {
    "kriged guess": ("guess", "candidates"),
    "Gauss-Newton": ("search", "iterations", "dimensions"),
    "expected joints": ("expected_joints",),
    "end correction": ("end_correction",),
    "gripper events": ("gripper_events",),
}
"""The ideas that full has and regression has not, and the options that switch them."""
NEAREST = "guess", "earliest_arrival"
"""The options by which a search begins at the nearest training intentions."""


@dataclass(frozen=True)
class Variant:
    """A preset with one idea more or less; without a name the preset itself."""

    preset: Preset
    idea: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Options of the plan that differ from the preset's."""
    without: str = ""
    """An idea of training that the model was trained without."""

    @property
    def name(self) -> str:
        return f"{self.preset} {self.idea}".strip()

    def learned(self, cell: Cell) -> Cell:
        """The training whose model it plans with."""
        asked = replace(cell, preset=self.preset, without=self.without)
        return replace(asked, preset=asked.learns_as)


def variants_of(cell: Cell) -> list[Variant]:
    """The rows of a task's table, those that are soon made first; of a bundled model those that need no training of their own."""
    ideas = {name: fields for name, fields in SWITCHES.items() if name != "gripper events" or cell.task in GRIPPING}
    unheld = {"hold_goal": False}
    variants = [Variant("full")]
    variants += [Variant("full", f"- {idea}", options_of(REGRESSION, fields)) for idea, fields in ideas.items()]
    variants += [Variant("full", "- hold at the goal", unheld), Variant("regression")]
    variants += [Variant("regression", f"+ {idea}", options_of(FULL, fields)) for idea, fields in ideas.items()]
    variants += [Variant("regression", "- hold at the goal", unheld), Variant("regression", "- nearest guess", options_of(PAPER, NEAREST))]
    if cell.bundled:
        return variants
    made_for = [idea for idea, tasks in TRAINING_IDEAS.items() if (cell.task, cell.num_demonstrations) in tasks]
    return [*variants, Variant("paper"), *(Variant("full", f"- {idea}", without=idea) for idea in made_for)]


def options_of(options: PlanOptions, fields: Sequence[str]) -> dict[str, Any]:
    return {name: getattr(options, name) for name in fields}


def ablate(
    cells: Sequence[Cell],
    *,
    place: torch.device = CPU,
    work: Path,
    out: Path,
    tell: TELL,
    progress: Callable[[Progress], None] | None = None,
) -> None:
    """A table a task in `out`, row by row; rows that were there before are not made again.

    Args:
        cells: the trainings, or the bundled models, of each task one a seed.

    Raises:
        ValueError: the working folder holds a run of that name with other data or settings.
    """

    @cache
    def trained(cell: Cell) -> Planner:
        if cell.bundled:
            return load_planner(cell.task, device=place)
        model = planner_of(cell, demonstrations_of(cell, work, tell), place, work, tell, progress).model
        return Planner(model, load_memory(work / "runs" / cell.run, device=place))  # for the rows that ask it

    @cache
    def goals_of(cell: Cell) -> list[Demonstration]:
        return record(Arm(), cell.filmed, count=cell.goals or TEST_GOALS[cell.task], seed=TEST_SEED + cell.seed)

    tables: dict[tuple[str, Loop], None] = dict.fromkeys((cell.data, loop) for cell in cells for loop in cell.loops)
    for data, loop in tables:
        alike = [cell for cell in cells if cell.data == data]
        bundled = "-bundled" if alike[0].bundled else ""
        file = out / f"ablation-{data}-{alike[0].size}{bundled}-{loop}.json"
        table = read_json(file) if file.exists() else about_of(alike, loop, place)
        for variant in variants_of(alike[0]):
            if variant.name not in table["rows"]:
                rows = [row for cell in alike for row in rows_of(cell, variant, loop, trained(variant.learned(cell)), goals_of(cell), tell)]
                base = table["rows"][variant.preset]["trials"] if variant.idea else None
                table["rows"][variant.name] = summed_up(rows, base)
                write_json(file, table)


def about_of(cells: Sequence[Cell], loop: Loop, place: torch.device) -> dict[str, Any]:
    """What a table is of."""
    first = cells[0]
    about = {"kind": "ablation", "task": first.task, "num_demonstrations": first.num_demonstrations, "size": first.size, "loop": loop}
    about |= {"bundled": first.bundled}
    trained = [made_from(find_run(first.task))["training_seed"]] if first.bundled else [cell.seed for cell in cells]
    seeds = {"training_seeds": trained, "seeds": [TEST_SEED + cell.seed for cell in cells]}
    return about | seeds | {"paper": paper_of(first.task, first.num_demonstrations, loop), "provenance": provenance(place), "rows": {}}


def rows_of(cell: Cell, variant: Variant, loop: Loop, trained: Planner, goals: Sequence[Demonstration], tell: TELL) -> list[dict[str, Any]]:
    """What became of each of a cell's goals."""
    planner = Planner(trained.model, trained.memory, replace(PlanOptions.of(variant.preset), **variant.options))
    arm, began, rows = Arm(), time.perf_counter(), list[dict[str, Any]]()
    for goal, demonstration in enumerate(goals):
        found = planner.plan(start=demonstration.first, goal=goal_of(demonstration, planner))
        trial = carry_out(planner, found, arm, cell.filmed, demonstration, loop, filmed=False)
        moved = {"success": trial.success, "deviation_cm": round(100 * trial.deviation_m, 3)}
        searched = {"error": found.error, "seconds": round(found.seconds, 3), "iterations": len(found.errors)}
        rows.append({"seed": cell.seed, "goal": goal} | moved | searched)
        left = (time.perf_counter() - began) / (goal + 1) * (len(goals) - goal - 1)
        reached = sum(row["success"] for row in rows)
        tell(f"{variant.learned(cell).run}, {variant.name}, {loop}: {reached}/{goal + 1} of {len(goals)}, {left:.0f} s left")
    return rows


def summed_up(rows: list[dict[str, Any]], base: Sequence[dict[str, Any]] | None) -> dict[str, Any]:
    """A row of the table: its count, and what it gains and loses against the preset it changes."""
    counted = share([row["success"] for row in rows])
    means = {name: round(float(np.mean([row[name] for row in rows])), 3) for name in ("deviation_cm", "seconds", "iterations", "error")}
    if base is None:
        return counted | means | {"trials": rows}
    pairs = [(row["success"], before["success"]) for row, before in zip(rows, base, strict=True)]
    gained, lost = (sum(now != then and now == won for now, then in pairs) for won in (True, False))
    compared = {"gained": gained, "lost": lost, "p": round(sign_test(gained=gained, lost=lost), 3)}
    return counted | means | compared | {"trials": rows}


def sign_test(*, gained: int, lost: int) -> float:
    """How likely so uneven a split is, if each goal that changed was as likely to be gained as lost (two-sided)."""
    changed, fewer = gained + lost, min(gained, lost)
    return min(1.0, 2 * sum(comb(changed, k) for k in range(fewer + 1)) / 2**changed)
