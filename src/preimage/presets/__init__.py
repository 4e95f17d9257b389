"""The three ways to train and plan, and the only place where ideas are wired into the method.

* `paper`: the paper's method and nothing else. No memory is read.
* `regression`: what the network and the search are worth without memory: a latent intention, Gauss-Newton from several training
  intentions, the goal held. Nothing is corrected.
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
