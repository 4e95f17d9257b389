"""The second of the paper's two phases: the robot replays what the hand showed and records what it senses.

>>> from preimage.robot.tasks import Reach
>>> demonstrations = record(Arm(), Reach(), count=1, seed=0)
>>> demonstrations[0].frames.shape[1:], demonstrations[0].scene.task
((64, 64, 1), 'reach')
"""

from collections.abc import Callable

import numpy as np

from preimage.records import Demonstration, Percept, Scene
from preimage.robot.arm import Arm
from preimage.robot.tasks import Task


def record(arm: Arm, task: Task, *, count: int, seed: int, progress: Callable[[int, int], None] | None = None) -> list[Demonstration]:
    """New demonstrations of a task, each in a scene of its own.

    A demonstration depends on the seed and on its place in the list alone: the first ten are the same for every count.

    Args:
        count: how many, 1 or more.
        seed: 0 or more; other seeds give other demonstrations.
        progress: called after each demonstration with the number done and the count.

    Raises:
        ValueError: count or seed is too small.
    """
    if count < 1:
        raise ValueError(f"count is {count}: record 1 demonstration or more")
    if seed < 0:
        raise ValueError(f"seed is {seed}: give a whole number from 0 on")
    demonstrations = []
    for index in range(count):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))
        demonstrations.append(show(arm, task, task.sample(rng), rng))
        if progress is not None:
            progress(index + 1, count)
    return demonstrations


def show(arm: Arm, task: Task, scene: Scene, rng: np.random.Generator) -> Demonstration:
    """One demonstration in a scene: a hand shows the way, then the robot goes it alone and records."""
    path = task.hand_path(rng, scene)
    task.lay_out(arm, scene)
    percepts = [arm.sense()]
    for joints in path[1:]:
        arm.move(joints, seconds=1 / task.rate_hz)
        percepts.append(arm.sense())
    return _demonstration(arm, task, scene, percepts)


def _demonstration(arm: Arm, task: Task, scene: Scene, percepts: list[Percept]) -> Demonstration:
    return Demonstration(
        frames=np.array([percept.frame for percept in percepts]),
        joints=np.array([percept.joints for percept in percepts]),
        rate_hz=task.rate_hz,
        joint_names=arm.joint_names,
        scene=scene,
    )
