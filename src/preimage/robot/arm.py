"""The simulated arm: put it somewhere, move it, sense it.

>>> arm = Arm()
>>> arm.reset(arm.home)
>>> arm.move(arm.home + 0.05, seconds=0.1)
>>> percept = arm.sense()
>>> percept.frame.shape, percept.joints.shape, arm.end_effector_m.shape
((64, 64, 1), (4,), (3,))
"""

# pyright: reportAttributeAccessIssue=false
# mujoco ships no stubs for its compiled names.

from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib import resources

import mujoco
import numpy as np
from jaxtyping import Float

from preimage.records import Percept
from preimage.robot.camera import Camera, Renderer
from preimage.robot.kinematics import ACTIVE_JOINTS, HELD_JOINTS, JOINT_LIMITS, VELOCITY_LIMITS, home_joints


@dataclass(frozen=True)
class Furniture:
    """What stands around the arm."""

    table_size_m: float = 0.74
    """Side of the square table, whose near edge is x = 0 (m)."""
    camera: Camera = field(default_factory=Camera)


class Arm:
    """A position-controlled arm at its table, seen by a fixed camera."""

    def __init__(self) -> None:
        self._build(Furniture())
        self.reset(self.home)

    @property
    def joint_names(self) -> tuple[str, ...]:
        return ACTIVE_JOINTS

    @property
    def joint_limits(self) -> Float[np.ndarray, "J 2"]:
        """Smallest and largest angle of each joint (rad)."""
        return JOINT_LIMITS.copy()

    @property
    def velocity_limits(self) -> Float[np.ndarray, " J"]:
        """Largest speed of each joint (rad/s)."""
        return VELOCITY_LIMITS.copy()

    @property
    def home(self) -> Float[np.ndarray, " J"]:
        """The joint angles in which the arm waits before a task (rad)."""
        return home_joints()

    @property
    def end_effector_m(self) -> Float[np.ndarray, " 3"]:
        """The point between the finger tips, in the frame of the table (m)."""
        return self._data.site("end_effector").xpos.copy()

    def furnish(self, furniture: Furniture) -> None:
        """The arm stands, at home, among this furniture; nothing happens if it does already."""
        if furniture != self._furniture:
            self._build(furniture)
            self.reset(self.home)

    def reset(self, joints: Sequence[float] | Float[np.ndarray, " J"]) -> None:
        """The arm is at rest at these joint angles (rad), and nothing is left of what it did before."""
        joints = self._checked(joints)
        mujoco.mj_resetData(self._model, self._data)
        for name, angle in {**HELD_JOINTS, **dict(zip(self.joint_names, joints, strict=True))}.items():
            self._data.joint(name).qpos[:] = angle
            self._data.actuator(name).ctrl[:] = angle
        mujoco.mj_forward(self._model, self._data)

    def move(self, joints: Sequence[float] | Float[np.ndarray, " J"], seconds: float) -> None:
        """The set points have gone in a straight line to these joint angles (rad) in the given time; the arm followed."""
        joints = self._checked(joints)
        num_steps = round(seconds / self._model.opt.timestep)
        if num_steps < 1:
            raise ValueError(f"seconds is {seconds}: a move takes at least {self._model.opt.timestep} s")
        before = self._data.ctrl[self._actuators].copy()
        for step in range(1, num_steps + 1):
            self._data.ctrl[self._actuators] = before + (joints - before) * (step / num_steps)
            mujoco.mj_step(self._model, self._data)
        mujoco.mj_kinematics(self._model, self._data)  # mj_step leaves the bodies where they were one step ago

    def sense(self) -> Percept:
        """What camera and joint encoders tell now."""
        return Percept(self._renderer.frame(self._data), self._data.qpos[self._positions].copy())

    def _build(self, furniture: Furniture) -> None:
        self._furniture = furniture
        self._model = _compile(furniture)
        self._data = mujoco.MjData(self._model)
        self._renderer = Renderer(furniture.camera, self._model)
        self._positions = [self._model.joint(name).qposadr[0] for name in self.joint_names]
        self._actuators = [self._model.actuator(name).id for name in self.joint_names]

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


def _compile(furniture: Furniture) -> mujoco.MjModel:
    """The model of arm.xml with its furniture in place."""
    spec = mujoco.MjSpec.from_string(resources.files("preimage.robot").joinpath("arm.xml").read_text(encoding="utf-8"))
    half_m = furniture.table_size_m / 2
    table = spec.geom("table")
    table.pos[0] = half_m
    table.size[:2] = half_m
    return spec.compile()
