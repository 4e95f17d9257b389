"""What a network imagines when nothing is wanted: the baseline that shows what a goal buys."""

import time
from dataclasses import replace

import numpy as np

from preimage.method.config import PlanConfig
from preimage.method.plan import draft_of
from preimage.method.prediction_error import ToGoal, goal_terms
from preimage.method.seam import Problem
from preimage.network.inputs import home
from preimage.network.pdvmrnn import PDVMRNN
from preimage.records import Percept, Plan, Stopped


def imagine_without_goal(model: PDVMRNN, start: Percept, *, config: PlanConfig | None = None) -> Plan:
    """What the model imagines when nothing is wanted: its intention at the prior mean. The baseline that shows what a goal buys."""
    began = time.perf_counter()
    problem = Problem.between(model, start, home(model), config or PlanConfig())
    objective = ToGoal(problem.start, goal_terms(problem.start, "vision"))
    draft = draft_of(model.intention_table.prior_mean(1), problem, objective)
    draft = replace(draft, error=float(objective.start_error(draft.generated)[0]), arrival=problem.num_steps - 1)
    seconds = time.perf_counter() - began
    return draft.plan(problem, start=start, goal=Percept(), errors=np.zeros(0), stopped=Stopped.ITERATIONS, seconds=seconds)
