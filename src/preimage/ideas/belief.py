"""What is believed at one step of a plan that is replanned while it is executed, what follows for the robot, and what is imagined."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from preimage.network.pdvmrnn import Generated


@dataclass(frozen=True, eq=False)
class Belief:
    """What is believed, and commanded, at one step."""

    command: Float[np.ndarray, " J"]
    """Where to be at the next step (units of the joints)."""
    step: int
    """Percepts since the start, this one not counted."""
    steps_left: int
    """Steps to the arrival, as it is imagined now."""
    window_error: float
    """Mean prediction error of what was sensed in the window."""
    goal_error: float
    """Prediction error of the goal and the start, where the way arrives."""
    unexplained: float
    """The goal's error as a share of that of staying at the start."""
    doubt: float
    """The window's error as a share of what it were, at most, had the robot never left its start; above `disbelief` it is held."""
    moved: bool
    """Whether a thing was seen to be elsewhere."""
    num_imagined: int
    """Sequences that were imagined at this step."""
    seconds: float
    done: bool
    """Whether this was the last command."""
    held: str | None = None
    """Why the robot is held where it is, if it is."""


@dataclass(frozen=True, eq=False)
class Way:
    """What a solution has the robot do."""

    joints: Float[np.ndarray, "T J"]
    corrections: Float[np.ndarray, "T J"]
    """How far the joints are from those that the network imagines."""
    arrival: int
    error: float
    unexplained: float


@dataclass(frozen=True, eq=False)
class Imagined:
    """The whole way from the start to the goal, as it is imagined at one step."""

    generated: Generated
    """One sequence of T steps; the same object as long as no other way is imagined."""
    joints: Float[np.ndarray, "T J"]
    """With all corrections."""
    at: int
    """The step of it at which the robot is."""
    arrival: int
