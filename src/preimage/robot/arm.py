"""The simulated arm: put it somewhere, move it, sense it.

>>> arm = Arm()
>>> arm.reset(arm.home)
>>> arm.move(arm.home + 0.05, seconds=0.1)
>>> percept = arm.sense()
>>> percept.frame.shape, percept.joints.shape, arm.end_effector_m.shape
((64, 64, 1), (4,), (3,))

What stands around it decides how many joints it moves:

>>> arm.set_up(Workspace(table_size_m=1.0, circles=("circle",), has_object=True, has_gripper=True))
>>> arm.joint_names
('joint1', 'joint2', 'joint4', 'joint6', 'gripper')
>>> arm.reset(arm.home, {"circle": (0.4, 0.2, 0.0), "object": (0.4, -0.2, 0.05)})
>>> arm.ground_truth().object_m
array([ 0.4 , -0.2 ,  0.05])
"""

# pyright: reportAttributeAccessIssue=false
# mujoco ships no stubs for its compiled names.

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources

import mujoco
import numpy as np
from jaxtyping import Float, UInt8

from preimage.records import Percept
from preimage.robot.camera import Camera, Renderer
from preimage.robot.kinematics import (
    ACTIVE_JOINTS,
    HELD_JOINTS,
    HOME_M,
    JOINT_LIMITS,
    VELOCITY_LIMITS,
    forward_kinematics,
    grasping_joints,
    home_joints,
)

GRIPPER = "gripper"
"""Name of the fifth joint: how far each finger stands from the middle of the hand (m)."""
FINGERS = ("left_finger", "right_finger")
GRIPPER_OPEN_M = 0.04
"""Largest half-opening (m), as published for the Franka hand."""
GRIPPER_SPEED = 0.1
"""Largest speed of each finger (m/s): fully open to closed in one step of 0.4 s. The Franka hand itself takes twice as long."""

CIRCLE_RADIUS_M = 0.06
CIRCLE_HALF_HEIGHT_M = 0.0005
OBJECT = "object"
OBJECT_RADIUS_M, OBJECT_HEIGHT_M = 0.025, 0.1
OBJECT_KG = 0.08
"""A hollow plastic cylinder."""
OBJECT_GREY = 0.05
"""Dark on every side; a light object would show its unlit side in the grey of the table."""


@dataclass(frozen=True)
class Workspace:
    """What stands around the arm, and which hand the arm has."""

    table_size_m: float = 0.74
    """Side of the square table, whose near edge is x = 0 (m)."""
    camera: Camera = field(default_factory=Camera)
    circles: tuple[str, ...] = ()
    """Names of the filled circles that lie on the table, alike in look."""
    circle_grey: float = 0.97
    """How light the circles are, from 0 to 1."""
    has_object: bool = False
    """Whether the cylinder named "object" stands on the table, free to be moved."""
    has_gripper: bool = False
    """Whether the fingers can open; otherwise they stay closed."""

    @property
    def things(self) -> tuple[str, ...]:
        """Names of what `Arm.reset` puts in its place."""
        return self.circles + ((OBJECT,) if self.has_object else ())


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """The true state at one moment. The judge of a task sees it; camera and encoders do not."""

    end_effector_m: Float[np.ndarray, " 3"]
    """The point between the finger tips (m)."""
    commanded_m: Float[np.ndarray, " 3"]
    """Where that point would be if the arm stood at its set points: it is there unless something is in its way (m)."""
    gripper_m: float = 0.0
    """Commanded half-opening (m); 0 where the fingers cannot open."""
    object_m: Float[np.ndarray, " 3"] | None = None
    """Centre of the object, where there is one (m)."""
    object_uprightness: float | None = None
    """Cosine of the angle between the object's axis and the vertical: 1 for an object that stands."""


class Arm:
    """A position-controlled arm at its table, seen by a fixed camera."""

    def __init__(self) -> None:
        self._build(Workspace())
        self.reset(self.home)

    @property
    def joint_names(self) -> tuple[str, ...]:
        return ACTIVE_JOINTS + ((GRIPPER,) if self._has_gripper else ())

    @property
    def joint_units(self) -> tuple[str, ...]:
        """The unit of each joint: rad, and m for the gripper."""
        return tuple("m" if name == GRIPPER else "rad" for name in self.joint_names)

    @property
    def joint_unit(self) -> str | None:
        """The unit that all joints share; None where a gripper is among them."""
        units = set(self.joint_units)
        return units.pop() if len(units) == 1 else None

    @property
    def joint_limits(self) -> Float[np.ndarray, "J 2"]:
        """Smallest and largest value of each joint (rad; gripper: m)."""
        return np.vstack([JOINT_LIMITS, (0.0, GRIPPER_OPEN_M)]) if self._has_gripper else JOINT_LIMITS.copy()

    @property
    def velocity_limits(self) -> Float[np.ndarray, " J"]:
        """Largest speed of each joint (rad/s; gripper: m/s)."""
        return np.append(VELOCITY_LIMITS, GRIPPER_SPEED) if self._has_gripper else VELOCITY_LIMITS.copy()

    @property
    def home(self) -> Float[np.ndarray, " J"]:
        """The joints in which the arm waits before a task (rad; gripper: m): with fingers that open, tilted as for a grasp, and open."""
        return np.append(grasping_joints(HOME_M), GRIPPER_OPEN_M) if self._has_gripper else home_joints()

    @property
    def end_effector_m(self) -> Float[np.ndarray, " 3"]:
        """The point between the finger tips, in the frame of the table (m)."""
        return self._data.site("end_effector").xpos.copy()

    def set_up(self, workspace: Workspace) -> None:
        """The arm stands at home in this workspace; where it does already, nothing changes."""
        if workspace != self._workspace:
            self._build(workspace)
            self.reset(self.home)

    def reset(
        self,
        joints: Sequence[float] | Float[np.ndarray, " J"],
        positions_m: Mapping[str, Sequence[float]] | None = None,
    ) -> None:
        """The arm is at rest at these joints (rad; gripper: m), with no trace of what it did before.

        Args:
            positions_m: where the centres of the objects of the workspace are now (m); what is not named is at the origin.
        """
        joints = self._checked(joints)
        mujoco.mj_resetData(self._model, self._data)
        for name, angle in {**HELD_JOINTS, **dict(zip(self.joint_names, joints, strict=True))}.items():
            for moved in FINGERS if name == GRIPPER else (name,):
                self._data.joint(moved).qpos[:] = angle
            self._data.actuator(name).ctrl[:] = angle
        for name, position_m in (positions_m or {}).items():
            self._place(name, position_m)
        mujoco.mj_forward(self._model, self._data)

    def move(self, joints: Sequence[float] | Float[np.ndarray, " J"], seconds: float) -> None:
        """The set points have gone in a straight line to these joints (rad; gripper: m) in the given time; the arm followed."""
        joints = self._checked(joints)
        num_steps = round(seconds / self._model.opt.timestep)
        if num_steps < 1:
            raise ValueError(f"seconds is {seconds}: a move takes at least {self._model.opt.timestep} s")
        before = self._data.ctrl[self._actuators].copy()
        for step in range(1, num_steps + 1):
            self._data.ctrl[self._actuators] = before + (joints - before) * (step / num_steps)
            mujoco.mj_step(self._model, self._data)
        mujoco.mj_kinematics(self._model, self._data)  # mj_step leaves the bodies where they were one step ago

    def shift_object(self, by_m: Sequence[float] | Float[np.ndarray, " 2"]) -> None:
        """The object stands, at rest, so far from where it was (m)."""
        self._data.joint(OBJECT).qpos[:2] += by_m
        self._data.joint(OBJECT).qvel[:] = 0
        mujoco.mj_forward(self._model, self._data)

    def sense(self) -> Percept:
        """What camera and joint encoders sense now."""
        return Percept(self._renderer.frame(self._data), self.feel())

    def feel(self) -> Float[np.ndarray, " J"]:
        """What the joint encoders sense now (rad; gripper: m), without a look through the camera, which takes most of the time.

        The gripper is sensed as it was commanded. Fingers that hold the object stand at its width while the command is 0: a plan made of
        what the fingers measured would command that width, and drop the object.
        """
        sensed = self._data.ctrl[self._actuators].copy()
        sensed[: len(ACTIVE_JOINTS)] = self._data.qpos[self._positions]
        return sensed

    def seen_by(self, camera: Camera) -> UInt8[np.ndarray, "H W 1"]:
        """What another camera than the robot's own sees now."""
        if camera not in self._others:
            self._others[camera] = Renderer(camera, self._model)
        return self._others[camera].frame(self._data)

    def ground_truth(self) -> GroundTruth:
        """The true state of the hand and the object now."""
        commands = self._data.ctrl[self._actuators]
        commanded_m = forward_kinematics(commands[: len(ACTIVE_JOINTS)])
        gripper_m = float(commands[-1]) if self._has_gripper else 0.0
        if not self._workspace.has_object:
            return GroundTruth(self.end_effector_m, commanded_m, gripper_m)
        thing = self._data.body(OBJECT)
        return GroundTruth(self.end_effector_m, commanded_m, gripper_m, thing.xpos.copy(), float(thing.xmat[8]))

    @property
    def _has_gripper(self) -> bool:
        return self._workspace.has_gripper

    def _build(self, workspace: Workspace) -> None:
        self._workspace = workspace
        self._model = _compile(workspace)
        self._data = mujoco.MjData(self._model)
        self._renderer, self._others = Renderer(workspace.camera, self._model), {}
        self._positions = [self._model.joint(name).qposadr[0] for name in ACTIVE_JOINTS]
        self._actuators = [self._model.actuator(name).id for name in self.joint_names]

    def _place(self, name: str, position_m: Sequence[float]) -> None:
        if name not in self._workspace.things:
            raise ValueError(f"positions_m places {name!r}; on the table are {', '.join(self._workspace.things) or 'no things'}")
        if name == OBJECT:
            self._data.joint(OBJECT).qpos[:3] = position_m
        else:
            self._data.mocap_pos[self._model.body(name).mocapid[0]] = position_m

    def _checked(self, joints: Sequence[float] | Float[np.ndarray, " J"]) -> Float[np.ndarray, " J"]:
        """The joints as an array, or a ValueError that says what is wrong with them."""
        array = np.asarray(joints, dtype=np.float64)
        if array.shape != (len(self.joint_names),):
            given = f"{array.size} angles" if array.ndim == 1 else f"shape {array.shape}"
            names = ", ".join(self.joint_names)
            raise ValueError(f"joints has {given}, the arm has {len(self.joint_names)} joints ({names})")
        if not np.isfinite(array).all():
            name = self.joint_names[int(np.argmin(np.isfinite(array)))]
            raise ValueError(f"joints holds a value that is not finite at {name}: give every angle in radians")
        return array


def _compile(workspace: Workspace) -> mujoco.MjModel:
    """The model of arm.xml with its hand, in its workspace."""
    spec = mujoco.MjSpec.from_string(resources.files("preimage.robot").joinpath("arm.xml").read_text(encoding="utf-8"))
    half_m = workspace.table_size_m / 2
    table = spec.geom("table")
    table.pos[0] = half_m
    table.size[:2] = half_m
    _choose_hand(spec, workspace.has_gripper)
    for name in workspace.circles:
        _add_circle(spec, name, workspace.circle_grey)
    if workspace.has_object:
        _add_object(spec)
    return spec.compile()


def _choose_hand(spec: mujoco.MjSpec, has_gripper: bool) -> None:
    """Of the two hands that arm.xml describes, one stays."""
    if has_gripper:
        spec.delete(spec.geom("closed_fingers"))
        return
    spec.delete(spec.actuator(GRIPPER))
    spec.delete(spec.equality("fingers_alike"))
    spec.delete(spec.tendon(GRIPPER))
    for name in FINGERS:
        spec.delete(spec.body(name))


def _add_circle(spec: mujoco.MjSpec, name: str, grey: float) -> None:
    """A filled circle that lies on the table and touches nothing: a "mocap" body, whose place is part of the state."""
    body = spec.worldbody.add_body(name=name, mocap=True)
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=[CIRCLE_RADIUS_M, CIRCLE_HALF_HEIGHT_M, 0],
        pos=[0, 0, CIRCLE_HALF_HEIGHT_M],
        rgba=[grey] * 3 + [1],
        contype=0,
        conaffinity=0,
    )


def _add_object(spec: mujoco.MjSpec) -> None:
    """A cylinder that stands on the table, free to be moved; it touches the table and the solid parts of the arm."""
    body = spec.worldbody.add_body(name=OBJECT)
    body.add_freejoint(name=OBJECT)
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=[OBJECT_RADIUS_M, OBJECT_HEIGHT_M / 2, 0],
        rgba=[OBJECT_GREY] * 3 + [1],
        mass=OBJECT_KG,
        contype=1,
        conaffinity=1,
    )
