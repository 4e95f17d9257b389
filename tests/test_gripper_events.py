"""Laws of gripper events: what all demonstrations grip is found, what merely moves is not, and a plan arrives after the last event."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from bars import FULL, bar, objective_of, problem_to
from preimage.ideas.gripper_events import MAX_EVENTS, AfterEvents, ArriveAfterEvents, changes_side, events_in, find_events
from preimage.ideas.memory import DemonstrationMemory
from preimage.method.prediction_error import arrival_step
from preimage.method.train import TrainConfig, train
from preimage.network.coding import JointCoding
from preimage.network.config import ModelConfig
from preimage.network.intention import unflatten
from preimage.network.pdvmrnn import PDVMRNN, Generated
from preimage.presets import Planner, remember
from preimage.records import Demonstration, Percept


def gripping(far: float) -> Demonstration:
    """A bar that is gripped a third of the way and let go at two thirds of its nine steps."""
    shown = bar(far, 9)
    steps = np.arange(9)
    gripper = np.where((steps >= 3) & (steps < 6), 0.0, 0.04)
    return replace(shown, joints=np.column_stack([shown.joints, gripper]), joint_names=(*shown.joint_names, "gripper"))


def hands(close: list[int], open_: list[int], num_steps: int = 20) -> torch.Tensor:
    """An arm that sways, and a gripper (0.04 open) that closes and opens at the steps given, one pair a demonstration."""
    steps = torch.arange(num_steps)
    gripper = torch.stack([torch.where((steps >= a) & (steps < b), 0.0, 0.04) for a, b in zip(close, open_, strict=True)])
    arm = torch.sin(0.4 * steps).expand(len(close), -1)
    return torch.stack([arm, gripper], dim=-1)


def test_a_gripper_that_closes_and_opens_is_found_at_its_steps() -> None:
    found = find_events(hands([3, 5, 9], [12, 15, 19]))
    assert found is not None
    assert found.joint == 1
    assert found.steps.tolist() == [[3, 12], [5, 15], [9, 19]]


def test_a_demonstration_that_grips_otherwise_leaves_none_in_common() -> None:
    assert find_events(hands([3, 5, 9], [12, 15, 25])) is None  # the last one never opens again


@pytest.mark.parametrize("times", [MAX_EVENTS, MAX_EVENTS + 1])
def test_more_events_than_are_kept_are_none(times: int) -> None:
    restless = (torch.arange(3 * (times + 1)) // 3 % 2).float().expand(2, -1)[..., None]
    assert (find_events(restless) is not None) == (times <= MAX_EVENTS)


def test_a_joint_that_moves_through_its_middle_is_no_gripper() -> None:
    assert find_events(torch.linspace(0, 1, 30).expand(4, -1)[..., None]) is None


def test_a_joint_that_never_moves_is_no_gripper() -> None:
    assert find_events(torch.ones(3, 5, 2)) is None


def test_the_start_is_no_change_of_side() -> None:
    assert changes_side(torch.tensor([[[1.0], [1.0], [0.0]]]), 0.5)[0, :, 0].tolist() == [False, False, True]


@pytest.fixture(scope="module")
def shown() -> list[Demonstration]:
    return [gripping(far) for far in np.linspace(0.2, 1, 9)]


@pytest.fixture(scope="module")
def model(shown: list[Demonstration]) -> PDVMRNN:
    return train(shown, ModelConfig.tiny(), config=TrainConfig(updates=1, batch_size=6, rest_steps=3, precision="float32"))


@pytest.fixture(scope="module")
def gripped(shown: list[Demonstration], model: PDVMRNN) -> DemonstrationMemory:
    return remember(shown, model)


def test_memory_knows_where_a_goal_between_those_shown_is_gripped_and_let_go(model: PDVMRNN, gripped: DemonstrationMemory) -> None:
    assert (gripped.event_joint, gripped.num_events) == (2, 2)
    wanted = gripping(0.65)
    closing, opening = gripped.about(problem_to(model, wanted)).joints_at_events
    assert closing.mean.numpy() == pytest.approx(wanted.joints[3], abs=0.02)
    assert opening.mean.numpy() == pytest.approx(wanted.joints[6], abs=0.04)
    found = Planner(model, gripped, replace(FULL, iterations=0)).plan(start=wanted.first, goal=Percept(wanted.last.frame))
    assert found.expected_joints is not None
    assert found.expected_joints.shape == (3, 3)


def test_an_event_is_where_a_joint_passes_the_middle_of_its_range(model: PDVMRNN) -> None:
    joints = torch.from_numpy(gripping(0.6).joints)
    assert events_in(joints[None], 2, model.coding)[0].nonzero()[:, 0].tolist() == [3, 6]


def ways(coding: JointCoding, *demonstrations: Demonstration) -> Generated:
    """Demonstrations as if they had been imagined, without their pictures."""
    joints = torch.stack([torch.from_numpy(one.joints).float() for one in demonstrations])
    return Generated(torch.zeros(*joints.shape[:2], 1, 16, 16), coding.encode(joints).clamp(min=1e-12).log())


def errors(*rows: list[float]) -> SimpleNamespace:
    """A term with the errors that are given."""
    to_the_last = {
        "residuals": lambda generated, arrival: torch.zeros(len(arrival), 1),
        "num_steps": lambda arrival: int(arrival.max()) + 1,
    }
    return SimpleNamespace(errors=lambda generated: torch.tensor(rows), **to_the_last)


def test_a_way_does_not_arrive_before_the_last_event(model: PDVMRNN) -> None:
    twice = gripping(0.6)
    once = replace(twice, joints=np.where(np.arange(9)[:, None] >= 6, twice.joints[5], twice.joints))  # it is never let go
    falling = [9.0, 0.1, 9.0, 9.0, 9.0, 9.0, 9.0, 0.5, 9.0]
    term = AfterEvents([errors(falling, falling)], joint=2, num_events=2, coding=model.coding)
    charged = term.errors(ways(model.coding, twice, once))
    assert charged.isinf().tolist() == [[True] * 6 + [False] * 3, [False] * 9]
    assert arrival_step(charged, delay_penalty=1.01).tolist() == [7, 1]
    assert term.num_steps(torch.tensor([3, 7])) == 8


def test_demonstrations_without_events_leave_the_error_as_it_is(trained: PDVMRNN) -> None:
    terms = objective_of(problem_to(trained, bar(0.5))).terms
    assert ArriveAfterEvents(0, 0)(problem_to(trained, bar(0.5)), terms) is terms


def test_the_error_that_is_reported_is_the_one_that_was_searched(model: PDVMRNN, gripped: DemonstrationMemory) -> None:
    """Once the arrival was put after the last event when the search was over, and the error was that of another step."""
    wanted = gripping(0.65)
    options = replace(FULL, iterations=2, end_correction=False)
    planner = Planner(model, gripped, options)
    found = planner.plan(start=wanted.first, goal=Percept(wanted.last.frame))
    problem = problem_to(model, wanted)
    objective = objective_of(problem)
    for add in planner.ideas.terms:
        objective = replace(objective, terms=add(problem, objective.terms))
    assert isinstance(objective.terms[0], AfterEvents)
    generated = problem.imagine(unflatten(torch.from_numpy(found.intention).float()[None], model.intention_table.shapes))
    error, arrival = objective.errors(generated)
    assert found.error == pytest.approx(error.item(), rel=1e-5)
    assert found.arrival_step == arrival.item()
    assert found.error == pytest.approx(found.errors.min(), rel=1e-5)
