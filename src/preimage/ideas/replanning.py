"""Eyes open: while the robot moves, what it senses is explained, and the rest of the way planned anew, at every step.

At each step the last `window` percepts are recognised together with the goal: one intention, whose imagined future passes what was sensed
and ends in the goal, by error regression with the weights frozen. Where on the imagined way the robot is, is the state at the window's end;
from there the rest is imagined in closed loop, the arrival step chosen among the steps to come, and corrected as a plan is. The last
solution is the first guess of the next: undisturbed it explains the next percept as well, and nothing has to be searched.

What the network imagines follows from its intention and its first percept; percepts that are fed in later hardly move it (docs/log.md).
So what was sensed is compared, not fed in. And where a thing on the table is seen to stand elsewhere, the first percept is taken to have
been otherwise (`ideas.moved_things`), and the way follows.

Thinking is bounded in time: a step begins no work that by its own measure would end too late, and what is not done in one step is done in
the next.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from preimage.ideas.belief import Belief, Imagined, Way
from preimage.ideas.gripper_events import events_in
from preimage.ideas.replan_config import ReplanConfig
from preimage.ideas.timed_search import ByGaussNewton, Clock, Improve, Solution, by_adam
from preimage.ideas.underway import Sensed, Underway, Window
from preimage.method.config import PlanConfig
from preimage.method.plan import draft_of, objective_of
from preimage.method.prediction_error import ToGoal
from preimage.method.seam import Ideas, Problem
from preimage.network.inputs import as_inputs
from preimage.network.pdvmrnn import PDVMRNN, Generated
from preimage.records import Percept, Plan

REST = 0.005
"""A joint that moved by less than this share of its range since the step before is at rest."""
FEW = 32
"""Numbers of an intention up to which what each of them does is measured."""
MOST_PERSISTENT = 3
"""Frames that are looked at for what was moved."""
ALIKE = 0.005
"""Two pictures that differ by less on average (of 2 from black to white) tell of the same thing in about the same place."""
MOST_WAITING = 5
"""Steps that are waited, arrived, for the robot to come to rest and for a frame to come."""
CONTENT = 1.1
"""An error is searched anew when it is this many times what the last search could not lower."""


class Replanner:
    """From what is sensed to what to command, step by step, with one goal or several in a row.

    It is asked once a period, first where the robot stands at its start; there the first plan is made, which takes as long as it takes.

    Args:
        model: a trained network.
        plan: how the first plan to a goal is made (`presets.Planner.plan`).
        goals: what is wanted, one after the other.
        config: how plans are searched for.
        ideas: those of the plans; of the corrections those that can be made at every step.
        settings: how much is done at each step.
        found: a plan to the first goal from here, where there is one already.
        look: what to add to the joints in which the robot stands at the goal, from what is seen there.
        scene: the start picture as it has to be taken after what was seen and what was imagined in its place; None where it may stay.
        gripper: the joint that opens and closes, where things are moved.
        refuse: a reason to stay where the robot is, or None, of every first plan to a goal.
        clock: tells the time (s).

    Raises:
        ValueError: there is no goal, or a percept does not fit the model.
    """

    def __init__(
        self,
        model: PDVMRNN,
        plan: Callable[..., Plan],
        *,
        goals: Sequence[Percept],
        config: PlanConfig,
        ideas: Ideas,
        settings: ReplanConfig | None = None,
        found: Plan | None = None,
        look: Callable[[Problem, Tensor], Tensor] | None = None,
        scene: Callable[[Tensor, Tensor, Tensor], Tensor | None] | None = None,
        gripper: int | None = None,
        refuse: Callable[[Plan], str | None] = lambda plan: None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        if not goals:
            raise ValueError("there is no goal: give one or more")
        self.settings = settings or ReplanConfig()
        self._model, self._plan, self._config, self._ideas = model, plan, config, ideas
        self._look, self._scene, self._gripper, self._refuse = look, scene, gripper, refuse
        self._clock = Clock(clock, self.settings.budget_ms / 1000)
        self._goals, self._found = list(goals), found
        self._step, self._held, self._num_doubts = -1, None, 0
        self._next_goal: Percept | None = None
        self._has_begun = False

    @property
    def imagined(self) -> Imagined:
        """What is imagined now, of which a `Belief` tells in numbers."""
        return Imagined(self._solution.generated, self._way.joints, min(self._at, self._way.arrival), self._way.arrival)

    def change_goal(self, goal: Percept) -> None:
        """Another goal is wanted in place of the one that the robot is on its way to; it need not stop for that."""
        self._next_goal = goal

    @torch.no_grad()
    def __call__(self, percept: Percept) -> Belief:
        """What to do next, given what is sensed now. A frame that did not come is done without.

        Raises:
            ValueError: a percept does not fit the model, has no joints, or is the first and has no frame.
        """
        self._clock.begin()
        self._step += 1
        if not self._has_begun:
            self._begin(percept)
        else:
            self._remember(percept)
            if self._next_goal is not None:
                self._turn(self._next_goal)
            elif self._has_arrived and not self._looks_left and self._goals:
                self._begin(Percept(self._last_frame, percept.joints))
        self._next_goal = None
        moved = self._see_what_moved()
        window = self._window()
        if window is not None and not self._has_arrived:
            self._improve(window)
        return self._decide(window, moved)

    def _begin(self, start: Percept) -> None:
        """The first plan to the next goal, from where the robot stands."""
        goal = self._goals.pop(0)
        with torch.enable_grad():  # which the search by Adam needs
            plan = self._found or self._plan(start=start, goal=goal)
        self._found, self._held = None, self._refuse(plan)
        self._set_up(Problem.between(self._model, start, goal, replace(self._config, horizon=len(plan))))
        points = self._problem.space.coordinates_of(torch.from_numpy(plan.intention)[None])
        self._problem.imagine(self._problem.space.intention(points), 1)  # the first time takes longer, and is not to be measured
        self._solution = Solution(points, self._clock.imagine(self._problem, points))
        imagined = self._imagined_joints()
        self._looks_saw = np.zeros_like(imagined) if plan.imagined_joints is None else plan.imagined_joints - imagined
        self._way = Way(plan.joints, plan.joints - imagined, plan.arrival_step, plan.error, plan.unexplained or 0.0)
        self._content = plan.error + self._enough
        assert start.joints is not None
        self._has_begun = True
        self._last_frame, self._joints, self._was, self._at = start.frame, start.joints, start.joints, 0
        self._stay = start.joints

    def _set_up(self, problem: Problem) -> None:
        """Another problem, on the way of which nothing was sensed yet."""
        self._problem: Problem = problem
        self._to_goal = objective_of(problem, self._ideas)
        self._improver: Improve = ByGaussNewton() if problem.space.training.shape[1] <= FEW else by_adam
        self._sensed: list[Sensed] = []
        self._num_doubts, self._num_waited = 0, 0
        self._looks_left = self.settings.looks if self._look else 0
        self._suspected: Tensor | None = None
        self._offset = np.zeros(self._model.sensors.num_joints)

    def _remember(self, percept: Percept) -> None:
        """A step later; joints are those that the network would feel, had nothing been corrected."""
        if percept.joints is None:
            raise ValueError("the percept has no joints: without them there is no telling where the robot is")
        self._at += 1
        seen = percept.frame is not None
        self._last_frame = percept.frame if seen else self._last_frame
        self._was, self._joints = self._joints, percept.joints
        step = min(self._at, len(self._way.joints) - 1)
        bare = percept.joints - self._way.corrections[min(step, self._way.arrival)] - self._offset
        pixels, codes = as_inputs(self._model, Percept(self._last_frame, bare), name="percept")
        self._sensed.append(Sensed(step, pixels, codes, seen))

    def _turn(self, goal: Percept) -> None:
        """To another goal from under way: the way there, from the same start, is entered where it passes nearest to the robot."""
        problem = self._problem
        other = Problem.between(self._model, Percept(self._last_frame, self._joints), goal, problem.config)
        self._set_up(replace(other, start=problem.start))
        guesses = [self._solution.points]
        if self._ideas.initial_guess is not None:
            generator = torch.Generator().manual_seed(self._config.search_seed)
            guesses.append(self._ideas.initial_guess(self._problem, self._to_goal, generator))
        points = torch.cat(guesses)
        imagined = self._clock.imagine(self._problem, points)
        best = self._to_goal.errors(imagined)[0].argmin()[None]
        self._solution = Solution(points[best], Generated(imagined.pixels[best], imagined.log_codes[best]))
        self._looks_saw, self._content, self._at = np.zeros_like(self._looks_saw), self._enough, 0
        self._way = self._corrected()
        self._at = nearest_step(self._way.joints[: self._way.arrival + 1], self._joints, self._ranges)

    def _see_what_moved(self) -> bool:
        """Whether a thing is seen elsewhere than imagined, twice alike; then it is taken to have stood there at the start."""
        frames = [each for each in self._sensed[-min(MOST_PERSISTENT, self._num_looked_at) :] if each.seen]
        if self._scene is None or not frames or self._has_arrived or self._is_gripping or self._clock.room < 1:
            return False
        problem, points = self._problem, self._solution.points
        pixels, steps = torch.stack([each.pixels for each in frames]), [each.step for each in frames]
        seen = self._scene(problem.start[0], pixels, self._solution.generated.pixels[0, steps])
        suspected, self._suspected = self._suspected, seen
        if seen is None or suspected is None or bool((seen - suspected).abs().mean() > ALIKE):
            return False
        sensed, content = self._sensed, self._content
        self._set_up(replace(problem, start=(seen, problem.start[1])))
        self._sensed, self._content = sensed, content
        self._solution = Solution(points, self._clock.imagine(self._problem, points))
        self._way = self._corrected()
        return True

    def _improve(self, window: Window) -> None:
        """Move the intention while time allows and it is worthwhile."""
        objective, before = Underway(self._from_now_on, window), self._solution
        for _ in range(self.settings.rounds):
            error = objective.errors(self._solution.generated)[0].item()
            if error <= self._content or self._clock.room < 1:
                break
            there = self._improver(self._problem, objective, self._solution, self._clock)
            if there is None:
                self._content = CONTENT * error
                break
            self._solution = there
        if self._solution is not before:
            self._way = self._corrected()

    def _corrected(self) -> Way:
        """What a solution has the robot do: as a plan is corrected, from the arrival on that is best from now on."""
        problem, objective = self._problem, self._from_now_on
        intention = problem.space.intention(self._solution.points)
        found = draft_of(intention, problem, objective, generated=self._solution.generated)
        joints = found.joints + torch.from_numpy(self._looks_saw).to(found.joints)
        draft = replace(found, joints=joints, imagined=joints)
        for correct in self._ideas.corrections:
            draft = correct(draft, problem, objective)
        way = draft.joints.cpu().numpy()
        return Way(way, way - found.joints.cpu().numpy(), draft.arrival, found.error, found.unexplained)

    def _decide(self, window: Window | None, moved: bool) -> Belief:
        """The next command, and what is believed."""
        window_error = 0.0 if window is None else window.errors(self._solution.generated).item()
        doubt = window_error / max(self._to_goal.to_explain, 1e-9)
        self._num_doubts = self._num_doubts + 1 if doubt > self.settings.disbelief else 0
        self._stay = self._stay if self._held else self._joints
        if self._num_doubts >= self.settings.patience and self._held is None:
            shares = f"{100 * doubt:.0f} % of the error of staying at the start, for {self._num_doubts} steps"
            self._held = f"what is sensed is not what is imagined ({shares}, {100 * self.settings.disbelief:.0f} % are believed)"
        if self._has_arrived and self._sensed and self._held is None:
            self._look_once_more()
        command = self._stay if self._held else self._way.joints[min(self._at + 1, self._way.arrival)] + self._offset
        return Belief(
            command=np.asarray(command, float),
            step=self._step,
            steps_left=max(0, self._way.arrival - self._at),
            window_error=window_error,
            goal_error=self._way.error,
            unexplained=self._way.unexplained,
            doubt=doubt,
            moved=moved,
            num_imagined=self._clock.num_imagined,
            seconds=self._clock.spent_s,
            done=self._held is not None or (not self._goals and self._is_through),
            held=self._held,
        )

    def _look_once_more(self) -> None:
        """At rest at the goal: compare what is seen with it, or wait until there is something to be seen."""
        self._num_waited += 1
        at_rest = bool((np.abs(self._joints - self._was) < REST * self._ranges).all())
        if not self._looks_left or not ((at_rest and self._sensed[-1].seen) or self._num_waited > MOST_WAITING):
            return
        assert self._look is not None
        self._looks_left -= 1
        self._num_waited = 0
        self._offset = self._offset + self._look(self._problem, self._sensed[-1].pixels).double().cpu().numpy()

    def _window(self) -> Window | None:
        """The last percepts that were sensed on the way."""
        part = self._sensed[-self._num_looked_at :]
        return Window.of(part) if part else None

    def _imagined_joints(self) -> Float[np.ndarray, "T J"]:
        """As the network imagines them, from one look."""
        return self._model.coding.decode(self._solution.generated.log_codes[0].exp()).double().cpu().numpy()

    @property
    def _from_now_on(self) -> ToGoal:
        """The goal's error, at a step still to come."""
        return replace(self._to_goal, earliest=min(max(self._to_goal.earliest, self._at), self._problem.num_steps - 1))

    @property
    def _ranges(self) -> Float[np.ndarray, " J"]:
        return np.array(self._model.sensors.joint_upper) - np.array(self._model.sensors.joint_lower)

    @property
    def _num_looked_at(self) -> int:
        return max(1, len(self._sensed)) if self.settings.window == "all" else self.settings.window

    @property
    def _enough(self) -> float:
        return self.settings.enough * self._to_goal.to_explain

    @property
    def _has_arrived(self) -> bool:
        return self._at >= self._way.arrival

    @property
    def _is_through(self) -> bool:
        """Whether nothing is left to be done but to come to rest: with no looks to come, one command before the arrival."""
        return not self._looks_left and self._at + 1 >= self._way.arrival

    @property
    def _is_gripping(self) -> bool:
        """Whether the hand has closed about something on the way so far."""
        way = torch.from_numpy(self._way.joints[None, : self._at + 2])
        return bool(events_in(way, self._gripper or 0, self._model.coding).any())


def nearest_step(way: Float[np.ndarray, "T J"], joints: Float[np.ndarray, " J"], ranges: Float[np.ndarray, " J"]) -> int:
    """Where a way passes nearest to joints, in the joints' ranges; the last of equals, and never its end, to which it has to be gone."""
    distances = np.square((way - joints) / ranges).sum(1)[: max(1, len(way) - 1)]
    return len(distances) - 1 - int(distances[::-1].argmin())
