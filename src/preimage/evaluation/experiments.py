"""The paper's section III, cell by cell: from nothing to results/*.json, ours beside the paper's.

A cell (`evaluation.recipes`) is one training with the evaluations of its model. Its demonstrations, its run and its results are kept in
the working folder, so that `reproduce` goes on where it was stopped.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from preimage.compute.devices import CPU
from preimage.compute.precision import resolve_precision
from preimage.compute.processes import ProcessGroup
from preimage.data.dataset import fingerprint, load
from preimage.evaluation.behaviour_cloning import clone
from preimage.evaluation.evaluate import evaluate, result_of
from preimage.evaluation.loops import Loop
from preimage.evaluation.recipes import MODALITIES_SEED, RECOGNITION_SEED, TEST_GOALS, TEST_SEED, Cell, learning_of, network_of, paper_of
from preimage.method.learner import Progress
from preimage.network.config import ModelConfig
from preimage.presets import Planner, PlanOptions, TrainOptions, load_planner, train
from preimage.records import Demonstration, number_of
from preimage.robot import Arm, record
from preimage.storage.atomic_write import write_json
from preimage.storage.provenance import provenance
from preimage.storage.recordings import save
from preimage.storage.runs import made_from, read_config, read_settings, read_shown, write_card

TELL = Callable[[str], None]


def reproduce(
    cells: Sequence[Cell],
    *,
    place: torch.device = CPU,
    work: Path,
    out: Path,
    tell: TELL,
    progress: Callable[[Progress], None] | None = None,
) -> None:
    """Every cell's JSON files are in `out`; those that were there before are not made again.

    Raises:
        ValueError: the working folder holds a run of that name with other data or settings.
    """
    for cell in cells:
        missing = {name: job for name, job in jobs_of(cell, work, tell).items() if not (out / f"{cell.name}-{name}.json").exists()}
        if not missing:
            tell(f"{cell.name}: done before")
            continue
        demonstrations = demonstrations_of(cell, work, tell)
        planner = planner_of(cell, demonstrations, place, work, tell, progress)
        for name, job in missing.items():
            tell(f"{cell.name}: {name}")
            write_json(out / f"{cell.name}-{name}.json", job(planner, demonstrations))


Job = Callable[[Planner, list[Demonstration]], dict[str, Any]]


def jobs_of(cell: Cell, work: Path, tell: TELL) -> dict[str, Job]:
    """All evaluations of a cell, by the ending of their file's name."""
    jobs: dict[str, Job] = {loop: partial(evaluation_of, cell, work=work, loop=loop, tell=tell) for loop in cell.loops}
    if cell.seed == 0:
        jobs["recognition"] = partial(recognition_of, cell)
        if cell.task == "reach":
            jobs["modalities"] = partial(modalities_of, cell, work=work)
    return jobs


def demonstrations_of(cell: Cell, work: Path, tell: TELL) -> list[Demonstration]:
    """The cell's demonstrations, recorded if they have not been yet; fewer are the first of more."""
    folder = work / "data" / cell.data
    if not folder.exists():
        tell(f"recording {number_of(cell.num_demonstrations, 'demonstration')} of {cell.task}")
        arm = Arm()
        demonstrations = record(arm, cell.filmed, count=cell.num_demonstrations, seed=0)
        save(demonstrations, folder, task=cell.task, joint_unit=arm.joint_unit)
    return load(folder)


def planner_of(
    cell: Cell,
    demonstrations: list[Demonstration],
    place: torch.device,
    work: Path,
    tell: TELL,
    progress: Callable[[Progress], None] | None,
) -> Planner:
    """The cell's trained model, planning by its preset; a training that was stopped goes on."""
    run, options = work / "runs" / cell.run, PlanOptions.of(cell.preset)
    network, config = network_of(cell), learning_of(cell)
    config = replace(config, precision=resolve_precision(config.precision, place))
    finished, begun = (run / "README.md").exists(), (run / "resume.pt").exists()
    if finished or begun:
        refuse_other_run(run, demonstrations, network, config)
    if finished:
        return load_planner(run, options, device=place)
    tell(f"{cell.run}: training")
    about = {
        "size": cell.size,
        "preset": cell.preset,
        "task": cell.task,
        "num_demonstrations": len(demonstrations),
        "data": {"name": cell.data, "fingerprint": fingerprint(demonstrations)},
        "provenance": provenance(place),
    }
    group = ProcessGroup(device=place)
    train(demonstrations, network, config=config, folder=run, resume=run.exists(), about=about, progress=progress, group=group)
    write_card(run)
    return load_planner(run, options, device=place)


def refuse_other_run(run: Path, demonstrations: list[Demonstration], network: ModelConfig, config: TrainOptions) -> None:
    """Raises ValueError where a run was made from other demonstrations or with other settings than are asked for."""
    made = read_config(run)["data"]["fingerprint"], read_settings(ModelConfig, run, "model"), read_settings(TrainOptions, run, "train")
    if made != (fingerprint(demonstrations), network, config):
        raise ValueError(f"{run} was trained on other data or with other settings: remove it, or give another --work")


def evaluation_of(cell: Cell, planner: Planner, demonstrations: list[Demonstration], work: Path, loop: Loop, tell: TELL) -> dict[str, Any]:
    """Counts, baselines and rows of one cell in one loop."""
    goals = cell.goals or TEST_GOALS[cell.task]
    policies = {}
    if loop == cell.loops[0] and cell.preset == "full":  # a baseline has no loop and no preset: once is enough
        policies["behaviour_cloning"] = clone(
            demonstrations,
            rate_hz=planner.model.config.rate_hz,
            updates=2 * learning_of(cell).updates,
            seed=cell.seed,
            place=planner.model.home_pixels.device,
        ).policy_to
    began, reached = time.perf_counter(), [0, 0]

    def count(one: Any) -> None:
        reached[0] += one.trial.success
        reached[1] += 1
        left = (time.perf_counter() - began) / reached[1] * (goals - reached[1])
        tell(f"{cell.name} {loop}: {reached[0]}/{reached[1]} of {goals}, {left:.0f} s left")

    run = work / "runs" / cell.run
    evaluated = evaluate(
        planner, Arm(), cell.filmed, goals=goals, seed=TEST_SEED + cell.seed, shown=read_shown(run), loop=loop,
        policies=policies, progress=count,
    )  # fmt: skip
    about = asdict(cell) | {"model": cell.name, "seed": TEST_SEED + cell.seed, "loop": loop} | made_from(run)
    about |= {
        "paper": paper_of(cell.task, cell.num_demonstrations, loop),
        "plan": asdict(planner.options),
        "provenance": provenance(planner.model.home_pixels.device),
    }
    return result_of(evaluated, about)


def recognition_of(cell: Cell, planner: Planner, demonstrations: list[Demonstration]) -> dict[str, Any]:
    """Section II-C: sequences never shown are recognised from the whole of them, and regenerated in closed loop.

    Their error stands beside that of training sequences recognised in the same way. The map shows where the intentions lie.
    """
    count = cell.goals or 20
    novel = record(Arm(), cell.filmed, count=count, seed=RECOGNITION_SEED + cell.seed)
    found = {"training": demonstrations[:count], "novel": novel}
    recognised = {name: [planner.recognise(one) for one in several] for name, several in found.items()}
    places = {name: np.stack([one.intention.flatten()[0].cpu().numpy() for one in several]) for name, several in recognised.items()}
    table = planner.model.intention_table.intentions().flatten().detach().cpu().numpy()
    flat = principal_plane(table)
    return {
        **asdict(cell),
        "seed": RECOGNITION_SEED + cell.seed,
        "error": {name: [round(one.error, 4) for one in several] for name, several in recognised.items()},
        "map": {"training": flat(table), "novel": flat(places["novel"])},
        "goals_m": {"training": goals_of(demonstrations), "novel": goals_of(novel)},
        "neighbours": rank_correlation(places["novel"], goals_of(novel)),
        "provenance": provenance(planner.model.home_pixels.device),
    }


def principal_plane(rows: np.ndarray) -> Callable[[np.ndarray], list[list[float]]]:
    """The projection onto the two directions in which the rows differ most."""
    mean = rows.mean(0)
    directions = np.linalg.svd(rows - mean, full_matrices=False)[2][:2]
    return lambda places: ((places - mean) @ directions.T).round(4).tolist()


def goals_of(demonstrations: Sequence[Demonstration]) -> list[list[float]]:
    """Where the demonstrator brought the hand or the object, on the table (m)."""
    places = [one.scene.positions_m for one in demonstrations if one.scene is not None]
    return [list(place["goal" if "goal" in place else "circle"][:2]) for place in places]


def rank_correlation(intentions: np.ndarray, goals: Sequence[Sequence[float]]) -> float:
    """Spearman's correlation of the distances between intentions with the distances between goals: 1 where neighbours remain neighbours."""

    def distances(points: np.ndarray) -> np.ndarray:
        return np.linalg.norm(points[:, None] - points[None], axis=-1)[np.triu_indices(len(points), 1)]

    ranks = [np.argsort(np.argsort(distances(np.asarray(points)))) for points in (intentions, goals)]
    table = np.atleast_2d(np.corrcoef(np.stack(ranks)))
    return round(float(table[0, 1]), 3)


def modalities_of(cell: Cell, planner: Planner, _: list[Demonstration], *, work: Path) -> dict[str, Any]:
    """Section II-D: the goal given in vision only, joints only or both; the error of each modality at arrival, given or not.

    The joints are given twice: as error regression found them, and as they are commanded, after the corrections of the preset.
    """
    goals = cell.goals or 20
    rows: dict[str, Any] = {}
    shown = read_shown(work / "runs" / cell.run)
    for modalities in ("vision", "joints", "both"):
        by_modalities = Planner(planner.model, planner.memory, replace(planner.options, modalities=modalities))
        evaluated = evaluate(by_modalities, Arm(), cell.filmed, goals=goals, seed=MODALITIES_SEED + cell.seed, shown=shown)
        arrived = [(one.plan, one.plan.arrival_step, one.demonstration.last) for one in evaluated]
        counted = result_of(evaluated, {})

        def mean_off(part: str, goal_part: str, arrived: list = arrived) -> float:
            return float(np.mean([np.abs(getattr(p, part)[t].astype(float) - getattr(g, goal_part)).mean() for p, t, g in arrived]))

        rows[modalities] = {name: counted[name] for name in ("success", "goals", "interval", "deviation_cm")} | {
            "pixel_error_mean": round(mean_off("frames", "frame"), 3),
            "imagined_joint_error_rad_mean": round(mean_off("imagined_joints", "joints"), 4),
            "joint_error_rad_mean": round(mean_off("joints", "joints"), 4),
        }
    return asdict(cell) | {
        "seed": MODALITIES_SEED + cell.seed,
        "modalities": rows,
        "provenance": provenance(planner.model.home_pixels.device),
    }
