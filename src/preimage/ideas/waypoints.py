"""Several goals in a row: a plan to each from where the one before arrives, and all of them as one."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from preimage.method.seam import Policy
from preimage.records import Percept, Plan, Trust


def plan_in_turn(plan: Callable[..., Plan], *, start: Percept | None = None, goals: Sequence[Percept]) -> list[Plan]:
    """Plans from each goal to the next: the first from the start, every other from the percept with which the one before arrives.

    Nothing is sensed in between: where a plan is wrong, the next one begins wrong.

    Args:
        plan: from a start and a goal to a plan.

    Raises:
        ValueError: there is no goal, or a percept does not fit, as in `plan`.
    """
    if not goals:
        raise ValueError("there is no goal: give one or more")
    legs: list[Plan] = []
    for goal in goals:
        legs.append(plan(start=start, goal=goal))
        arrival = legs[-1].arrival_step
        start = Percept(legs[-1].frames[arrival], legs[-1].joints[arrival])
    return legs


def join(legs: Sequence[Plan]) -> Plan:
    """Plans that begin where the one before arrives, as one plan to the last goal, which is executed like any other.

    Its error is the sum of theirs, its reason to have stopped that of the leg with the largest error.
    """
    if len(legs) == 1:
        return legs[0]
    last, worst = legs[-1], max(legs, key=lambda leg: leg.error)
    ways = [(leg.frames[: leg.arrival_step + 1], leg.joints[: leg.arrival_step + 1]) for leg in legs[:-1]] + [(last.frames, last.joints)]
    frames, joints = zip(*ways, strict=True)
    later = slice(1, None)  # the first step of a leg is the arrival of the one before
    return replace(
        last,
        frames=np.concatenate([frames[0], *(each[later] for each in frames[1:])]),
        joints=np.concatenate([joints[0], *(each[later] for each in joints[1:])]),
        arrival_step=sum(leg.arrival_step for leg in legs),
        start=legs[0].start,
        error=sum(leg.error for leg in legs),
        errors=np.concatenate([leg.errors for leg in legs]),
        stopped=worst.stopped,
        unexplained=max((leg.unexplained for leg in legs if leg.unexplained is not None), default=None),
        seconds=sum(leg.seconds for leg in legs),
        intention=np.concatenate([leg.intention for leg in legs]),
        imagined_joints=None,
        expected_joints=None,
        trust=least_of([leg.trust for leg in legs]),
        legs=tuple(legs),
    )


def follow_in_turn(follow: Callable[[Plan], Policy], legs: Sequence[Plan]) -> Policy:
    """One-step prediction under each leg's intention for as many steps as it takes to arrive, under the last one's to the end.

    Args:
        follow: from a plan to a policy, `method.one_step.follow`.
    """
    policies = [follow(leg) for leg in legs]
    arrivals = np.cumsum([leg.arrival_step for leg in legs[:-1]])
    steps = itertools.count()
    return lambda percept: policies[np.searchsorted(arrivals, next(steps), side="right")](percept)


def least_of(trusts: Sequence[Trust | None]) -> Trust | None:
    """The least trust of several legs: a way leads no further than its worst part."""
    known = [trust for trust in trusts if trust is not None]
    worst = max(known, key=lambda trust: (trust.refused, -(trust.probability or 0.0), trust.strangeness), default=None)
    return worst if len(known) == len(trusts) else None
