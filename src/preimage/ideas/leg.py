"""A leg: the way to one goal while it is gone, with what was sensed on it, the solution that explains it, and what the robot is to do."""

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from preimage.ideas.belief import Way
from preimage.ideas.timed_search import ByGaussNewton, Clock, Improve, Solution, by_adam
from preimage.ideas.underway import Sensed, Underway, Window
from preimage.method.plan import draft_of, objective_of
from preimage.method.prediction_error import ToGoal
from preimage.method.seam import Ideas, Problem
from preimage.network.pdvmrnn import Generated
from preimage.records import Plan

FEW = 32
"""Numbers of an intention up to which what each of them does is measured."""
CONTENT = 1.1
"""An error is searched anew when it is this many times what the last search could not lower."""


class Leg:
    """From a start to a goal; it is begun by a plan, or turned to from another leg.

    Args:
        problem: from where to where.
        ideas: those of the plans; of the corrections those that can be made at every step.
        clock: tells how much time is left.
        enough: share of the error of staying at the start up to which nothing is searched for.
    """

    solution: Solution
    way: Way

    def __init__(self, problem: Problem, ideas: Ideas, clock: Clock, *, enough: float) -> None:
        self.problem, self._ideas, self._clock, self._enough = problem, ideas, clock, enough
        self.to_goal = objective_of(problem, ideas)
        self._improver: Improve = ByGaussNewton() if problem.space.training.shape[1] <= FEW else by_adam
        self.sensed: list[Sensed] = []
        self.at = 0
        self._content = enough * self.to_goal.to_explain
        self._looks_saw: Float[np.ndarray, "T J"] | float = 0.0

    @classmethod
    def begun(cls, plan: Plan, problem: Problem, ideas: Ideas, clock: Clock, *, enough: float) -> "Leg":
        """As a plan has it."""
        leg = cls(problem, ideas, clock, enough=enough)
        points = problem.space.coordinates_of(torch.from_numpy(plan.intention)[None])
        problem.imagine(problem.space.intention(points), 1)  # the first time takes longer, and is not to be measured
        leg.solution = Solution(points, clock.imagine(problem, points))
        imagined = problem.model.coding.decode(leg.solution.generated.log_codes[0].exp()).double().cpu().numpy()
        leg._looks_saw = 0.0 if plan.imagined_joints is None else plan.imagined_joints - imagined
        leg.way = Way(plan.joints, plan.joints - imagined, plan.arrival_step, plan.error, plan.unexplained or 0.0)
        leg._content += plan.error
        return leg

    def turned(self, problem: Problem, joints: Float[np.ndarray, " J"]) -> "Leg":
        """To another goal from under way: the way there, from the same start, is entered where it passes nearest to the robot.

        It begins at the first guess of a plan or at the last solution, whichever is nearer to the goal; where there is no time to compare
        them, at the first guess.
        """
        other = Leg(replace(problem, start=self.problem.start), self._ideas, self._clock, enough=self._enough)
        guesses = [self.solution.points]
        if self._ideas.initial_guess is not None:
            generator = torch.Generator().manual_seed(problem.config.search_seed)
            guesses.insert(0, self._ideas.initial_guess(other.problem, other.to_goal, generator))
        points = torch.cat(guesses)[: max(1, self._clock.room)]
        imagined = self._clock.imagine(other.problem, points)
        best = other.to_goal.errors(imagined)[0].argmin()[None]
        other.solution = Solution(points[best], Generated(imagined.pixels[best], imagined.log_codes[best]))
        other.way = other._corrected()
        other.at = nearest_step(other.way.joints[: other.way.arrival + 1], joints, other.ranges)
        return other

    def from_another_scene(self, start: Float[Tensor, "C H W"]) -> "Leg":
        """The same, had the start picture been another."""
        problem = replace(self.problem, start=(start, self.problem.start[1]))
        other = Leg(problem, self._ideas, self._clock, enough=self._enough)
        other.sensed, other.at, other._content, other._looks_saw = self.sensed, self.at, self._content, self._looks_saw
        other.solution = Solution(self.solution.points, self._clock.imagine(problem, self.solution.points))
        other.way = other._corrected()
        return other

    def improve(self, window: Window, *, rounds: int) -> None:
        """Move the intention while time allows and it is worthwhile."""
        objective, before = Underway(self._from_now_on, window), self.solution
        for _ in range(rounds):
            error = objective.errors(self.solution.generated)[0].item()
            if error <= self._content or self._clock.room < 1:
                break
            there = self._improver(self.problem, objective, self.solution, self._clock)
            if there is None:
                self._content = CONTENT * error
                break
            self.solution = there
        if self.solution is not before:
            self.way = self._corrected()

    @property
    def has_arrived(self) -> bool:
        return self.at >= self.way.arrival

    @property
    def error_of_staying(self) -> float:
        """The most that a window would show of a robot that stays at the start while it is taken to go."""
        stayed = [Sensed(step, *self.problem.start, True) for step in range(self.way.arrival + 1)]
        return Window.of(stayed).errors_by_step(self.solution.generated).max().item()

    @property
    def ranges(self) -> Float[np.ndarray, " J"]:
        """Those of the joints."""
        sensors = self.problem.model.sensors
        return np.array(sensors.joint_upper) - np.array(sensors.joint_lower)

    def _corrected(self) -> Way:
        """What the solution has the robot do: as a plan is corrected, from the arrival on that is best from now on."""
        problem, objective = self.problem, self._from_now_on
        intention = problem.space.intention(self.solution.points)
        found = draft_of(intention, problem, objective, generated=self.solution.generated)
        joints = found.joints + torch.as_tensor(self._looks_saw).to(found.joints)
        draft = replace(found, joints=joints, imagined=joints)
        for correct in self._ideas.corrections:
            draft = correct(draft, problem, objective)
        way = draft.joints.cpu().numpy()
        return Way(way, way - found.joints.cpu().numpy(), draft.arrival, found.error, found.unexplained)

    @property
    def _from_now_on(self) -> ToGoal:
        """The goal's error, at a step still to come."""
        return replace(self.to_goal, earliest=min(max(self.to_goal.earliest, self.at), self.problem.num_steps - 1))


def nearest_step(way: Float[np.ndarray, "T J"], joints: Float[np.ndarray, " J"], ranges: Float[np.ndarray, " J"]) -> int:
    """Where a way passes nearest to joints, in the joints' ranges; the last of equals, and never its end, to which it has to be gone."""
    distances = np.square((way - joints) / ranges).sum(1)[: max(1, len(way) - 1)]
    return len(distances) - 1 - int(distances[::-1].argmin())
