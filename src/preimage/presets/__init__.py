"""The three ways to train and plan, and the only place where ideas are wired into the method.

* `paper`: the paper's method and nothing else. No memory is read.
* `regression`: what network and search are worth without memory: the paper's, but that the search begins at the training intentions
  which come nearest to the goal, and that the goal is to be stayed in. Nothing is corrected.
* `full`: all ideas, the memory of the demonstrations among them.
"""

from preimage.ideas.replan_config import ReplanConfig
from preimage.presets.options import PRESETS, SIZES, PlanOptions, Preset, TrainOptions, network_config
from preimage.presets.planner import Planner, load_calibration, load_memory, load_planner
from preimage.presets.training import remember, train

__all__ = [
    "PRESETS",
    "SIZES",
    "PlanOptions",
    "Planner",
    "Preset",
    "ReplanConfig",
    "TrainOptions",
    "load_calibration",
    "load_memory",
    "load_planner",
    "network_config",
    "remember",
    "train",
]
