"""The run that the studio was opened with: its network, ready to plan by each preset, and the table of its task where there is one."""

import threading
from dataclasses import asdict
from functools import cached_property
from typing import Any

from preimage.network.config import Sensors
from preimage.presets import Planner, PlanOptions, Preset, ReplanConfig, load_calibration, load_memory
from preimage.robot import TASKS, Arm
from preimage.robot.limits import Limits, limits_seen
from preimage.storage.run_files import MEMORY
from preimage.storage.runs import find_run, made_from, read_body, read_config, read_settings, read_shown, read_view
from preimage.studio.table import Table

WAYS: dict[Preset, str] = {
    "paper": "The paper: Adam from random intentions, nothing remembered, nothing corrected.",
    "regression": "Network and search without memory: Adam from the nearest training intentions, to stay at the goal.",
    "full": "All ideas: it begins where memory points to, and is corrected at the end.",
}
"""What each preset does, for the page."""
LATENT = " It is the search alone, for this network's intention is latent."


class OpenedRun:
    """A run, opened. What takes seconds is loaded when it is first asked for.

    Args:
        name: a run folder, a bundled name, or `hf:owner/name` of the Hugging Face Hub.

    Raises:
        ValueError: there is no such run, or its settings are broken.
    """

    def __init__(self, name: str) -> None:
        self.name, self.folder = name, find_run(name)
        self.sensors = read_settings(Sensors, self.folder, "sensors")
        self.config = read_config(self.folder)
        self.view, self.body = read_view(self.folder), read_body(self.folder)
        self.table = self._table()
        self._planners: dict[str, Planner] = {}
        self._lock = threading.Lock()

    def _table(self) -> Table | None:
        """The simulated table, where the run is of one of its tasks and moves its arm."""
        task, arm = TASKS.get(str(self.config.get("task"))), Arm()
        if task is None or self.sensors.channels != 1 or self.sensors.height != self.sensors.width:
            return None
        arm.set_up(task.workspace)
        return Table(task, self.sensors.height) if self.sensors.joint_names == arm.joint_names else None

    @property
    def model_rate_hz(self) -> float:
        """Steps a second that the network runs at."""
        return self.planner("paper").model.config.rate_hz

    @property
    def presets(self) -> tuple[Preset, ...]:
        """Those that the run's files are enough for, the best last."""
        return ("paper", "regression", "full") if (self.folder / MEMORY).is_file() else ("paper", "regression")

    @property
    def is_latent(self) -> bool:
        model = self.config.get("model")
        return not (isinstance(model, dict) and model.get("intention") == "free")

    def way_of(self, preset: Preset) -> str:
        """What a preset does, in words."""
        return WAYS[preset] + (LATENT if preset != "full" and self.is_latent else "")

    @cached_property
    def shown(self):
        return read_shown(self.folder)

    @cached_property
    def limits(self) -> Limits:
        return limits_seen(self.sensors, self.shown, unit=self.body.joint_unit)

    @property
    def units(self) -> tuple[str, ...]:
        """The joints' units, as far as they are known."""
        return self.table.units if self.table else self.limits.units

    def planner(self, preset: Preset) -> Planner:
        """The network, planning by a preset. All presets share its weights.

        Raises:
            ValueError: the files of the run are broken, or the preset needs more of them than there are.
        """
        from preimage.storage.networks import load_model

        with self._lock:
            if preset not in self._planners:
                others = next(iter(self._planners.values()), None)
                model = others.model if others else load_model(self.folder)
                options = PlanOptions.of(preset)
                memory = next((each.memory for each in self._planners.values() if each.memory), None)
                if options.needs_memory and memory is None:
                    memory = load_memory(self.folder)
                known, unit = load_calibration(self.folder), self.body.joint_unit
                self._planners[preset] = Planner(model, memory if options.needs_memory else None, options, known, joint_unit=unit)
            return self._planners[preset]

    def described(self) -> dict[str, Any]:
        """What the page has to know of it."""
        limits = self.limits
        joints = [
            {"name": name, "unit": unit, "lower": low, "upper": high}
            for name, unit, low, high in zip(limits.joint_names, self.units, limits.lower.tolist(), limits.upper.tolist(), strict=True)
        ]
        presets = [{"name": preset, "way": self.way_of(preset)} for preset in self.presets]
        view = {key: value for key, value in asdict(self.view).items() if key in ("recorded", "crop", "size")}
        return {
            "run": self.name,
            "task": self.table.task.name if self.table else self.config.get("task"),
            "made": made_from(self.folder),
            "joints": joints,
            "presets": presets,
            "frame": {"height": self.sensors.height, "width": self.sensors.width, "channels": self.sensors.channels},
            "view": view,
            "disbelief": ReplanConfig.disbelief,
            "table": self.table.described() if self.table else None,
        }
