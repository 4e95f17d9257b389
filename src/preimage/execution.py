"""Let the arm do what was imagined, in physics and within its limits: blind, or with an eye on what it senses.

>>> import numpy as np
>>> limits = Limits(("yaw",), ("rad",), lower=np.array([-1.0]), upper=np.array([1.0]), velocity=np.array([2.0]))
>>> commands, limited = within_limits(np.array([[0.0], [0.1], [1.2]]), limits, period_s=0.2)
>>> commands[:, 0].round(3).tolist()
[0.0, 0.1, 0.5, 0.9, 1.0]
>>> limited
('yaw kept above -1 and below 1 rad in 1 step', 'yaw slowed to 2 rad/s in 2 steps')
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from preimage.records import Percept, Plan, Scene, Trial
from preimage.robot import TASKS, Arm, Task

SETTLE_S = 0.5
"""Time the arm is given to come to rest on the last set point before the task is judged."""

Policy = Callable[[Percept], Float[np.ndarray, " J"]]
"""What to command for the next step (rad; gripper: m), given what is sensed now."""


@dataclass(frozen=True, eq=False)
class Limits:
    """What the arm may be commanded, joint by joint."""

    joint_names: tuple[str, ...]
    units: tuple[str, ...]
    """rad, or m"""
    lower: Float[np.ndarray, " J"]
    """In units."""
    upper: Float[np.ndarray, " J"]
    """In units."""
    velocity: Float[np.ndarray, " J"]
    """In units a second."""


def execute(plan: Plan, arm: Arm, scene: Scene, *, task: Task | None = None) -> Trial:
    """Play the plan's joints up to its arrival step without looking, and judge the course of it.

    Args:
        task: by default the one that the scene names, seen in the default frames.

    Raises:
        ValueError: the plan is for other joints than the task's, or the scene is of a task that is not known.
    """
    task = task or task_of(scene)
    arm.furnish(task.furniture)
    if plan.joint_names != arm.joint_names:
        raise ValueError(f"the plan moves {', '.join(plan.joint_names)}, {task.name} needs {', '.join(arm.joint_names)}")
    return play(plan.joints[: plan.arrival_step + 1], plan.rate_hz, arm, scene, task=task)


def play(joints: Float[np.ndarray, "T J"], rate_hz: float, arm: Arm, scene: Scene, *, task: Task | None = None) -> Trial:
    """Lay out the scene and bring the arm through the joints (rad; gripper: m), one row a step; the first row is where it stands already.

    Args:
        task: by default the one that the scene names, seen in the default frames.

    Raises:
        ValueError: the scene is of a task that is not known.
    """
    stage = _Stage(task or task_of(scene), arm, scene)
    from_here = np.vstack([np.array(scene.start_joints), joints[1:]])
    commands, limited = within_limits(from_here, limits_of(arm), period_s=1 / rate_hz)
    for command in commands[1:]:
        stage.move(command, 1 / rate_hz)
    return stage.finish(commands[-1], limited)


def execute_open_loop(
    policy: Policy,
    arm: Arm,
    scene: Scene,
    *,
    num_steps: int,
    rate_hz: float,
    task: Task | None = None,
) -> Trial:
    """Let a policy that sees what the robot senses, step by step, command the arm, and judge the course of it.

    The limits are those of blind execution, but a policy that asks for too much gets no more time: it senses that it was slowed.

    Args:
        policy: called once a step with what is sensed; returns the joints to command for the next step (rad; gripper: m).
        num_steps: how often the policy is asked.
        task: by default the one that the scene names, seen in the default frames.

    Raises:
        ValueError: num_steps is too small, the scene is of a task that is not known, or the policy commands other joints than the task's.
    """
    if num_steps < 1:
        raise ValueError(f"num_steps is {num_steps}: ask the policy once or more")
    stage = _Stage(task or task_of(scene), arm, scene)
    limiter = _Limiter(limits_of(arm), np.array(scene.start_joints), 1 / rate_hz)
    for _ in range(num_steps):
        wanted = np.asarray(policy(stage.percept))
        if wanted.shape != (len(arm.joint_names),):
            raise ValueError(f"the policy commands joints of shape {wanted.shape}; the arm has {', '.join(arm.joint_names)}")
        stage.move(limiter.follow(wanted), 1 / rate_hz)
    return stage.finish(limiter.command, limiter.sentences())


def task_of(scene: Scene) -> Task:
    """The task that a scene names.

    Raises:
        ValueError: it is not known.
    """
    if scene.task not in TASKS:
        raise ValueError(f"the scene is of task {scene.task!r}; known are {', '.join(TASKS)}")
    return TASKS[scene.task]


def limits_of(arm: Arm) -> Limits:
    """What the arm may be commanded among the furniture where it stands."""
    return Limits(arm.joint_names, arm.joint_units, arm.joint_limits[:, 0], arm.joint_limits[:, 1], arm.velocity_limits)


def within_limits(joints: Float[np.ndarray, "T J"], limits: Limits, *, period_s: float) -> tuple[Float[np.ndarray, "S J"], tuple[str, ...]]:
    """The commands that follow `joints` within the limits, and a sentence for each limit that changed them.

    A step that would be too fast is shortened and made up for in the steps after it; where the end is not reached in time, steps are
    added (S >= T). The first row is where the arm is.
    """
    limiter = _Limiter(limits, joints[0], period_s)
    commands = [limiter.command]
    for wanted in joints[1:]:
        commands.append(limiter.follow(wanted))
    while not limiter.has_arrived:
        commands.append(limiter.catch_up())
    return np.stack(commands), limiter.sentences()


def counted(steps: int) -> str:
    return "1 step" if steps == 1 else f"{steps} steps"


class _Limiter:
    """Follows the joints that are wanted, one step at a time, as well as the limits allow, and counts where they did not."""

    def __init__(self, limits: Limits, start: Float[np.ndarray, " J"], period_s: float) -> None:
        self._limits = limits
        self._reach = limits.velocity * period_s
        self._num_kept, self._num_slowed = np.zeros((2, len(self._reach)), int)
        self.command = self._wanted = self._allowed(start)

    @property
    def has_arrived(self) -> bool:
        """Whether the last command is what was wanted, as far as it is allowed."""
        return np.allclose(self.command, self._wanted)

    def follow(self, wanted: Float[np.ndarray, " J"]) -> Float[np.ndarray, " J"]:
        """The next command towards new wanted joints."""
        self._wanted = self._allowed(wanted)
        return self.catch_up()

    def catch_up(self) -> Float[np.ndarray, " J"]:
        """The next command towards the joints that were wanted last."""
        missing = self._wanted - self.command
        self._num_slowed += np.abs(missing) > self._reach + 1e-9
        self.command = self.command + np.clip(missing, -self._reach, self._reach)
        return self.command

    def sentences(self) -> tuple[str, ...]:
        """A sentence for each limit that changed a command."""
        named = list(zip(self._limits.joint_names, self._limits.units, strict=True))
        bounds = zip(named, self._limits.lower, self._limits.upper, self._num_kept, strict=True)
        speeds = zip(named, self._limits.velocity, self._num_slowed, strict=True)
        return tuple(
            [
                f"{name} kept above {low:g} and below {high:g} {unit} in {counted(count)}"
                for (name, unit), low, high, count in bounds
                if count
            ]
            + [f"{name} slowed to {velocity:g} {unit}/s in {counted(count)}" for (name, unit), velocity, count in speeds if count]
        )

    def _allowed(self, wanted: Float[np.ndarray, " J"]) -> Float[np.ndarray, " J"]:
        allowed = np.clip(wanted, self._limits.lower, self._limits.upper)
        self._num_kept += allowed != wanted
        return allowed


class _Stage:
    """A scene laid out for one trial, in which everything that happens is written down."""

    def __init__(self, task: Task, arm: Arm, scene: Scene) -> None:
        task.lay_out(arm, scene)
        self._task, self._arm, self._scene = task, arm, scene
        self._percepts, self._course = [arm.sense()], [arm.witness()]

    @property
    def percept(self) -> Percept:
        """What the robot senses now."""
        return self._percepts[-1]

    def move(self, command: Float[np.ndarray, " J"], seconds: float) -> None:
        """The arm went where it was commanded, and what it sensed then is kept."""
        self._arm.move(command, seconds)
        self._percepts.append(self._arm.sense())
        self._course.append(self._arm.witness())

    def finish(self, command: Float[np.ndarray, " J"], limited: tuple[str, ...]) -> Trial:
        """The arm has come to rest at the last command, and the task has judged the course of it all."""
        self.move(command, SETTLE_S)
        judgement = self._task.judge(self._scene, self._course)
        return Trial(
            frames=np.array([percept.frame for percept in self._percepts]),
            joints=np.array([percept.joints for percept in self._percepts]),
            end_effector_m=np.array([moment.end_effector_m for moment in self._course]),
            deviation_m=judgement.deviation_m,
            success=judgement.success,
            scene=self._scene,
            limited=limited,
            details=judgement.details,
        )
