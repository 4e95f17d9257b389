"""Execution of what was imagined, in physics and within limits: blind (closed loop), or with what the robot senses (open loop)."""

import functools
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from preimage.records import Percept, Plan, Scene, Trial
from preimage.robot import TASKS, Arm, Judgement, Task
from preimage.robot.limits import Limiter, Limits, within_limits

SETTLE_S = 0.5
"""Time the arm is given to come to rest on the last set point before the task is judged."""

ENCODER_MARGIN = 0.1
"""Joints are sensed at most this far beyond their limits (rad; gripper: m): stops give way a little."""
FARTHEST_M = 10.0
"""Nothing in a task is farther from the arm than this (m)."""

Policy = Callable[[Percept], Float[np.ndarray, " J"]]
"""What to command for the next step (rad; gripper: m), given what is sensed now."""


def execute(plan: Plan, arm: Arm, scene: Scene, *, task: Task | None = None, filmed: bool = True) -> Trial:
    """Play the plan's joints up to its arrival step without looking, and judge what happened.

    Args:
        task: by default the one that the scene names, seen in the default frames.
        filmed: whether the trial holds what the camera saw, which takes as long as a plan.

    Raises:
        ValueError: the plan is for other joints than the task's, or the scene is of a task that is not known.
    """
    task = task or task_of(scene)
    arm.set_up(task.workspace)
    if plan.joint_names != arm.joint_names:
        raise ValueError(f"the plan moves {', '.join(plan.joint_names)}, {task.name} needs {', '.join(arm.joint_names)}")
    return play(plan.joints[: plan.arrival_step + 1], plan.rate_hz, arm, scene, task=task, filmed=filmed)


def play(
    joints: Float[np.ndarray, "T J"], rate_hz: float, arm: Arm, scene: Scene, *, task: Task | None = None, filmed: bool = True
) -> Trial:
    """Lay out the scene and bring the arm through the joints (rad; gripper: m), one row a step; the first row is where it stands already.

    Args:
        task: by default the one that the scene names, seen in the default frames.
        filmed: whether the trial holds what the camera saw.

    Raises:
        ValueError: the scene is of a task that is not known.
    """
    stage = Stage(task or task_of(scene), arm, scene, filmed=filmed)
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
    """Let a policy that sees what the robot senses, step by step, command the arm, and judge what happened.

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
    stage = Stage(task or task_of(scene), arm, scene)
    limiter = Limiter(limits_of(arm), np.array(scene.start_joints), 1 / rate_hz)
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


def validate_scene(scene: Scene, task: Task, arm: Arm) -> None:
    """Raises ValueError where a scene cannot be laid out: a place or a joint is missing, or far from where the arm is."""
    known = TASKS.get(task.name)
    for name, num_numbers in positions_of(task.name).items() if known else ():
        position = scene.positions_m.get(name)
        if position is None or len(position) != num_numbers:
            raise ValueError(f"the scene of {task.name} has no position for the {name}: record it, or plan, again")
        if not all(abs(each) <= FARTHEST_M for each in position):
            raise ValueError(f"the scene of {task.name} has the {name} at {position} m, out of reach: record it, or plan, again")
    if len(scene.start_joints) != len(arm.joint_names):
        raise ValueError(f"the scene of {task.name} starts with {len(scene.start_joints)} joints, the arm has {', '.join(arm.joint_names)}")
    for name, angle, (low, high) in zip(arm.joint_names, scene.start_joints, arm.joint_limits, strict=True):
        if not low - ENCODER_MARGIN <= angle <= high + ENCODER_MARGIN:
            raise ValueError(f"the scene of {task.name} starts with {name} at {angle:g}, outside {low:g} to {high:g}: plan again")


@functools.cache
def positions_of(task: str) -> dict[str, int]:
    """Names of the places that a scene of a task has, and of how many numbers each is."""
    return {name: len(position) for name, position in TASKS[task].sample(np.random.default_rng(0)).positions_m.items()}


def limits_of(arm: Arm) -> Limits:
    """What the arm may be commanded in the workspace where it stands."""
    return Limits(arm.joint_names, arm.joint_units, arm.joint_limits[:, 0], arm.joint_limits[:, 1], arm.velocity_limits)


class Stage:
    """A scene laid out for one trial, in which everything that happens is written down.

    Args:
        filmed: whether what the camera sees is written down too; without, percepts have no frame.
    """

    def __init__(self, task: Task, arm: Arm, scene: Scene, *, filmed: bool = True) -> None:
        arm.set_up(task.workspace)
        validate_scene(scene, task, arm)
        task.lay_out(arm, scene)
        self._task, self._arm, self.scene, self._filmed = task, arm, scene, filmed
        self._percepts, self.course = [self._sense()], [arm.ground_truth()]

    @property
    def percept(self) -> Percept:
        """What the robot senses now."""
        return self._percepts[-1]

    def move(self, command: Float[np.ndarray, " J"], seconds: float) -> None:
        """Move the arm to the command, and keep what it senses then."""
        self._arm.move(command, seconds)
        self._percepts.append(self._sense())
        self.course.append(self._arm.ground_truth())

    def _sense(self) -> Percept:
        return self._arm.sense() if self._filmed else Percept(joints=self._arm.feel())

    @property
    def true_joints(self) -> Float[np.ndarray, " J"]:
        """Where the arm is now (rad; gripper: m)."""
        joints = self._percepts[-1].joints
        assert joints is not None
        return joints

    def disturb(self, happens: Callable[[], object]) -> None:
        """Let something happen to arm or scene; this moment is the one after it."""
        happens()
        self._percepts[-1], self.course[-1] = self._sense(), self._arm.ground_truth()

    def judge(self) -> Judgement:
        """How the task judges the course so far."""
        return self._task.judge(self.scene, self.course)

    def finish(self, command: Float[np.ndarray, " J"], limited: tuple[str, ...]) -> Trial:
        """Let the arm come to rest at the last command, and let the task judge the whole course."""
        self.move(command, SETTLE_S)
        judgement, camera = self.judge(), self._task.workspace.camera
        frames = [percept.frame for percept in self._percepts if percept.frame is not None]
        return Trial(
            frames=np.array(frames, np.uint8).reshape(-1, camera.height, camera.width, 1),
            joints=np.array([percept.joints for percept in self._percepts]),
            end_effector_m=np.array([moment.end_effector_m for moment in self.course]),
            deviation_m=judgement.deviation_m,
            success=judgement.success,
            scene=self.scene,
            limited=limited,
            details=judgement.details,
        )
