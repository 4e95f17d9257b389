"""Planning and recognition: find the intention whose imagined future contains the goal (sections II-C and II-D).

Recognition compares every step of a sequence that was sensed. Planning knows the two ends alone: what is sensed now and what is wanted.
When the goal is reached is open, so each iteration looks for the step that shows it best, the arrival step. What goes beyond the paper
comes in as an argument (`method.seam.Ideas`).
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float

from preimage.data.sequences import at_rate
from preimage.method.config import PlanConfig
from preimage.method.error_regression import adam
from preimage.method.prediction_error import ToGoal, ToSequence, goal_terms
from preimage.method.seam import Draft, ErrorTerm, Ideas, Objective, Problem, Regression
from preimage.network.inputs import as_input_sequence, home
from preimage.network.intention import IntentionState
from preimage.network.pdvmrnn import PDVMRNN, Generated
from preimage.records import Demonstration, Percept, Plan, Stopped


@dataclass(frozen=True, eq=False)
class Recognition:
    """The intention that explains a sensed sequence, and the sequence it regenerates."""

    intention: IntentionState
    generated: Generated
    error: float
    """Mean prediction error of a step, both modalities (equation 1)."""
    errors: Float[np.ndarray, " iterations"]
    stopped: Stopped


def plan(
    model: PDVMRNN, *, start: Percept | None = None, goal: Percept, config: PlanConfig | None = None, ideas: Ideas | None = None
) -> Plan:
    """Imagine a way from the start percept to the goal (section II-D).

    Args:
        model: a trained network.
        start: what is sensed now, frame and joints; by default the mean first percept of the demonstrations.
        goal: what is wanted; of it only the modalities that `config.modalities` names are looked at.
        config: how the intention is searched for.
        ideas: what is added to the paper's method; by default nothing.

    Returns:
        a plan, always; its error and its reason to have stopped say how far to trust it.

    Raises:
        ValueError: a frame or joints do not fit the model, are missing where they are needed, or are not finite.
    """
    began = time.perf_counter()
    config, ideas, start = config or PlanConfig(), ideas or Ideas(), start or home(model)
    problem = Problem.between(model, start, goal, config)
    objective = objective_of(problem, ideas)
    found = regress(problem, objective, ideas)
    draft = draft_of(found.best, problem, objective, generated=found.best_generated)
    for correct in ideas.corrections:
        draft = correct(draft, problem, objective)
    errors, seconds = found.errors.double().cpu().numpy(), time.perf_counter() - began
    return draft.plan(problem, start=start, goal=goal, errors=errors, stopped=found.stopped, seconds=seconds)


def objective_of(problem: Problem, ideas: Ideas) -> ToGoal:
    """What a plan is charged for: equation 2, and what ideas add to it."""
    terms: Sequence[ErrorTerm] = goal_terms(problem.goal, problem.config.modalities)
    for add in ideas.terms:
        terms = add(problem, terms)
    return ToGoal(problem.start, terms, problem.config.delay_penalty, problem.earliest_arrival)


def regress(problem: Problem, objective: Objective, ideas: Ideas) -> Regression:
    """Search from the initial guesses."""
    guesses = (ideas.initial_guess or random_guesses)(problem, objective, torch.Generator().manual_seed(problem.config.search_seed))
    return (ideas.search or adam)(problem, objective, guesses)


def random_guesses(problem: Problem, objective: Objective, generator: torch.Generator) -> torch.Tensor:
    """Random intentions about the mean of the training sequences', whose coordinates vary by about 1 (section II-C: "a random value")."""
    config, training = problem.config, problem.space.training
    drawn = torch.randn(config.candidates, training.shape[1], generator=generator).to(training)
    return training.mean(0) + config.initial_deviation * drawn


@torch.no_grad()
def draft_of(intention: IntentionState, problem: Problem, objective: Objective, *, generated: Generated | None = None) -> Draft:
    """What is imagined from an intention, its error, and when it arrives.

    Args:
        generated: what is imagined, where it is known.
    """
    generated = problem.imagine(intention) if generated is None else generated
    error, arrival = (each[0].item() for each in objective.errors(generated))
    joints = problem.model.coding.decode(generated.log_codes[0].exp()).double()
    return Draft(generated, joints, int(arrival), error, error / max(objective.to_explain, 1e-9), intention, joints)


def recognise(model: PDVMRNN, demonstration: Demonstration, *, config: PlanConfig | None = None, ideas: Ideas | None = None) -> Recognition:
    """Infer the intention of a whole sensed sequence, so that the model regenerates it in closed loop (section II-C, equation 1).

    Raises:
        ValueError: frames or joints do not fit the model.
    """
    pixels, codes = as_input_sequence(model, at_rate(demonstration, model.config.rate_hz))
    config = replace(config or PlanConfig(), horizon=pixels.shape[1])
    problem = Problem(model, (pixels[0, 0], codes[0, 0]), (pixels[0, -1], codes[0, -1]), config)
    objective = ToSequence((pixels, codes))
    found = regress(problem, objective, ideas or Ideas())
    with torch.no_grad():
        generated = found.best_generated or problem.imagine(found.best)
        error, _ = objective.errors(generated)
    return Recognition(found.best, generated, float(error), found.errors.double().cpu().numpy(), found.stopped)
