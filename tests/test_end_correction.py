"""Laws of end correction: a plan ends between what is imagined and expected, begins as imagined and stays in the joints' ranges."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from preimage.ideas.end_correction import DOUBT, TerminalTarget, blend_to
from preimage.ideas.memory import Estimate
from preimage.network.coding import JointCoding

CODING = JointCoding(torch.tensor([-1.0, -2.0]), torch.tensor([1.0, 2.0]), 10)
ARRIVAL = 6


def way() -> torch.Tensor:
    """Eight steps: a detour, and a rest of two steps at the end."""
    there = torch.linspace(0, 1, ARRIVAL + 1, dtype=torch.float64)
    joints = torch.stack([-0.5 + there, 1.5 * there * (2 - there)], 1)
    return torch.cat([joints, joints[-1:]])


def target(move: tuple[float, float], weight: tuple[float, float]) -> TerminalTarget:
    return TerminalTarget(way()[ARRIVAL] + torch.tensor(move), torch.tensor(weight))


def test_a_plan_arrives_between_what_is_imagined_and_expected() -> None:
    blended = blend_to({ARRIVAL: target((0.08, -0.12), (0.75, 0.5))}, way(), CODING)
    for step in (ARRIVAL, ARRIVAL + 1):
        assert (blended[step] - way()[step]).numpy() == pytest.approx([0.06, -0.06], abs=1e-6)


def test_far_from_the_goal_a_plan_stays_as_imagined_and_nearer_it_is_bent_more() -> None:
    moved = (blend_to({ARRIVAL: target((0.08, -0.12), (1.0, 1.0))}, way(), CODING) - way()).norm(dim=1).numpy()
    assert moved[0] < 1e-3 * moved[ARRIVAL]
    assert (np.diff(moved[: ARRIVAL + 1]) > 0).all()


def test_a_joint_of_which_memory_tells_nothing_is_left_alone() -> None:
    blended = blend_to({ARRIVAL: target((0.3, 0.1), (0.0, 1.0))}, way(), CODING)
    assert torch.equal(blended[:, 0], way()[:, 0])


@pytest.mark.parametrize("move", [(0.3, 0.1), (0.0, 0.0)])
def test_nothing_expected_changes_nothing(move: tuple[float, float]) -> None:
    assert torch.equal(blend_to({ARRIVAL: target(move, (0.0, 0.0))}, way(), CODING), way())


def test_joints_stay_within_their_ranges() -> None:
    blended = blend_to({ARRIVAL: target((5.0, 5.0), (1.0, 1.0))}, way(), CODING)
    assert blended[ARRIVAL].tolist() == [1.0, 2.0]


def test_a_plan_that_stays_where_it_is_arrives_as_well() -> None:
    staying = way()[:1].repeat(3, 1)
    blended = blend_to({0: TerminalTarget(staying[0] + 0.1, torch.ones(2))}, staying, CODING)
    assert (blended - staying).numpy() == pytest.approx(0.1, abs=1e-6)


def test_memory_weighs_by_how_sure_it_is_and_the_more_the_less_sure_a_plan_is() -> None:
    expected = Estimate(torch.zeros(2), torch.tensor([0.1, 0.2]), torch.tensor([0.1, 0.1]))
    sure, unsure = (TerminalTarget.expected(expected, unexplained).weight.tolist() for unexplained in (0.5 * DOUBT, 4 * DOUBT))
    assert sure == pytest.approx([0.5, 0.2])  # as inverse variances
    assert unsure == pytest.approx([0.8, 0.5])
    nothing_told = replace(expected, deviation=torch.full((2,), torch.inf))
    assert TerminalTarget.expected(nothing_told, 0.0).weight.tolist() == [0.0, 0.0]


def test_on_the_way_a_plan_passes_where_memory_tells_and_is_not_bent_before() -> None:
    turn = 3
    ends = {
        turn: TerminalTarget(way()[turn] + torch.tensor([0.1, -0.2]), torch.tensor([1.0, 0.5])),
        ARRIVAL: target((0.08, -0.12), (0.75, 0.5)),
    }
    moved = blend_to(ends, way(), CODING) - way()
    assert moved[turn].numpy() == pytest.approx([0.1, -0.1], abs=1e-6)
    assert moved[ARRIVAL].numpy() == pytest.approx([0.06, -0.06], abs=1e-6)
    assert moved[0].norm() < 1e-3 * moved[turn].norm()
    between = moved[turn : ARRIVAL + 1]
    assert (between.diff(dim=0)[:, 0] <= 1e-9).all()  # from one target to the next, and no further
    assert (between.diff(dim=0)[:, 1] >= -1e-9).all()
