"""The simulated arm as a `Robot`, in a scene of a task, with whatever disturbs it (`robot.disturbances`)."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from preimage.records import Percept, Scene, Trial
from preimage.robot import Arm, Task
from preimage.robot.disturbances import Disturbance
from preimage.robot.execution import Stage, limits_of
from preimage.robot.limits import Limits


class SimulatedRobot:
    """One trial of the simulated arm.

    Args:
        disturbance: what goes wrong; by default nothing.
    """

    def __init__(self, arm: Arm, task: Task, scene: Scene, *, rate_hz: float, disturbance: Disturbance | None = None) -> None:
        self._stage, self._arm = Stage(task, arm, scene), arm
        self._period_s, self._disturbance = 1 / rate_hz, disturbance or Disturbance()
        self._late_frame = self._stage.percept.frame
        self._step, self._last = 0, np.array(scene.start_joints)

    @property
    def limits(self) -> Limits:
        return limits_of(self._arm)

    def sense(self) -> Percept:
        """What comes of camera and encoders, through the disturbance."""
        percept = self._stage.percept
        frame = self._late_frame if self._disturbance.frames_late_s else percept.frame
        return self._disturbance.sensed(replace(percept, frame=frame), self._step)

    def command(self, joints: Float[np.ndarray, " J"]) -> None:
        """Move as the disturbed encoders make it."""
        self._move(self._disturbance.commanded(np.asarray(joints, float)))
        self._step += 1
        self._disturbance.happens(self._arm, self._stage, self._step)

    def finish(self, limited: tuple[str, ...] = ()) -> Trial:
        """Let the arm come to rest at the last command, and let the task judge the whole course."""
        return self._stage.finish(self._last, limited)

    def _move(self, joints: Float[np.ndarray, " J"]) -> None:
        """To the joints within the period; a late frame shows where the arm was on the way."""
        late_s = min(self._disturbance.frames_late_s, self._period_s)
        before = self._last
        if late_s:
            on_the_way = before + (joints - before) * (1 - late_s / self._period_s)
            if late_s < self._period_s:
                self._arm.move(on_the_way, self._period_s - late_s)
            self._late_frame = self._arm.sense().frame
        self._stage.move(joints, late_s or self._period_s)
        self._last = joints
