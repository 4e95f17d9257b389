"""The doctor for recordings: looks through them and says what is broken, what will make plans worse, and what would help.

It reads no file and draws nothing. Each threshold stands by its name, with the reason for it, beside the finding that uses it:
`recording` (lengths, clock), `selection` (tasks, what is a joint), `joints`, `timing`, `pictures` and `viewpoint` (camera), `goals`.

>>> import numpy as np
>>> from preimage.records import Episode
>>> frames, joints = np.zeros((4, 8, 8, 1), np.uint8), np.linspace(0, 1, 8).reshape(4, 2)
>>> found = examine([Episode(0, frames, joints, ("yaw", "shoulder"), None, 4, 10.0, None)])
>>> found.trainable, str(found.findings[0])
(False, 'fault: blank frames: no frame shows anything; look whether the right camera was recorded')
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from preimage.examination.findings import Finding, Kind, Severity
from preimage.examination.goals import coverage, duplicates, spacing, untold
from preimage.examination.joints import frozen, jumps, not_finite, out_of_range, starts, unrecorded, unrest
from preimage.examination.otherwise import another_zero, backwards, recorded_otherwise
from preimage.examination.pictures import blank, lost, moved, scene, stuck
from preimage.examination.recording import LEAST_STEPS, alike, clock, durations, lengths, unreadable
from preimage.examination.seen import RATE_HZ, Seen, look_through
from preimage.examination.selection import clocks, gaps, tasks, unwrap
from preimage.examination.timing import lag, stale, waits
from preimage.examination.viewpoint import CameraMove, camera_moves
from preimage.records import Episode, number_of

__all__ = ["CameraMove", "Examination", "Finding", "Kind", "Seen", "Severity", "examination_of", "examine", "look_through"]


@dataclass(frozen=True, eq=False)
class Examination:
    """All that was found, faults first, and what it was found in."""

    findings: list[Finding]
    seen: list[Seen]
    """Every episode, as far as it is kept."""
    moves: list[CameraMove]

    @property
    def trainable(self) -> bool:
        """Nothing that was found makes training impossible."""
        return not self._named(Severity.FAULT)

    @property
    def warnings(self) -> list[Finding]:
        """What was found that makes plans worse."""
        return [finding for finding in self.findings if finding.severity is Severity.WARNING]

    @property
    def verdict(self) -> str:
        """One or two sentences for somebody who has never done this."""
        if faults := self._named(Severity.FAULT):
            return f"Mend first: {', '.join(faults)}. It cannot be trained on as it is; each fault above says what would help."
        if warnings := self._named(Severity.WARNING):
            return f"Will train, but: {', '.join(warnings)}. Plans will be worse than they could be; each warning says what would help."
        ready = f"Ready to train: nothing is wrong with the {number_of(len(self.seen), 'episode')}."
        advice = [finding.kind.value for finding in self.findings if finding.help]
        return f"{ready} What would make plans better is said above ({', '.join(advice)})." if advice else ready

    def validate(self) -> None:
        """Raises ValueError where something makes training impossible: what, and what would help."""
        if not self.trainable:
            raise ValueError(f"{self.findings[0].what}: {self.findings[0].help}")

    def _named(self, severity: Severity) -> list[str]:
        return list(dict.fromkeys(finding.kind.value for finding in self.findings if finding.severity is severity))


def examine(episodes: Iterable[Episode], *, rate_hz: float = RATE_HZ, joints_chosen: bool = False) -> Examination:
    """What a careful person would find, had they looked at every frame. The episodes may come one by one: none is kept whole.

    Args:
        rate_hz: steps a second of the model that is going to be trained: what moves is measured from one of them to the next.
        joints_chosen: the user has named the joints, so that nobody asks whether one of them is a clock.

    Raises:
        ValueError: there is no episode.
    """
    return examination_of([look_through(episode, rate_hz=rate_hz) for episode in episodes], joints_chosen=joints_chosen)


def examination_of(seen: Sequence[Seen], *, joints_chosen: bool = False) -> Examination:
    """What `examine` finds, of episodes that were looked through already."""
    if not seen:
        raise ValueError("there is no episode to look at: record one or more")
    comparable, findings = alike(seen)
    findings += [*unreadable(seen), *gaps(seen), *lengths(comparable), *durations(comparable), *not_finite(comparable), *tasks(seen)]
    whole = [one for one in comparable if min(one.num_frames, one.num_steps) >= LEAST_STEPS]
    moves = camera_moves(whole)
    if whole:
        findings += clocks(whole, chosen=joints_chosen)
        whole, wraps = unwrap(whole, chosen=joints_chosen)
        findings += [*wraps, *_findings(whole, moves)]
    order = list(Severity)
    return Examination(sorted(findings, key=lambda finding: order.index(finding.severity)), list(seen), moves)


def _findings(seen: Sequence[Seen], moves: Sequence[CameraMove]) -> list[Finding]:
    apart = spacing(seen)
    of_arm = [*clock(seen), *frozen(seen), *out_of_range(seen), *jumps(seen), *waits(seen), *unrest(seen)]
    of_camera = [*blank(seen), *stuck(seen), *lost(seen), *stale(seen), *lag(seen), *moved(seen, moves)]
    of_goals = [*duplicates(seen, apart), *untold(seen, moves), *starts(seen), *coverage(seen, apart)]
    return [
        *unrecorded(seen),
        *recorded_otherwise(seen),
        *another_zero(seen),
        *backwards(seen),
        *of_arm,
        *of_camera,
        *of_goals,
        *scene(seen),
    ]
