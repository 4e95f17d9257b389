"""What goes wrong while a plan is carried out, each drawn from a seed, so that every loop meets the same.

push     the hand is pushed 10 cm aside half way within 0.2 s, and held there for as long
bias     the encoder of one joint reads 0.05 rad too much or too little, and the motor believes it
goal     half way another goal is wanted: the loop is told, and the judge judges by it
object   the object is moved by 5 cm half way to the grasp
camera   one frame in five does not come
late     frames come 200 ms late
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from preimage.records import Percept, Scene
from preimage.robot.arm import OBJECT, Arm
from preimage.robot.execution import Stage
from preimage.robot.kinematics import ACTIVE_JOINTS, BASE_M, forward_kinematics

DISTURBANCES = ("push", "bias", "goal", "object", "camera", "late")

PUSH_M, PUSH_S = 0.1, 0.2
"""How far the hand is pushed (m), and how long that takes (s)."""
BIAS_RAD = 0.05
"""What an encoder is off (rad): three times what a good plan is."""
OBJECT_M = 0.05
"""How far the object is moved (m): its own width, and twice what a grasp allows."""
MISSING = 0.2
"""Share of the frames that do not come."""
LATE_S = 0.2
"""How late a frame is (s): that of a slow camera with its transport."""
MOST_STEPS = 1000
"""Steps for which missing frames are drawn; then it begins anew."""


def unchanged(joints: Float[np.ndarray, " J"]) -> Float[np.ndarray, " J"]:
    return joints


def as_it_is(percept: Percept, step: int) -> Percept:
    return percept


def nothing(arm: Arm, stage: Stage, step: int) -> None:
    pass


@dataclass(frozen=True)
class Disturbance:
    """What stands between a loop and the arm; by default nothing."""

    commanded: Callable[[Float[np.ndarray, " J"]], Float[np.ndarray, " J"]] = unchanged
    """From what is commanded to where the motors go."""
    sensed: Callable[[Percept, int], Percept] = as_it_is
    """From what camera and encoders would give, and the step, to what they give."""
    happens: Callable[[Arm, Stage, int], None] = nothing
    """What happens after each command, of which so many were given."""
    frames_late_s: float = 0.0
    """How old a frame is when it comes (s)."""


def disturbance_of(kind: str, scene: Scene, *, half: int, grasp: int, seed: Sequence[int], other: Scene | None = None) -> Disturbance:
    """A disturbance of a trial in a scene.

    Args:
        half: the step at which half of the way is behind the arm.
        grasp: the step at which half of the way to the grasp is, for `object`.
        seed: draws sides, joints and frames.
        other: the scene whose goal is wanted from half way on, for `goal`.

    Raises:
        ValueError: there is no such disturbance, or nothing of the kind can happen in this scene.
    """
    rng = np.random.default_rng(seed)
    if kind == "push":
        return Disturbance(happens=pushed(step=half, side=rng.choice((-1, 1))))
    if kind == "bias":
        offset = np.zeros(len(scene.start_joints))
        offset[rng.integers(len(ACTIVE_JOINTS))] = BIAS_RAD * rng.choice((-1, 1))
        return Disturbance(lambda joints: joints - offset, biased(offset))
    if kind == "object":
        if OBJECT not in scene.positions_m:
            raise ValueError(f"--disturb object moves an object, and {scene.task} has none: take move-object")
        angle = rng.uniform(0, 2 * np.pi)
        return Disturbance(happens=object_moved(step=grasp, by_m=OBJECT_M * np.array([np.cos(angle), np.sin(angle)])))
    if kind == "camera":
        lost = rng.random(MOST_STEPS) < MISSING
        lost[0] = False  # a plan begins with a frame
        return Disturbance(sensed=lambda percept, step: replace(percept, frame=None) if lost[step % MOST_STEPS] else percept)
    if kind == "late":
        return Disturbance(frames_late_s=LATE_S)
    if kind == "goal":
        if set(scene.positions_m) != {"goal"}:
            raise ValueError(f"--disturb goal asks for another place to reach, and {scene.task} has none: take reach")
        assert other is not None
        return Disturbance(happens=goal_changed(step=half, to_m=other.positions_m["goal"]))
    raise ValueError(f"--disturb is {kind}: give {', '.join(DISTURBANCES)}")


def biased(offset: Float[np.ndarray, " J"]) -> Callable[[Percept, int], Percept]:
    """Joints read so much too far."""

    def sensed(percept: Percept, step: int) -> Percept:
        return replace(percept, joints=None if percept.joints is None else percept.joints + offset)

    return sensed


def pushed(*, step: int, side: int) -> Callable[[Arm, Stage, int], None]:
    """At a step the hand is led aside, about the foot of the arm, as by someone who is stronger than the motors."""

    def happens(arm: Arm, stage: Stage, now: int) -> None:
        if now != step:
            return
        joints = stage.true_joints.copy()
        radius_m = float(np.linalg.norm((forward_kinematics(joints[: len(ACTIVE_JOINTS)]) - BASE_M)[:2]))
        joints[0] += side * 2 * np.arcsin(min(1.0, PUSH_M / 2 / radius_m))
        lead(arm, stage, joints)

    return happens


def lead(arm: Arm, stage: Stage, joints: Float[np.ndarray, " J"]) -> None:
    """The hand is led to joints, as far as they go, and held there."""
    allowed = np.clip(joints, *arm.joint_limits.T)
    stage.disturb(lambda: [arm.move(allowed, PUSH_S) for _ in range(2)])  # there, and held there, for a motor lags behind


def object_moved(*, step: int, by_m: Float[np.ndarray, " 2"]) -> Callable[[Arm, Stage, int], None]:
    """At a step the object stands elsewhere; the judge takes that for its place."""

    def happens(arm: Arm, stage: Stage, now: int) -> None:
        if now == step:
            shift_object(arm, stage, by_m)

    return happens


def shift_object(arm: Arm, stage: Stage, by_m: Float[np.ndarray, " 2"]) -> None:
    """The object stands so far from where it did (m), for arm and judge."""
    stage.disturb(lambda: arm.shift_object(by_m))
    x, y, z = stage.scene.positions_m[OBJECT]
    moved = {**stage.scene.positions_m, OBJECT: (x + float(by_m[0]), y + float(by_m[1]), z)}
    stage.scene = replace(stage.scene, positions_m=moved)


def goal_changed(*, step: int, to_m: Sequence[float]) -> Callable[[Arm, Stage, int], None]:
    """From a step on the judge judges by another goal."""

    def happens(arm: Arm, stage: Stage, now: int) -> None:
        if now == step:
            change_goal(stage, to_m)

    return happens


def change_goal(stage: Stage, to_m: Sequence[float]) -> None:
    """The judge judges by another goal (m)."""
    stage.scene = replace(stage.scene, positions_m={**stage.scene.positions_m, "goal": tuple(to_m)})
