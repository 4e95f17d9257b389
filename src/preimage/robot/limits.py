"""What a robot may be commanded, and commands that keep to it.

>>> limits = Limits(("yaw",), ("rad",), lower=np.array([-1.0]), upper=np.array([1.0]), velocity=np.array([2.0]))
>>> commands, limited = within_limits(np.array([[0.0], [0.1], [1.2]]), limits, period_s=0.2)
>>> commands[:, 0].round(3).tolist()
[0.0, 0.1, 0.5, 0.9, 1.0]
>>> limited
('yaw kept above -1 and below 1 rad in 1 step', 'yaw slowed to 2 rad/s in 2 steps')
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from preimage.data.joint_range import FULL_TURN_RAD, LIMIT_MARGIN
from preimage.network.config import Sensors
from preimage.records import Plan, Shown, number_of
from preimage.storage.reading import LARGEST_NUMBER, parse_json

UNIT = "units"
"""What the joints' unit is called where it is not known."""
KEYS = ("lower", "upper", "velocity", "step")
MAX_ADDED_STEPS = 10_000
"""Steps that limits may add to a way: more would mean a wrong unit, or a robot that was not meant to move."""


@dataclass(frozen=True, eq=False)
class Limits:
    """What the arm may be commanded, joint by joint."""

    joint_names: tuple[str, ...]
    units: tuple[str, ...]
    """rad or m, or the unit that the data give."""
    lower: Float[np.ndarray, " J"]
    """In units."""
    upper: Float[np.ndarray, " J"]
    """In units."""
    velocity: Float[np.ndarray, " J"]
    """In units a second."""

    def __post_init__(self) -> None:
        if not all(np.isfinite(each).all() for each in (self.lower, self.upper, self.velocity)):
            raise ValueError("limits hold numbers that are not finite: give lower, upper and velocity of every joint")


def limits_seen(sensors: Sensors, shown: Sequence[Shown], *, unit: str | None = None) -> Limits:
    """The limits that the demonstrations imply: the range of each joint as the model codes it, and the fastest step seen.

    The range is the one seen, widened by LIMIT_MARGIN of it. A joint that hardly moved may still cross that share of its range in a second.

    Args:
        unit: of the joints, where it is known.
    """
    lower, upper = np.array(sensors.joint_lower), np.array(sensors.joint_upper)
    fastest = np.max([np.abs(np.diff(one.joints, axis=0)).max(0) * one.rate_hz for one in shown], axis=0)
    velocity = np.maximum(fastest, LIMIT_MARGIN * (upper - lower))
    return Limits(sensors.joint_names, (unit or UNIT,) * sensors.num_joints, lower, upper, velocity)


def read_limits(path: Path, others: Limits, *, rate_hz: float) -> Limits:
    """The limits in a JSON file, `{"elbow": {"lower": -1.5, "upper": 1.5, "velocity": 2.0}, ...}`; what it leaves out stays as in `others`.

    `velocity` is in units a second; `step`, in units, says the same for one step at `rate_hz`.

    Raises:
        ValueError: the file is missing, no such JSON, names another joint, or a limit leaves no room.
    """
    try:
        named = parse_json(path)
    except ValueError as error:
        text = f"{path} is no JSON file that can be read ({error}): give {{joint: {{lower, upper, velocity or step}}}}"
        raise ValueError(text) from error
    if not isinstance(named, dict) or not all(isinstance(each, dict) for each in named.values()):
        raise ValueError(f"{path} holds no limits by joint: give {{joint: {{lower, upper, velocity or step}}}}")
    lower, upper, velocity = others.lower.copy(), others.upper.copy(), others.velocity.copy()
    for name, given in named.items():
        if name not in others.joint_names:
            raise ValueError(f"{path} limits {name}, the plan moves {', '.join(others.joint_names)}")
        for key, value in given.items():
            is_number = isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= LARGEST_NUMBER
            if key not in KEYS or not is_number:
                raise ValueError(f"{path} has {key} {value!r:.40} for {name}: give numbers for {', '.join(KEYS)}")
        joint = others.joint_names.index(name)
        lower[joint], upper[joint] = given.get("lower", lower[joint]), given.get("upper", upper[joint])
        speeds = [given[key] * steps for key, steps in (("velocity", 1.0), ("step", rate_hz)) if key in given]
        velocity[joint] = min(speeds, default=velocity[joint])
        if not (lower[joint] < upper[joint] and velocity[joint] > 0):
            raise ValueError(f"{path} leaves {name} no room: give lower below upper, and a velocity and step above 0")
    limits = Limits(others.joint_names, others.units, lower, upper, velocity)
    _refuse_degrees(path, [others.joint_names.index(name) for name in named], limits, others)
    return limits


def _refuse_degrees(path: Path, given: Sequence[int], limits: Limits, others: Limits) -> None:
    """Raises ValueError where most joints of a file may turn farther than a joint can: limits in degrees, for what was shown in radians."""
    farthest, shown = (np.maximum(-each.lower, each.upper) for each in (limits, others))
    in_degrees = [joint for joint in given if farthest[joint] > FULL_TURN_RAD >= shown[joint] and others.units[joint] in (UNIT, "rad")]
    if len(in_degrees) > len(given) / 2:
        joint = in_degrees[0]
        low, high = f"{limits.lower[joint]:g}", f"{limits.upper[joint]:g}"
        was = f"it was demonstrated from {others.lower[joint]:.4g} to {others.upper[joint]:.4g} {others.units[joint]}"
        hint = f"{farthest[joint]:g} degrees are {np.deg2rad(farthest[joint]):.4g} rad"
        raise ValueError(f"{path} lets {others.joint_names[joint]} go from {low} to {high}, and {was}: {hint}")


def commands_of(plan: Plan, limits: Limits, *, rate_hz: float | None = None) -> tuple[Float[np.ndarray, "S J"], tuple[str, ...]]:
    """What to command so that a robot follows a plan up to its arrival within limits, and a sentence for each limit that changed it.

    Args:
        rate_hz: commands a second; by default the plan's steps. Between two steps the way is straight, at the speed that leads from one to
            the other.

    Raises:
        ValueError: the plan holds a joint that is not finite, or the limits would add too many steps.
    """
    rate_hz = rate_hz or plan.rate_hz
    joints = plan.joints[: plan.arrival_step + 1].copy()
    if plan.start.joints is not None:
        joints[0] = plan.start.joints  # where the robot stands, not where it imagines to stand
    joints = interpolate(joints, plan.rate_hz, rate_hz)
    commands, limited = within_limits(joints, limits, period_s=1 / rate_hz)
    if added := len(commands) - len(joints):
        limited = *limited, f"the limits add {number_of(added, 'step')} ({added / rate_hz:.1f} s) to {number_of(len(joints), 'step')}"
    return commands, limited


def interpolate(joints: Float[np.ndarray, "T J"], rate_hz: float, new_rate_hz: float) -> Float[np.ndarray, "S J"]:
    """The same way at another rate: straight from each step to the next, and the last one always among the rows.

    >>> interpolate(np.array([[0.0], [1.0], [1.0]]), 2.5, 5.0)[:, 0].tolist()
    [0.0, 0.5, 1.0, 1.0, 1.0]
    """
    if new_rate_hz == rate_hz:
        return joints
    last = len(joints) - 1
    rows = np.arange(int(np.ceil(last * new_rate_hz / rate_hz - 1e-9)) + 1)
    steps = np.minimum(rows * rate_hz / new_rate_hz, last)
    return np.stack([np.interp(steps, np.arange(last + 1), way) for way in joints.T], axis=-1)


def within_limits(joints: Float[np.ndarray, "T J"], limits: Limits, *, period_s: float) -> tuple[Float[np.ndarray, "S J"], tuple[str, ...]]:
    """The commands that follow `joints` within the limits, and a sentence for each limit that changed them.

    A step that would be too fast is shortened and made up for in the steps after it; where the end is not reached in time, steps are
    added (S >= T). The first row is where the arm is, also where that is outside the limits: from there it comes in at limited speed.

    Raises:
        ValueError: a joint is not finite, or more than MAX_ADDED_STEPS would have to be added.
    """
    if not np.isfinite(joints).all():
        step, joint = np.argwhere(~np.isfinite(joints))[0]
        raise ValueError(f"{limits.joint_names[joint]} is {joints[step, joint]} at step {step}: a robot is commanded finite joints only")
    limiter = Limiter(limits, joints[0], period_s)
    commands = [limiter.command]
    for wanted in joints[1:]:
        commands.append(limiter.follow(wanted))
    limiter.validate_added_steps()
    while not limiter.has_arrived:
        commands.append(limiter.catch_up())
    return np.stack(commands), limiter.sentences()


class Limiter:
    """Follows the joints that are wanted, one step at a time, as well as the limits allow, and counts where they did not."""

    def __init__(self, limits: Limits, start: Float[np.ndarray, " J"], period_s: float) -> None:
        self._limits, self._start = limits, start
        self._reach = limits.velocity * period_s
        self._num_kept, self._num_slowed = np.zeros((2, len(self._reach)), int)
        self.command = start
        self._wanted = np.clip(start, limits.lower, limits.upper)

    @property
    def has_arrived(self) -> bool:
        """Whether the last command is what was wanted, as far as it is allowed."""
        return np.allclose(self.command, self._wanted)

    def follow(self, wanted: Float[np.ndarray, " J"]) -> Float[np.ndarray, " J"]:
        """The next command towards new wanted joints."""
        self._wanted = self._allowed(wanted)
        return self.catch_up()

    def catch_up(self) -> Float[np.ndarray, " J"]:
        """The next command towards the joints that were wanted last."""
        missing = self._wanted - self.command
        self._num_slowed += np.abs(missing) > self._reach + 1e-9
        self.command = self.command + np.clip(missing, -self._reach, self._reach)
        return self.command

    def validate_added_steps(self) -> None:
        """Raises ValueError where it takes too many steps from the last command to the joints that were wanted last."""
        with np.errstate(divide="ignore", over="ignore"):
            num_steps = np.abs(self._wanted - self.command) / self._reach
        slowest = int(np.argmax(num_steps))
        if num_steps[slowest] > MAX_ADDED_STEPS:
            name, unit, velocity = (each[slowest] for each in (self._limits.joint_names, self._limits.units, self._limits.velocity))
            needed = f"{name} would need {num_steps[slowest]:.3g} more steps at {velocity:g} {unit}/s"
            raise ValueError(f"{needed}, and at most {MAX_ADDED_STEPS} are added: give it a higher velocity")

    def sentences(self) -> tuple[str, ...]:
        """A sentence for each limit that changed a command, and for each joint that began outside of them."""
        limits, outside, kept, slowed = self._limits, [], [], []
        numbers = limits.lower, limits.upper, limits.velocity, self._start, self._num_kept.tolist(), self._num_slowed.tolist()
        for name, unit, low, high, velocity, start, num_kept, num_slowed in zip(limits.joint_names, limits.units, *numbers, strict=True):
            if not low <= start <= high:
                way_in = f"from where it comes in at {velocity:g} {unit}/s or slower"
                outside.append(f"{name} stands at {start:g} {unit}, outside {low:g} to {high:g}, {way_in}")
            if num_kept:
                kept.append(f"{name} kept above {low:g} and below {high:g} {unit} in {number_of(num_kept, 'step')}")
            if num_slowed:
                slowed.append(f"{name} slowed to {velocity:g} {unit}/s in {number_of(num_slowed, 'step')}")
        return *outside, *kept, *slowed

    def _allowed(self, wanted: Float[np.ndarray, " J"]) -> Float[np.ndarray, " J"]:
        allowed = np.clip(wanted, self._limits.lower, self._limits.upper)
        self._num_kept += allowed != wanted
        return allowed
