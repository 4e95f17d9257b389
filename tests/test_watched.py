"""A search that is watched finds what it would have found alone, and ends where whoever looks on wants it to."""

import numpy as np
import pytest

from bars import bars
from preimage.presets import Planner, PlanOptions

QUICK = {"iterations": 3, "horizon": 5, "candidates": 2}


def planners(trained, memory, **more):
    for options in (PlanOptions(**QUICK), PlanOptions(search="gauss_newton", guess="nearest", dimensions=3, **QUICK)):
        yield Planner(trained, memory, options)


def test_a_watched_plan_is_the_one_that_is_found_alone(trained, memory):
    start, goal = bars()[0].first, bars()[1].last
    for planner in planners(trained, memory):
        seen = []
        alone, watched = (each.plan(start=start, goal=goal) for each in (planner, planner.watched(seen.append)))
        np.testing.assert_array_equal(alone.joints, watched.joints)
        np.testing.assert_array_equal(alone.errors, watched.errors)
        assert seen


def test_every_evaluation_is_seen_with_its_points_and_what_is_imagined_from_them(trained, memory):
    for planner in planners(trained, memory):
        seen = []
        plan = planner.watched(seen.append).plan(start=bars()[0].first, goal=bars()[1].last)
        for one in seen:
            assert len(one.points) == len(one.error) == len(one.arrival) == len(one.generated.pixels)
            assert not one.error.requires_grad
        assert min(float(one.error.min()) for one in seen) <= plan.errors.min() + 1e-6


def test_what_is_raised_while_watching_ends_the_search(trained, memory):
    def enough(_):
        raise KeyError("enough")

    for planner in planners(trained, memory):
        with pytest.raises(KeyError):
            planner.watched(enough).plan(start=bars()[0].first, goal=bars()[1].last)
