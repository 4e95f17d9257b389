"""The paper's section III, cell by cell: from nothing to results/*.json, ours beside the paper's.

A cell is one training with the evaluations of its model. Its demonstrations, its run and its results are kept in the working folder,
so that `reproduce` goes on where it was stopped. Demonstrations are recorded with seed 0; a cell of n uses the first n of them. Its
seed draws the first weights, the batches and, added to `TEST_SEED`, the test goals. Seeds from 500 to 999 are for tuning.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from preimage.compute.devices import CPU
from preimage.compute.processes import Crew
from preimage.data.dataset import fingerprint, load, save
from preimage.evaluation.behaviour_cloning import clone
from preimage.evaluation.evaluate import Loop, evaluate, result_of
from preimage.method.plan import PlanConfig, recognise
from preimage.method.train import Progress, TrainConfig, train
from preimage.network.config import ModelConfig
from preimage.network.pdvmrnn import PDVMRNN
from preimage.records import Demonstration, number_of
from preimage.robot import TASKS, Arm, Task, record, with_frames
from preimage.storage.atomic_write import write_json
from preimage.storage.provenance import provenance
from preimage.storage.runs import load_model, made_from, read_config, read_settings, read_shown, write_card

SIZES: dict[str, Callable[[], ModelConfig]] = {"tiny": ModelConfig.tiny, "small": ModelConfig.small, "paper": ModelConfig.paper}
TEST_GOALS = {"reach": 40, "two-points": 40, "move-object": 50, "two-circles": 50}
"""As many as the paper's; two circles are a row of our own."""
LITTLE_ROOM: dict[str, Any] = {"intention_layers": ("top",), "intention_dimensions": 8}
"""For scenes of which most can be seen at the start: it is to be looked at, not remembered."""
NETWORKS: dict[str, dict[str, Any]] = {
    "two-points": LITTLE_ROOM | {"intention_cost": 0.03},
    "move-object": LITTLE_ROOM | {"intention_cost": 0.2, "keypoints": 8},
    "two-circles": LITTLE_ROOM | {"intention_cost": 0.05, "keypoints": 8},
}
"""The networks of the tasks with such scenes, where not as the size says. Where things lie that have to be gripped is told as places."""
FEWER_UNITS: dict[str, dict[str, Any]] = {"move-object": {"motor_units": (384, 256, 16)}}
"""Of a small network, as it was compared (docs/log.md)."""
FINER: dict[str, Any] = {"vision_channels": (8, 16, 32, 32), "motor_units": (384, 256, 64, 16), "seen_channels": 4, "keypoints": 8}
"""Of a small network for frames twice as large: a level below the others, so that its upper ones see as far as they do in small frames."""
LEARNING: dict[str, dict[str, Any]] = {
    "two-points": {"updates": 1500, "later_starts": 0.5},
    "move-object": {"updates": 1300, "start_noise": 0.05},
    "two-circles": {"updates": 1300, "start_noise": 0.05},
}
"""How a task is learned, where not as `TrainConfig` says."""
FEW: dict[int, dict[str, Any]] = {50: {"blends": 0.5}, 25: {"blends": 0.5, "blend_parts": 4, "blend_reach": 1.8}}
"""How reaching is learned from fewer than 100 demonstrations: what lies between them, and around them, has to be told."""
TEST_SEED, RECOGNITION_SEED, MODALITIES_SEED = 5060, 6000, 7000
"""To these a cell's seed is added: the seeds of what its model was never shown."""
TELL = Callable[[str], None]


@dataclass(frozen=True)
class Cell:
    """One training and what its model is asked for."""

    task: str
    num_demonstrations: int = 100
    seed: int = 0
    size: str = "small"
    loops: tuple[Loop, ...] = ("closed",)
    pixels: int = 64
    """Height and width of the frames."""
    updates: int | None = None
    """Of the training; by default as many as the task asks for."""
    goals: int | None = None
    """Test goals; by default as many as the paper's, and 20 for recognition and the modalities."""

    @property
    def name(self) -> str:
        return f"{self.data}-{self.size}-seed{self.seed}"

    @property
    def data(self) -> str:
        """Name of its demonstrations."""
        return f"{self.task}-{self.num_demonstrations}" + (f"-{self.pixels}px" if self.pixels != Cell.pixels else "")

    @property
    def filmed(self) -> Task:
        """The task in frames of the cell's size."""
        return with_frames(TASKS[self.task], self.pixels)


PAPER: dict[str, dict[str, float]] = {
    "reach-100-closed": {"success_rate": 0.84, "deviation_cm": 2.6},
    "reach-50-closed": {"success_rate": 0.70, "deviation_cm": 3.2},
    "reach-25-closed": {"success_rate": 0.45, "deviation_cm": 5.3},
    "two-points-100-closed": {"success_rate": 0.75},
    "move-object-100-closed": {"success_rate": 0.48, "within_1": 0.48, "within_2": 0.64, "within_3": 0.71, "placed_once_grasped": 0.94},
    "move-object-100-open": {"success_rate": 0.74, "within_1": 0.74, "within_2": 0.88, "within_3": 0.93},
}
"""Tables II and III and section III-B of the paper."""


def paper_of(task: str, num_demonstrations: int | None, loop: Loop) -> dict[str, float] | None:
    """What the paper reports for the same, if it does."""
    return PAPER.get(f"{task}-{num_demonstrations}-{loop}")


def cells_of(table: str, size: str) -> list[Cell]:
    """The cells of one of the paper's tables, or of all.

    Raises:
        ValueError: there is no such table.
    """
    tables = {
        "table-2": [Cell("reach", count, seed, size) for count in (100, 50, 25) for seed in (0, 1, 2)],
        "two-points": [Cell("two-points", seed=seed, size=size) for seed in (0, 1, 2)],
        "table-3": [Cell("move-object", seed=seed, size=size, loops=("closed", "open", "recorded")) for seed in (0, 1, 2)]
        + [Cell("move-object", size=size, loops=("closed", "open"), pixels=2 * Cell.pixels)],
        "two-circles": [Cell("two-circles", size=size)],
    }
    if table == "all":
        return [cell for cells in tables.values() for cell in cells]
    if table not in tables:
        raise ValueError(f"{table} is no table; known are {', '.join(tables)} and all")
    return tables[table]


def reproduce(
    cells: Sequence[Cell],
    *,
    place: torch.device = CPU,
    work: Path,
    out: Path,
    tell: TELL,
    progress: Callable[[Progress], None] | None = None,
) -> None:
    """Every cell's JSON files are in `out`; what is there already is not made again.

    Raises:
        ValueError: the working folder holds a run of that name with other data or settings.
    """
    for cell in cells:
        missing = {name: job for name, job in jobs_of(cell, work, tell).items() if not (out / f"{cell.name}-{name}.json").exists()}
        if not missing:
            tell(f"{cell.name}: done before")
            continue
        demonstrations = demonstrations_of(cell, work, tell)
        model = model_of(cell, demonstrations, place, work, tell, progress)
        for name, job in missing.items():
            tell(f"{cell.name}: {name}")
            write_json(out / f"{cell.name}-{name}.json", job(model, demonstrations))


Job = Callable[[PDVMRNN, list[Demonstration]], dict[str, Any]]


def jobs_of(cell: Cell, work: Path, tell: TELL) -> dict[str, Job]:
    """All that a cell is asked for, by the ending of its file's name."""
    jobs: dict[str, Job] = {loop: partial(evaluation_of, cell, work=work, loop=loop, tell=tell) for loop in cell.loops}
    if cell.seed == 0:
        jobs["recognition"] = partial(recognition_of, cell)
        if cell.task == "reach":
            jobs["modalities"] = partial(modalities_of, cell, work=work)
    return jobs


def demonstrations_of(cell: Cell, work: Path, tell: TELL) -> list[Demonstration]:
    """The cell's demonstrations, recorded where they are not there yet; fewer are the first of more."""
    folder = work / "data" / cell.data
    if not folder.exists():
        tell(f"recording {number_of(cell.num_demonstrations, 'demonstration')} of {cell.task}")
        arm = Arm()
        demonstrations = record(arm, cell.filmed, count=cell.num_demonstrations, seed=0)
        save(demonstrations, folder, task=cell.task, joint_unit=arm.joint_unit)
    return load(folder)


def model_of(
    cell: Cell,
    demonstrations: list[Demonstration],
    place: torch.device,
    work: Path,
    tell: TELL,
    progress: Callable[[Progress], None] | None,
) -> PDVMRNN:
    """The cell's trained model; a training that was stopped goes on."""
    run = work / "runs" / cell.name
    network, config = network_of(cell), learning_of(cell)
    finished, begun = (run / "README.md").exists(), (run / "resume.pt").exists()
    if finished or begun:
        refuse_other_run(run, demonstrations, network, config)
    if finished:
        return load_model(run).to(place)
    tell(f"{cell.name}: training")
    about = {
        "size": cell.size,
        "task": cell.task,
        "num_demonstrations": len(demonstrations),
        "data": {"name": cell.data, "fingerprint": fingerprint(demonstrations)},
        "provenance": provenance(place),
    }
    crew = Crew(device=place)
    train(demonstrations, network, config=config, folder=run, resume=run.exists(), about=about, progress=progress, crew=crew)
    write_card(run)
    return load_model(run).to(place)


def network_of(cell: Cell) -> ModelConfig:
    """The cell's network, with the room of its intention."""
    network = replace(SIZES[cell.size](), **NETWORKS.get(cell.task, {}))
    if cell.size != "small":
        return network
    return replace(network, **(FINER if cell.pixels > Cell.pixels else FEWER_UNITS.get(cell.task, {})))


def learning_of(cell: Cell) -> TrainConfig:
    """How the cell's model learns."""
    few = FEW.get(cell.num_demonstrations, {}) if cell.task == "reach" else {}
    config = replace(TrainConfig(seed=cell.seed), **LEARNING.get(cell.task, {}), **few)
    return replace(config, updates=cell.updates) if cell.updates else config


def refuse_other_run(run: Path, demonstrations: list[Demonstration], network: ModelConfig, config: TrainConfig) -> None:
    """Raises ValueError where a run was made from other demonstrations or with other settings than are asked for."""
    made = read_config(run)["data"]["fingerprint"], read_settings(ModelConfig, run, "model"), read_settings(TrainConfig, run, "train")
    if made != (fingerprint(demonstrations), network, config):
        raise ValueError(f"{run} was trained on other data or with other settings: remove it, or give another --work")


def evaluation_of(cell: Cell, model: PDVMRNN, demonstrations: list[Demonstration], work: Path, loop: Loop, tell: TELL) -> dict[str, Any]:
    """Counts, baselines and rows of one cell in one loop."""
    goals = cell.goals or TEST_GOALS[cell.task]
    policies = {}
    if loop == cell.loops[0]:  # a baseline has no loop: once is enough
        policies["behaviour_cloning"] = clone(
            demonstrations,
            rate_hz=model.config.rate_hz,
            updates=2 * learning_of(cell).updates,
            seed=cell.seed,
            place=model.home_pixels.device,
        ).policy_to
    began, reached = time.perf_counter(), [0, 0]

    def count(one: Any) -> None:
        reached[0] += one.trial.success
        reached[1] += 1
        left = (time.perf_counter() - began) / reached[1] * (goals - reached[1])
        tell(f"{cell.name} {loop}: {reached[0]}/{reached[1]} of {goals}, {left:.0f} s left")

    run = work / "runs" / cell.name
    evaluated = evaluate(
        model, Arm(), cell.filmed, goals=goals, seed=TEST_SEED + cell.seed, shown=read_shown(run), loop=loop,
        policies=policies, progress=count,
    )  # fmt: skip
    about = asdict(cell) | {"model": cell.name, "seed": TEST_SEED + cell.seed, "loop": loop} | made_from(run)
    about |= {
        "paper": paper_of(cell.task, cell.num_demonstrations, loop),
        "plan": asdict(PlanConfig()),
        "provenance": provenance(model.home_pixels.device),
    }
    return result_of(evaluated, about)


def recognition_of(cell: Cell, model: PDVMRNN, demonstrations: list[Demonstration]) -> dict[str, Any]:
    """Section II-C: sequences never shown are recognised from the whole of them, and regenerated in closed loop.

    Their error stands beside that of training sequences recognised in the same way. The map shows where the intentions lie.
    """
    count = cell.goals or 20
    novel = record(Arm(), cell.filmed, count=count, seed=RECOGNITION_SEED + cell.seed)
    found = {"training": demonstrations[:count], "novel": novel}
    recognised = {name: [recognise(model, one) for one in several] for name, several in found.items()}
    places = {name: np.stack([one.intention.flatten()[0].cpu().numpy() for one in several]) for name, several in recognised.items()}
    table = model.intention_table.intentions().flatten().detach().cpu().numpy()
    flat = principal_plane(table)
    return {
        **asdict(cell),
        "seed": RECOGNITION_SEED + cell.seed,
        "error": {name: [round(one.error, 4) for one in several] for name, several in recognised.items()},
        "map": {"training": flat(table), "novel": flat(places["novel"])},
        "goals_m": {"training": goals_of(demonstrations), "novel": goals_of(novel)},
        "neighbours": rank_correlation(places["novel"], goals_of(novel)),
        "provenance": provenance(model.home_pixels.device),
    }


def principal_plane(rows: np.ndarray) -> Callable[[np.ndarray], list[list[float]]]:
    """The map onto the two directions in which the rows differ most."""
    mean = rows.mean(0)
    directions = np.linalg.svd(rows - mean, full_matrices=False)[2][:2]
    return lambda places: ((places - mean) @ directions.T).round(4).tolist()


def goals_of(demonstrations: Sequence[Demonstration]) -> list[list[float]]:
    """Where the tutor brought the hand or the object, on the table (m)."""
    places = [one.scene.positions_m for one in demonstrations if one.scene is not None]
    return [list(place["goal" if "goal" in place else "circle"][:2]) for place in places]


def rank_correlation(intentions: np.ndarray, goals: Sequence[Sequence[float]]) -> float:
    """Spearman's correlation of the distances between intentions with the distances between goals: 1 where neighbours stay neighbours."""

    def distances(points: np.ndarray) -> np.ndarray:
        return np.linalg.norm(points[:, None] - points[None], axis=-1)[np.triu_indices(len(points), 1)]

    ranks = [np.argsort(np.argsort(distances(np.asarray(points)))) for points in (intentions, goals)]
    table = np.atleast_2d(np.corrcoef(np.stack(ranks)))
    return round(float(table[0, 1]), 3)


def modalities_of(cell: Cell, model: PDVMRNN, _: list[Demonstration], *, work: Path) -> dict[str, Any]:
    """Section II-D: the goal given in vision only, joints only or both; the error of each modality at arrival, given or not."""
    goals = cell.goals or 20
    rows: dict[str, Any] = {}
    shown = read_shown(work / "runs" / cell.name)
    for modalities in ("vision", "joints", "both"):
        config = replace(PlanConfig(), modalities=modalities)
        evaluated = evaluate(model, Arm(), cell.filmed, goals=goals, seed=MODALITIES_SEED + cell.seed, shown=shown, config=config)
        arrived = [(one.plan, one.plan.arrival_step, one.demonstration.last) for one in evaluated]
        counted = result_of(evaluated, {})
        rows[modalities] = {name: counted[name] for name in ("success", "goals", "interval", "deviation_cm")} | {
            "pixel_error_mean": round(float(np.mean([np.abs(p.frames[t].astype(float) - goal.frame).mean() for p, t, goal in arrived])), 3),
            "joint_error_rad_mean": round(float(np.mean([np.abs(p.joints[t] - goal.joints).mean() for p, t, goal in arrived])), 4),
        }
    return asdict(cell) | {"seed": MODALITIES_SEED + cell.seed, "modalities": rows, "provenance": provenance(model.home_pixels.device)}
