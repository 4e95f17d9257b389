"""preimage: imagine the way to a goal before moving (P-DVMRNN, Choi, Matsumoto, Jung and Tani 2018).

The names below are in the order of use: an arm and its task, demonstrations of it, a network that learns them, a plan to a goal, its
execution, and a film of both.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from preimage import fast
from preimage.compute import threads

if TYPE_CHECKING:  # a name is loaded when it is first asked for, and with it torch, matplotlib or mujoco
    from preimage.data.dataset import load
    from preimage.evaluation.evaluate import Evaluated, evaluate, result_of, wilson_interval
    from preimage.ideas.belief import Belief
    from preimage.ideas.memory import DemonstrationMemory
    from preimage.ideas.replanning import Replanner
    from preimage.ideas.waypoints import join
    from preimage.method.config import PlanConfig, TrainConfig
    from preimage.method.learner import NonFinite
    from preimage.method.one_step import follow
    from preimage.method.plan import plan, recognise
    from preimage.method.seam import Ideas
    from preimage.network.config import ModelConfig, Sensors
    from preimage.network.intention import IntentionState
    from preimage.network.pdvmrnn import PDVMRNN
    from preimage.presets import Planner, PlanOptions, ReplanConfig, TrainOptions, load_memory, load_planner, remember, train
    from preimage.records import Demonstration, GoalRefused, Percept, Plan, Scene, Shown, Stopped, Trial, Trust
    from preimage.report.figures import figure
    from preimage.report.films import film
    from preimage.robot import TASKS, Arm, MoveObject, Reach, ReachTwo, record
    from preimage.robot.execution import execute, execute_open_loop
    from preimage.robot.protocol import Robot, drive
    from preimage.robot.simulated import SimulatedRobot
    from preimage.storage.networks import from_pretrained, load_model
    from preimage.storage.plans import load_plan, save_episode, save_plan
    from preimage.storage.recordings import save
    from preimage.storage.runs import push_to_hub, read_shown

threads.sleep_while_waiting()
fast.install()

__all__ = [
    "PDVMRNN",
    "TASKS",
    "Arm",
    "Belief",
    "Demonstration",
    "DemonstrationMemory",
    "Evaluated",
    "GoalRefused",
    "Ideas",
    "IntentionState",
    "ModelConfig",
    "MoveObject",
    "NonFinite",
    "Percept",
    "Plan",
    "PlanConfig",
    "PlanOptions",
    "Planner",
    "Reach",
    "ReachTwo",
    "ReplanConfig",
    "Replanner",
    "Robot",
    "Scene",
    "Sensors",
    "Shown",
    "SimulatedRobot",
    "Stopped",
    "TrainConfig",
    "TrainOptions",
    "Trial",
    "Trust",
    "drive",
    "evaluate",
    "execute",
    "execute_open_loop",
    "figure",
    "film",
    "follow",
    "from_pretrained",
    "join",
    "load",
    "load_memory",
    "load_model",
    "load_plan",
    "load_planner",
    "plan",
    "push_to_hub",
    "read_shown",
    "recognise",
    "record",
    "remember",
    "result_of",
    "save",
    "save_episode",
    "save_plan",
    "train",
    "wilson_interval",
]

ROOMS = {
    "data.dataset": ("load",),
    "evaluation.evaluate": ("Evaluated", "evaluate", "result_of", "wilson_interval"),
    "ideas.belief": ("Belief",),
    "ideas.memory": ("DemonstrationMemory",),
    "ideas.replanning": ("Replanner",),
    "ideas.waypoints": ("join",),
    "method.config": ("PlanConfig", "TrainConfig"),
    "method.one_step": ("follow",),
    "method.plan": ("plan", "recognise"),
    "method.seam": ("Ideas",),
    "method.learner": ("NonFinite",),
    "network.config": ("ModelConfig", "Sensors"),
    "network.intention": ("IntentionState",),
    "network.pdvmrnn": ("PDVMRNN",),
    "presets": ("Planner", "PlanOptions", "ReplanConfig", "TrainOptions", "load_memory", "load_planner", "remember", "train"),
    "records": ("Demonstration", "GoalRefused", "Percept", "Plan", "Scene", "Shown", "Stopped", "Trial", "Trust"),
    "report.figures": ("figure",),
    "report.films": ("film",),
    "robot": ("TASKS", "Arm", "MoveObject", "Reach", "ReachTwo", "record"),
    "robot.execution": ("execute", "execute_open_loop"),
    "robot.protocol": ("Robot", "drive"),
    "robot.simulated": ("SimulatedRobot",),
    "storage.plans": ("load_plan", "save_episode", "save_plan"),
    "storage.recordings": ("save",),
    "storage.networks": ("from_pretrained", "load_model"),
    "storage.runs": ("push_to_hub", "read_shown"),
}
"""Where each name is at home."""
ROOM_OF = {name: room for room, names in ROOMS.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in ROOM_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"preimage.{ROOM_OF[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
