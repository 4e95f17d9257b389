"""Let the arm do what was imagined: blind, in physics, within its limits.

>>> import numpy as np
>>> limits = Limits(("yaw",), lower=np.array([-1.0]), upper=np.array([1.0]), velocity=np.array([2.0]))
>>> commands, limited = within_limits(np.array([[0.0], [0.1], [1.2]]), limits, period_s=0.2)
>>> commands[:, 0].round(3).tolist()
[0.0, 0.1, 0.5, 0.9, 1.0]
>>> limited
('yaw kept above -1 and below 1 rad in 1 step', 'yaw slowed to 2 rad/s in 2 steps')
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from preimage.records import Plan, Scene, Trial
from preimage.robot import TASKS, Arm

SETTLE_S = 0.5
"""Time the arm is given to come to rest on the last set point before the task is judged."""


@dataclass(frozen=True, eq=False)
class Limits:
    """What the arm may be commanded, joint by joint."""

    joint_names: tuple[str, ...]
    lower: Float[np.ndarray, " J"]
    """rad"""
    upper: Float[np.ndarray, " J"]
    """rad"""
    velocity: Float[np.ndarray, " J"]
    """rad/s"""


def execute(plan: Plan, arm: Arm, scene: Scene) -> Trial:
    """Play the plan's joints up to its arrival step without looking, and judge where the arm ends.

    Raises:
        ValueError: the plan is for other joints than the arm's, or the scene is of a task that is not known.
    """
    if plan.joint_names != tuple(arm.joint_names):
        raise ValueError(f"the plan moves {', '.join(plan.joint_names)}, the arm has {', '.join(arm.joint_names)}")
    return play(plan.joints[: plan.arrival_step + 1], plan.rate_hz, arm, scene)


def play(joints: Float[np.ndarray, "T J"], rate_hz: float, arm: Arm, scene: Scene) -> Trial:
    """Lay out the scene and bring the arm through the joints (rad), one row a step; the first row is where it stands already.

    Raises:
        ValueError: the scene is of a task that is not known.
    """
    if scene.task not in TASKS:
        raise ValueError(f"the scene is of task {scene.task!r}; known are {', '.join(TASKS)}")
    task = TASKS[scene.task]
    task.lay_out(arm, scene)
    limits = Limits(tuple(arm.joint_names), arm.joint_limits[:, 0], arm.joint_limits[:, 1], arm.velocity_limits)
    from_here = np.vstack([np.asarray(scene.start_joints), joints[1:]])
    commands, limited = within_limits(from_here, limits, period_s=1 / rate_hz)
    sensed, positions = [arm.sense()], [arm.end_effector_m]
    for command in commands[1:]:
        arm.move(command, 1 / rate_hz)
        sensed.append(arm.sense())
        positions.append(arm.end_effector_m)
    arm.move(commands[-1], SETTLE_S)
    sensed.append(arm.sense())
    positions.append(arm.end_effector_m)
    judgement = task.judge(arm, scene)
    return Trial(
        frames=np.stack([percept.frame for percept in sensed]),
        joints=np.stack([percept.joints for percept in sensed]),
        end_effector_m=np.stack(positions),
        deviation_m=judgement.deviation_m,
        success=judgement.success,
        scene=scene,
        limited=limited,
    )


def within_limits(joints: Float[np.ndarray, "T J"], limits: Limits, *, period_s: float) -> tuple[Float[np.ndarray, "S J"], tuple[str, ...]]:
    """The commands that follow `joints` within the limits, and a sentence for each limit that changed them.

    A step that would be too fast is shortened and made up for in the steps after it; where the end is not reached in time, steps are
    added (S >= T). The first row is where the arm is.
    """
    allowed = np.clip(joints, limits.lower, limits.upper)
    reach = limits.velocity * period_s
    commands, slowed = [allowed[0]], np.zeros(len(reach), int)
    waiting = list(allowed[1:])
    while waiting or not np.allclose(commands[-1], allowed[-1]):
        wanted = (waiting.pop(0) if waiting else allowed[-1]) - commands[-1]
        slowed += np.abs(wanted) > reach + 1e-9
        commands.append(commands[-1] + np.clip(wanted, -reach, reach))
    kept = (allowed != joints).sum(0)
    sentences = [
        f"{name} kept above {low:g} and below {high:g} rad in {counted(count)}"
        for name, low, high, count in zip(limits.joint_names, limits.lower, limits.upper, kept, strict=True)
        if count
    ] + [
        f"{name} slowed to {velocity:g} rad/s in {counted(count)}"
        for name, velocity, count in zip(limits.joint_names, limits.velocity, slowed, strict=True)
        if count
    ]
    return np.stack(commands), tuple(sentences)


def counted(steps: int) -> str:
    return "1 step" if steps == 1 else f"{steps} steps"
