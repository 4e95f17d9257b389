"""What is said of a data set: a summary of what was read, and sentences that `check` and `train` share."""

from collections.abc import Collection, Iterator, Sequence

from preimage.data.angles import Wrap
from preimage.data.clocks import is_clock
from preimage.data.questions import naming
from preimage.data.view import View
from preimage.records import Demonstration, Description, listed, number_of


def summary(
    demonstrations: Sequence[Demonstration],
    numbers: Sequence[int],
    description: Description,
    view: View,
    *,
    chosen: bool,
    empty: Collection[str],
) -> Iterator[str]:
    """What was read, line by line: episodes, camera, joints and why some are left out.

    Args:
        numbers: of the episodes.
        view: how they were looked at, resolved.
        chosen: the user has named the joints.
        empty: columns of which nothing was recorded.
    """
    assert view.recorded and view.size  # noqa: PT018
    assert view.joints
    steps, rate_hz = sum(map(len, demonstrations)), description.rate_hz
    yield f"{description.version}: {number_of(len(demonstrations), 'episode')}, {number_of(steps, 'step')} at {rate_hz:g} Hz"
    if (len(numbers), numbers[-1] + 1) != (description.num_episodes, description.num_episodes):
        yield f"episode{'' if len(numbers) == 1 else 's'} {listed(numbers)}; the data set counts {description.num_episodes}"
    yield camera_line(demonstrations, description, view)
    left_out = [name for name in description.joint_names if name not in view.joints]
    if not left_out:
        yield f"{number_of(len(view.joints), 'joint')}: {', '.join(view.joints)}"
        return
    number = f"{len(view.joints)} of {number_of(len(description.joint_names), 'joint')}: {', '.join(view.joints)}"
    clocks, still = ([name for name in left_out if is_clock(name) is clock and name not in empty] for clock in (True, False))
    if chosen:
        yield f"{number}; left out: {', '.join(left_out)}"
        return
    why = f"; left out, for {'they do' if len(still) > 1 else 'it does'} not move: {', '.join(still)}" if still else ""
    why += f"; left out, for nothing was recorded of {'them' if len(empty) > 1 else 'it'}: {', '.join(empty)}" if empty else ""
    yield f"{number}{why}" + (f"; left out as {'clocks' if len(clocks) > 1 else 'a clock'}: {', '.join(clocks)}" if clocks else "")


def camera_line(demonstrations: Sequence[Demonstration], description: Description, view: View) -> str:
    """The camera, the size of its frames and what is seen of them."""
    assert view.recorded and view.size  # noqa: PT018
    camera = view.camera or next(iter(description.cameras))
    sizes = [f"{width}x{height}" for height, width in (view.recorded, view.size)]
    crop = f", of which {view.crop[3]}x{view.crop[2]} from row {view.crop[0]} and column {view.crop[1]}" if view.crop else ""
    seen = f", seen at {sizes[1]}" if crop or sizes[0] != sizes[1] else ""
    colour = {"grey": "in grey", "colour": "in colour", "keep": "with depth"}[view.colour]
    return f"camera {camera}: {sizes[0]}{crop}{seen}, {colour}"


def several_each(num_frames: int, num_steps: int) -> str:
    """What it may mean that one number is a multiple of the other; nothing where it is none.

    >>> several_each(60, 20), several_each(21, 20)
    (' (3 for each, as of a video at 3 times the rate, or of 3 cameras)', '')
    """
    few, many = sorted((num_frames, num_steps))
    if not few or many % few or many == few:
        return ""
    times = many // few
    which = (
        f"of a video at {times} times the rate, or of {times} cameras" if num_frames == many else f"where the camera took one in {times}"
    )
    return f" ({times} for each, as {which})"


def cannot_unwrap(wrap: Wrap, others: Sequence[str]) -> tuple[str, str]:
    """What is to be said of a joint that cannot be unwrapped, and what would help, given the joints that can be learned without it."""
    without = f"leave it out by {naming(others)}, or " if others else ""
    return f"{wrap.joint} {wrap.impossible}", f"{without}record it as an angle that counts on"


def reads_past(wrap: Wrap, num_episodes: int) -> str:
    """A sentence on a joint that was unwrapped."""
    count = f"{len(wrap.episodes)} of {number_of(num_episodes, 'episode')} ({listed(wrap.episodes)})"
    return f"{wrap.joint} turns past the end of its readings, which wrap by a full turn of {wrap.turn:.4g}, in {count}: it is unwrapped"
