"""Everything that can go wrong, in every loop, from the same plans, so that the loops stand beside each other.

Loops that plan anew are tried with windows of several lengths, as EFE-GLean shows it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, get_args

from preimage.evaluation.evaluate import Evaluated, count, goal_of, replanned, row_of
from preimage.evaluation.loops import Disturbed, Loop
from preimage.evaluation.trials import Circumstances, try_out
from preimage.presets import Planner, ReplanConfig
from preimage.robot import Arm, Task, record

WINDOWS = (1, 5, 15, "all")
"""Lengths of the window (steps)."""
SWEPT: tuple[Disturbed, ...] = ("goal", "object")
"""Where the others are tried too: of what was sensed before a push or a missing frame nothing follows for what is done then."""


@dataclass(frozen=True)
class Cell:
    """A loop in some circumstances."""

    loop: Loop
    disturb: Disturbed | None
    settings: ReplanConfig | None = None


def cells_for(task: Task, settings: ReplanConfig) -> list[Cell]:
    """What can be tried with a task: there may be no object to be moved, or no goal apart from the scene."""
    cannot_be = {"goal"} if task.name != "reach" else set()
    cannot_be |= set() if task.workspace.has_object else {"object"}
    kinds: list[Disturbed | None] = [None, *(kind for kind in get_args(Disturbed) if kind not in cannot_be)]
    cells = [Cell(loop, kind, settings if loop == "replan" else None) for kind in kinds for loop in ("closed", "open", "replan")]
    others = [window for window in WINDOWS if window != settings.window]
    return cells + [Cell("replan", kind, replace(settings, window=window)) for kind in kinds if kind in SWEPT for window in others]


def try_all(
    planner: Planner,
    arm: Arm,
    task: Task,
    *,
    goals: int,
    seed: int,
    replan: ReplanConfig,
    progress: Callable[[Mapping[Cell, Sequence[Evaluated]]], None] = lambda tried: None,
) -> dict[Cell, list[Evaluated]]:
    """Plan once to each goal, and carry the plan out in every cell.

    Args:
        goals: how many.
        seed: draws the goals, and what goes wrong.
        replan: how loops that plan anew go about it, but for the window.
        progress: called after each goal with what was tried so far.
    """
    recorded, tried = record(arm, task, count=goals, seed=seed), {cell: [] for cell in cells_for(task, replan)}
    for goal, demonstration in enumerate(recorded):
        found = planner.plan(start=demonstration.first, goal=goal_of(demonstration, planner))
        assert demonstration.scene is not None
        for cell, evaluated in tried.items():
            circumstances = Circumstances(cell.disturb, recorded[(goal + 1) % goals], (seed, goal), cell.settings)
            trial, beliefs = try_out(planner, found, arm, task, demonstration.scene, cell.loop, circumstances)
            evaluated.append(Evaluated(demonstration, found, trial, {}, beliefs))
        progress(tried)
    return tried


def cells_of(tried: Mapping[Cell, Sequence[Evaluated]]) -> list[dict[str, Any]]:
    """The counts and rows of each cell, ready to be written as JSON."""
    return [cell_of(cell, evaluated) for cell, evaluated in tried.items()]


def cell_of(cell: Cell, evaluated: Sequence[Evaluated]) -> dict[str, Any]:
    rows = [row_of(index, one) for index, one in enumerate(evaluated)]
    kept = ("goal", "deviation_cm", "success", "held", "details")
    return {
        "loop": cell.loop,
        "disturb": cell.disturb,
        "window": cell.settings.window if cell.settings else None,
        **count([one.trial for one in evaluated]),
        **replanned(rows),
        "rows": [{name: getattr(row, name) for name in kept} for row in rows],
    }
