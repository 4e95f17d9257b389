"""The second of the paper's two phases: the robot replays the demonstrator's motion and records what it senses.

>>> from preimage.robot.reach import Reach
>>> demonstrations = record(Arm(), Reach(), count=1, seed=0)
>>> demonstrations[0].frames.shape[1:], demonstrations[0].scene.task
((64, 64, 1), 'reach')
"""

from collections.abc import Callable

import numpy as np

from preimage.records import Demonstration, Percept, Scene
from preimage.robot.arm import Arm, GroundTruth
from preimage.robot.task import Task

MAX_TRIES = 100
"""Scenes tried for one demonstration before the task is taken to be beyond the demonstrator."""


def record(arm: Arm, task: Task, *, count: int, seed: int, progress: Callable[[int, int], None] | None = None) -> list[Demonstration]:
    """New demonstrations of a task, each in a scene of its own, each a success.

    A demonstration depends on the seed and on its place in the list alone: the first ten are the same for every count. Where the robot
    does not succeed, another scene and another way are drawn for the same place.

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
        demonstrations.append(_show_until_solved(arm, task, rng))
        if progress is not None:
            progress(index + 1, count)
    return demonstrations


def show(arm: Arm, task: Task, scene: Scene, rng: np.random.Generator) -> Demonstration:
    """One demonstration in a scene, solved or not: the demonstrator guides the arm, then the robot replays the motion alone and records."""
    return _replay(arm, task, scene, rng)[0]


def _show_until_solved(arm: Arm, task: Task, rng: np.random.Generator) -> Demonstration:
    """The first demonstration, each in a new scene, that the task's judge calls a success."""
    for _ in range(MAX_TRIES):
        scene = task.sample(rng)
        demonstration, course = _replay(arm, task, scene, rng)
        if task.judge(scene, course).success:
            return demonstration
    raise ValueError(f"no demonstration of {task.name} succeeded in {MAX_TRIES} scenes")


def _replay(arm: Arm, task: Task, scene: Scene, rng: np.random.Generator) -> tuple[Demonstration, list[GroundTruth]]:
    """What the robot sensed along the demonstrated path, and what the judge saw of it."""
    path = task.demonstration_path(rng, scene)
    task.lay_out(arm, scene)
    percepts, course = [arm.sense()], [arm.ground_truth()]
    for joints in path[1:]:
        arm.move(joints, seconds=1 / task.rate_hz)
        percepts.append(arm.sense())
        course.append(arm.ground_truth())
    return _demonstration(arm, task, scene, percepts), course


def _demonstration(arm: Arm, task: Task, scene: Scene, percepts: list[Percept]) -> Demonstration:
    return Demonstration(
        frames=np.array([percept.frame for percept in percepts]),
        joints=np.array([percept.joints for percept in percepts]),
        rate_hz=task.rate_hz,
        joint_names=arm.joint_names,
        scene=scene,
    )
