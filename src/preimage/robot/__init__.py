"""The simulated robot: an arm with a camera, tasks for it, and a tutor who demonstrates them."""

from preimage.robot.arm import Arm, Furniture
from preimage.robot.camera import Camera
from preimage.robot.kinematics import forward_kinematics, inverse_kinematics
from preimage.robot.tasks import TASKS, Judgement, Reach, Task
from preimage.robot.tutor import record, show

__all__ = [
    "TASKS",
    "Arm",
    "Camera",
    "Furniture",
    "Judgement",
    "Reach",
    "Task",
    "forward_kinematics",
    "inverse_kinematics",
    "record",
    "show",
]
