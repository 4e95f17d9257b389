"""How each cell of the paper's tables is trained and evaluated: the recipes, and the paper's own numbers.

Demonstrations are recorded with seed 0; a cell of n uses the first n of them. Its seed draws the first weights, the batches and, added to
`TEST_SEED`, the test goals. Seeds from 500 to 999 are for tuning.
"""

from dataclasses import dataclass, replace
from typing import Any

from preimage.evaluation.loops import Loop
from preimage.network.config import ModelConfig
from preimage.presets import Preset, TrainOptions, network_config
from preimage.robot import TASKS, Task, with_frames

TEST_GOALS = {"reach": 40, "two-points": 40, "move-object": 50, "two-circles": 50}
"""As many as in the paper; two circles are a task of our own."""
LITTLE_CAPACITY: dict[str, Any] = {"intention_layers": ("top",), "intention_dimensions": 8}
"""For scenes of which most can be seen at the start: it is to be looked at, not remembered."""
NETWORKS: dict[str, dict[str, Any]] = {
    "two-points": LITTLE_CAPACITY | {"intention_cost": 0.03},
    "move-object": LITTLE_CAPACITY | {"intention_cost": 0.2, "keypoints": 8},
    "two-circles": LITTLE_CAPACITY | {"intention_cost": 0.05, "keypoints": 8},
}
"""The networks of the tasks with such scenes, where they differ from the size's own. The positions of things to be gripped go to the motors
as keypoints."""
GRIPPING = "move-object", "two-circles"
"""Tasks with a gripper, in which alone there are gripper events."""
PAPER_NETWORKS: dict[str, dict[str, Any]] = {task: {"intention_layers": ("top",), "intention_noise": 0.1} for task in GRIPPING}
"""By the paper's method likewise: with the upper levels of both paths the intention remembers where a thing stood, and the grasp is off."""
FEWER_UNITS: dict[str, dict[str, Any]] = {"move-object": {"motor_units": (384, 256, 16)}}
"""Of a small network, as it was compared (docs/log.md)."""
FINER: dict[str, Any] = {"vision_channels": (8, 16, 32, 32), "motor_units": (384, 256, 64, 16), "seen_channels": 4, "keypoints": 8}
"""Of a small network for frames twice as large: a level below the others, so that its upper ones see as far as they do in small frames."""
LEARNING: dict[str, dict[str, Any]] = {
    "two-points": {"updates": 1500, "later_starts": 0.5},
    "move-object": {"updates": 1300},
    "two-circles": {"updates": 1300},
}
"""How a task is learned, where that differs from `TrainOptions`."""
REGRESSION_LEARNING: dict[str, dict[str, Any]] = {"two-points": {"later_starts": 0.5}}
"""How the network of regression is learned, where that differs from paper's: with later starts the marker is read where it is seen, and
not where it lay in the demonstration at whose intention the search begins (docs/log.md)."""
FEW: dict[int, dict[str, Any]] = {50: {"mixup": 0.5}, 25: {"mixup": 0.5, "mixup_arity": 4, "mixup_extrapolation": 1.8}}
"""How reaching is learned from fewer than 100 demonstrations: what lies between them, and around them, has to be learned."""
TRAINING_IDEAS: dict[str, tuple[tuple[str, int], ...]] = {
    "mixup": (("reach", 50), ("reach", 25)),
    "later_starts": (("two-points", 100),),
    "keypoints": (("move-object", 100), ("two-circles", 100)),
}
"""What a training goes beyond the paper with, and the tasks and numbers of demonstrations it was made for."""
TEST_SEED, RECOGNITION_SEED, MODALITIES_SEED = 5110, 6000, 7000
"""A cell's seed is added to these: they draw what its model was never shown."""


@dataclass(frozen=True)
class Cell:
    """One training and the evaluations of its model."""

    task: str
    num_demonstrations: int = 100
    seed: int = 0
    size: str = "small"
    preset: Preset = "full"
    """How it is trained and how it plans."""
    loops: tuple[Loop, ...] = ("closed",)
    pixels: int = 64
    """Height and width of the frames."""
    updates: int | None = None
    """Of the training; by default as many as the task asks for."""
    goals: int | None = None
    """Test goals; by default as many as the paper's, and 20 for recognition and the modalities."""
    without: str = ""
    """An idea of training (`TRAINING_IDEAS`) that is left out."""
    bundled: bool = False
    """Whether the bundled model of the task plans, instead of one that is trained; its seed then draws the goals alone."""

    @property
    def name(self) -> str:
        """Of its results."""
        return self._named("" if self.preset == "full" else f"-as-{self.preset}")

    @property
    def run(self) -> str:
        """Of its trained model, which presets that train alike share."""
        return self._named("" if self.learns_as == "full" else f"-as-{self.learns_as}")

    @property
    def learns_as(self) -> Preset:
        """The preset by which its model is trained: regression plans with the network of paper, of full where things are gripped, or with
        one of its own."""
        if self.preset == "regression" and self.task not in REGRESSION_LEARNING:
            return "full" if self.task in GRIPPING else "paper"
        return self.preset

    def _named(self, preset: str) -> str:
        without = f"-without-{self.without}" if self.without else ""
        return f"{self.data}-{self.size}{preset}{without}-seed{self.seed}"

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
    if table == "ablation":
        of_each = [("reach", 100), ("reach", 25), ("two-points", 100), ("move-object", 100), ("two-circles", 100)]
        loops: dict[str, tuple[Loop, ...]] = {"move-object": ("closed", "open")}
        return [Cell(task, count, seed, size, loops=loops.get(task, ("closed",))) for task, count in of_each for seed in (0, 1, 2)]
    if table == "all":
        return [cell for cells in tables.values() for cell in cells]
    if table not in tables:
        raise ValueError(f"{table} is no table; known are {', '.join(tables)} and all")
    return tables[table]


def network_of(cell: Cell) -> ModelConfig:
    """The cell's network, with the capacity of its intention."""
    network = network_config(cell.size, cell.learns_as)
    if cell.learns_as != "full":
        return replace(network, **PAPER_NETWORKS.get(cell.task, {}))
    network = replace(network, **NETWORKS.get(cell.task, {}))
    if cell.without == "keypoints":
        network = replace(network, keypoints=0)
    if cell.size != "small":
        return network
    return replace(network, **(FINER if cell.pixels > Cell.pixels else FEWER_UNITS.get(cell.task, {})))


def learning_of(cell: Cell) -> TrainOptions:
    """How the cell's model learns."""
    config = TrainOptions(seed=cell.seed)
    if cell.learns_as == "regression":
        config = replace(config, **REGRESSION_LEARNING[cell.task])
    elif cell.learns_as == "full":
        few = FEW.get(cell.num_demonstrations, {}) if cell.task == "reach" else {}
        config = replace(config, **LEARNING.get(cell.task, {}), **few)
    if cell.without in ("mixup", "later_starts"):
        config = replace(config, **{cell.without: 0.0})
    return replace(config, updates=cell.updates) if cell.updates else config
