"""Laws of several goals in a row: each leg begins where the one before arrives, and all of them are one plan."""

import itertools
from dataclasses import fields, replace

import numpy as np
import pytest

from bars import FULL, bar
from preimage.ideas.memory import DemonstrationMemory
from preimage.ideas.waypoints import join
from preimage.network.pdvmrnn import PDVMRNN
from preimage.presets import Planner
from preimage.records import Percept, Plan


@pytest.fixture(scope="module")
def planner(trained: PDVMRNN, memory: DemonstrationMemory) -> Planner:
    return Planner(trained, memory, replace(FULL, iterations=3))


@pytest.fixture(scope="module")
def legs(planner: Planner) -> list[Plan]:
    goals = [Percept(bar(far).last.frame) for far in (0.5, 0.9, 0.3)]
    return planner.plan_in_turn(start=bar(0.5).first, goals=goals)


def test_each_leg_is_the_plan_from_where_the_one_before_arrives(planner: Planner, legs: list[Plan]) -> None:
    for before, leg in itertools.pairwise(legs):
        start = Percept(before.frames[before.arrival_step], before.joints[before.arrival_step])
        np.testing.assert_array_equal(leg.start.frame, start.frame)
        np.testing.assert_array_equal(leg.start.joints, start.joints)
        np.testing.assert_array_equal(leg.joints, planner.plan(start=start, goal=leg.goal).joints)


def test_joined_legs_pass_through_each_arrival_and_end_at_the_last(legs: list[Plan]) -> None:
    whole = join(legs)
    assert len(whole.frames) == len(whole.joints) == sum(leg.arrival_step for leg in legs[:-1]) + len(legs[-1])
    for leg, step in zip(legs, np.cumsum([leg.arrival_step for leg in legs]), strict=True):
        if leg.arrival_step > 0:
            np.testing.assert_array_equal(whole.joints[step], leg.joints[leg.arrival_step])
            np.testing.assert_array_equal(whole.frames[step], leg.frames[leg.arrival_step])
    assert whole.arrival_step == sum(leg.arrival_step for leg in legs)
    assert (whole.start, whole.goal) == (legs[0].start, legs[-1].goal)
    assert whole.error == pytest.approx(sum(leg.error for leg in legs))
    assert whole.stopped is max(legs, key=lambda leg: leg.error).stopped
    assert whole.legs == tuple(legs)


def test_one_leg_joined_is_that_leg(legs: list[Plan]) -> None:
    whole = join(legs[:1])
    for field in fields(Plan):
        np.testing.assert_equal(getattr(whole, field.name), getattr(legs[0], field.name))


def test_no_goal_is_refused(planner: Planner) -> None:
    with pytest.raises(ValueError, match="there is no goal: give one or more"):
        planner.plan_in_turn(goals=[])


def test_a_plan_of_several_legs_is_followed_leg_by_leg(planner: Planner, legs: list[Plan]) -> None:
    """Once the joined intentions fitted no network, and nothing could follow them."""
    policy, steps = planner.follow(join(legs)), 0
    for number, leg in enumerate(legs):
        alone = planner.follow(leg)
        for step in range(leg.arrival_step if number < len(legs) - 1 else len(leg) - 1):
            sensed = Percept(leg.frames[step], leg.joints[step])
            np.testing.assert_array_equal(policy(sensed), alone(sensed))
            steps += 1
    assert steps == len(join(legs)) - 1
