"""Which joints a model can imagine: those between the least and the greatest that it was shown, a margin beyond (`Sensors`).

>>> sensors = Sensors(16, 16, 1, ("yaw",), (-1.0,), (1.0,))
>>> validate_in_range(Percept(joints=np.array([90.0])), sensors, unit="rad", source="--goal-joints")
Traceback (most recent call last):
ValueError: --goal-joints has yaw at 90: it was demonstrated from -1 to 1 rad; 90 degrees are 1.571 rad
"""

import math
from dataclasses import replace

import numpy as np

from preimage.network.config import Sensors
from preimage.records import Percept

LIMIT_MARGIN = 0.1
"""The range of each joint's code is the range seen in the demonstrations, widened on either side by this share of it."""
FULL_TURN_RAD = 2 * math.pi
"""No joint of an arm turns farther to either side without its cable breaking."""


def validate_in_range(goal: Percept, sensors: Sensors, *, unit: str | None, source: str) -> None:
    """Raises ValueError where a goal asks for a joint outside of what was demonstrated, and so for what cannot be imagined.

    Args:
        unit: of the joints, where it is known.
        source: what to call the goal.
    """
    if goal.joints is None or len(goal.joints) != sensors.num_joints or not np.isfinite(goal.joints).all():
        return  # the planner says what is missing
    for name, angle, low, high in zip(sensors.joint_names, goal.joints, sensors.joint_lower, sensors.joint_upper, strict=True):
        if not low <= angle <= high:
            in_unit = f" {unit}" if unit else ""
            hint = f"; {angle:g} degrees are {math.radians(angle):.4g} rad" if unit in (None, "rad") and abs(angle) > math.pi else ""
            raise ValueError(f"{source} has {name} at {angle:g}: it was demonstrated from {low:.4g} to {high:.4g}{in_unit}{hint}")


def nearest_in_range(goal: Percept, sensors: Sensors) -> Percept:
    """The goal with its joints as near to what is asked for as can be imagined."""
    return goal if goal.joints is None else replace(goal, joints=np.clip(goal.joints, sensors.joint_lower, sensors.joint_upper))
