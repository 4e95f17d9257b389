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
from torch import Tensor

from preimage.ideas.belief import Belief, Imagined
from preimage.ideas.gripper_events import events_in
from preimage.ideas.leg import Leg
from preimage.ideas.replan_config import ReplanConfig
from preimage.ideas.timed_search import Clock
from preimage.ideas.underway import Sensed, Window
from preimage.method.config import PlanConfig
from preimage.method.seam import Ideas, Problem
from preimage.network.inputs import as_inputs
from preimage.network.pdvmrnn import PDVMRNN
from preimage.records import Percept, Plan

REST = 0.005
"""A joint that moved by less than this share of its range since the step before is at rest."""
MOST_PERSISTENT = 3
"""Frames that are looked at for what was moved."""
ALIKE = 0.005
"""Two pictures that differ by less on average (of 2 from black to white) tell of the same thing in about the same place."""
MOST_WAITING = 5
"""Steps that are waited, arrived, for the robot to come to rest and for a frame to come."""


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
        self._leg: Leg | None = None

    @property
    def imagined(self) -> Imagined:
        """What is imagined now, of which a `Belief` tells in numbers."""
        leg = self._leg
        assert leg is not None
        return Imagined(leg.solution.generated, leg.way.joints, min(leg.at, leg.way.arrival), leg.way.arrival)

    def change_goal(self, goal: Percept) -> None:
        """Another goal is wanted in place of the one that the robot is on its way to; it need not stop for that.

        Where a step has no time for it the robot goes on as it was, and turns at the next; at rest it takes the time that it takes.
        """
        self._next_goal = goal

    @torch.no_grad()
    def __call__(self, percept: Percept, *, num_steps: int = 1) -> Belief:
        """What to do next, given what is sensed now. A frame that did not come is done without.

        Args:
            num_steps: steps since it was last asked, for whoever goes several of them between two looks.

        Raises:
            ValueError: a percept does not fit the model, has no joints, or is the first and has no frame.
        """
        self._clock.begin()
        self._step += num_steps if self._leg else 1
        leg = self._leg
        if leg is None:
            leg = self._begin(percept)
        else:
            self._remember(leg, percept, num_steps)
            if self._next_goal is not None and (self._clock.room or leg.has_arrived):
                leg = self._turn(leg, self._next_goal)
            elif leg.has_arrived and not self._looks_left and self._goals:
                leg = self._begin(Percept(self._last_frame, percept.joints))
        scene = self._see_what_moved(leg)
        leg = leg if scene is None else self._set_out(leg.from_another_scene(scene))
        window = self._window(leg)
        if window is not None and not leg.has_arrived and self._next_goal is None:
            leg.improve(window, rounds=self.settings.rounds)
        return self._decide(leg, window, scene is not None)

    def _begin(self, start: Percept) -> Leg:
        """The first plan to the next goal, from where the robot stands."""
        goal = self._goals.pop(0)
        with torch.enable_grad():  # which the search by Adam needs
            plan = self._found or self._plan(start=start, goal=goal)
        self._found, self._held = None, self._refuse(plan)
        problem = Problem.between(self._model, start, goal, replace(self._config, horizon=len(plan)))
        leg = self._set_out(Leg.begun(plan, problem, self._ideas, self._clock, enough=self.settings.enough))
        assert start.joints is not None
        self._last_frame, self._joints, self._was, self._stay = start.frame, start.joints, start.joints, start.joints
        return leg

    def _set_out(self, leg: Leg) -> Leg:
        """On another leg, of which nothing is doubted yet."""
        self._leg = leg
        self._num_doubts, self._num_waited = 0, 0
        self._looks_left = self.settings.looks if self._look else 0
        self._suspected: Tensor | None = None
        self._offset = np.zeros(self._model.sensors.num_joints)
        return leg

    def _remember(self, leg: Leg, percept: Percept, num_steps: int) -> None:
        """Some steps later; joints are those that the network would feel, had nothing been corrected."""
        if percept.joints is None:
            raise ValueError("the percept has no joints: without them there is no telling where the robot is")
        leg.at += num_steps
        seen = percept.frame is not None
        self._last_frame = percept.frame if seen else self._last_frame
        self._was, self._joints = self._joints, percept.joints
        step = min(leg.at, len(leg.way.joints) - 1)
        bare = percept.joints - leg.way.corrections[min(step, leg.way.arrival)] - self._offset
        pixels, codes = as_inputs(self._model, Percept(self._last_frame, bare), name="percept")
        leg.sensed.append(Sensed(step, pixels, codes, seen))

    def _turn(self, leg: Leg, goal: Percept) -> Leg:
        """To another goal from under way."""
        self._next_goal = None
        problem = Problem.between(self._model, Percept(self._last_frame, self._joints), goal, leg.problem.config)
        return self._set_out(leg.turned(problem, self._joints))

    def _see_what_moved(self, leg: Leg) -> Tensor | None:
        """The start picture as it has to be taken, where a thing is seen elsewhere than imagined, twice alike."""
        frames = [each for each in leg.sensed[-min(MOST_PERSISTENT, self._num_looked_at(leg)) :] if each.seen]
        if self._scene is None or not frames or leg.has_arrived or self._is_gripping(leg) or self._clock.room < 1:
            return None
        pixels, steps = torch.stack([each.pixels for each in frames]), [each.step for each in frames]
        seen = self._scene(leg.problem.start[0], pixels, leg.solution.generated.pixels[0, steps])
        suspected, self._suspected = self._suspected, seen
        return seen if seen is not None and suspected is not None and bool((seen - suspected).abs().mean() <= ALIKE) else None

    def _decide(self, leg: Leg, window: Window | None, moved: bool) -> Belief:
        """The next command, and what is believed."""
        way, window_error = leg.way, 0.0 if window is None else window.errors(leg.solution.generated).item()
        doubt = window_error / max(leg.error_of_staying, 1e-9)
        self._num_doubts = self._num_doubts + 1 if doubt > self.settings.disbelief else 0
        self._stay = self._stay if self._held else self._joints
        if self._num_doubts >= self.settings.patience and self._held is None:
            shares = f"{100 * doubt:.0f} % of the error of never leaving the start, for {self._num_doubts} steps"
            self._held = f"what is sensed is not what is imagined ({shares}, {100 * self.settings.disbelief:.0f} % are believed)"
        if leg.has_arrived and leg.sensed and self._held is None:
            self._look_once_more(leg)
        command = self._stay if self._held else way.joints[min(leg.at + 1, way.arrival)] + self._offset
        is_through = not self._looks_left and leg.at + 1 >= way.arrival  # with no looks to come, one command before the arrival
        return Belief(
            command=np.asarray(command, float),
            step=self._step,
            steps_left=max(0, way.arrival - leg.at),
            window_error=window_error,
            goal_error=way.error,
            unexplained=way.unexplained,
            doubt=doubt,
            moved=moved,
            num_imagined=self._clock.num_imagined,
            seconds=self._clock.spent_s,
            done=self._held is not None or (is_through and not self._goals and self._next_goal is None),
            held=self._held,
        )

    def _look_once_more(self, leg: Leg) -> None:
        """At rest at the goal: compare what is seen with it, or wait until there is something to be seen."""
        self._num_waited += 1
        at_rest = bool((np.abs(self._joints - self._was) < REST * leg.ranges).all())
        if not self._looks_left or not ((at_rest and leg.sensed[-1].seen) or self._num_waited > MOST_WAITING):
            return
        assert self._look is not None
        self._looks_left -= 1
        self._num_waited = 0
        self._offset = self._offset + self._look(leg.problem, leg.sensed[-1].pixels).double().cpu().numpy()

    def _window(self, leg: Leg) -> Window | None:
        """The last percepts that were sensed on the way."""
        part = leg.sensed[-self._num_looked_at(leg) :]
        return Window.of(part) if part else None

    def _num_looked_at(self, leg: Leg) -> int:
        return max(1, len(leg.sensed)) if self.settings.window == "all" else self.settings.window

    def _is_gripping(self, leg: Leg) -> bool:
        """Whether the hand has closed about something on the way so far."""
        way = torch.from_numpy(leg.way.joints[None, : leg.at + 2])
        return bool(events_in(way, self._gripper or 0, self._model.coding).any())
