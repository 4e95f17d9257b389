"""The tasks by name: what the command line, the data sets and the scenes call them.

>>> sorted(TASKS)
['move-object', 'reach', 'two-circles', 'two-points']
"""

from preimage.robot.move_object import MoveObject
from preimage.robot.reach import Reach
from preimage.robot.task import Task
from preimage.robot.two_points import ReachTwo

TASKS: dict[str, Task] = {task.name: task for task in (Reach(), ReachTwo(), MoveObject(), MoveObject.with_two_circles())}
"""The tasks by name, seen in frames of 64 x 64."""
