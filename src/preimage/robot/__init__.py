"""The simulated robot: an arm with a camera, tasks for it, and a demonstrator for them."""

from preimage.robot.arm import Arm, GroundTruth, Workspace
from preimage.robot.camera import Camera
from preimage.robot.demonstrator import record, show
from preimage.robot.kinematics import forward_kinematics, inverse_kinematics
from preimage.robot.move_object import MoveObject, succeeds_within
from preimage.robot.reach import Reach
from preimage.robot.task import Judgement, Task, with_frames
from preimage.robot.tasks import TASKS
from preimage.robot.two_points import ReachTwo

__all__ = [
    "TASKS",
    "Arm",
    "Camera",
    "GroundTruth",
    "Judgement",
    "MoveObject",
    "Reach",
    "ReachTwo",
    "Task",
    "Workspace",
    "forward_kinematics",
    "inverse_kinematics",
    "record",
    "show",
    "succeeds_within",
    "with_frames",
]
