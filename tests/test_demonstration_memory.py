"""Laws of the memory of the demonstrations: what it expects of a goal, from where it knows it, and how it is kept."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from bars import FULL, bar, bars, objective_of, problem_to
from preimage.ideas.end_correction import TerminalTarget
from preimage.ideas.expected_joints import WIDER, ExpectedJoints
from preimage.ideas.memory import DemonstrationMemory, Estimate
from preimage.ideas.residuals import residuals_of
from preimage.method.train import TrainConfig, train
from preimage.network.config import ModelConfig
from preimage.network.pdvmrnn import PDVMRNN, Generated
from preimage.presets import Planner, remember
from preimage.records import Demonstration, Percept

# Where all demonstrations begin alike


def test_memory_expects_the_joints_of_a_goal_between_the_demonstrations(trained: PDVMRNN, memory: DemonstrationMemory) -> None:
    expected = memory.about(problem_to(trained, bar(0.8))).joints_at_goal
    assert expected.mean.numpy() == pytest.approx(bar(0.8).joints[-1], abs=0.08)


def test_memory_weighs_little_where_it_tells_endings_badly(trained: PDVMRNN, memory: DemonstrationMemory) -> None:
    problem = problem_to(trained, bar(0.7))
    endings = torch.rand(memory.final_joints.shape, generator=torch.Generator().manual_seed(1))
    mixed_up = replace(memory, final_joints=endings, _last=[])
    weights = [TerminalTarget.expected(each.about(problem).joints_at_goal, 0.0).weight for each in (memory, mixed_up)]
    assert (weights[0] > 0.3).all()
    assert (weights[1] < 0.1).all()


def test_what_lies_about_and_stays_does_not_change_what_is_expected(trained: PDVMRNN, memory: DemonstrationMemory) -> None:
    shown = bar(0.8)
    frames = shown.frames.copy()
    frames[:, 12:] = 90  # something that hides the lowest rows from the first frame to the last
    recollection = memory.about(problem_to(trained, replace(shown, frames=frames)))
    assert recollection.endings is memory
    assert recollection.joints_at_goal.mean.numpy() == pytest.approx(shown.joints[-1], abs=0.15)


def test_endings_are_imagined_where_a_plan_begins_with_other_joints(trained: PDVMRNN, memory: DemonstrationMemory) -> None:
    shown = bar(0.8)
    assert memory.about(problem_to(trained, shown)).endings is memory
    elsewhere = problem_to(trained, shown, start=shown.last)
    endings = memory.about(elsewhere).endings
    assert not endings.arrivals.equal(memory.arrivals)
    assert endings.final_joints.equal(trained.coding.decode(elsewhere.rollouts.log_codes[:, -1].exp()))
    assert memory.about(elsewhere).joints_at_events == []


def test_several_ideas_ask_once(trained: PDVMRNN, memory: DemonstrationMemory) -> None:
    problem, other = problem_to(trained, bar(0.8)), problem_to(trained, bar(0.4))
    assert memory.about(problem) is memory.about(problem)
    assert memory.about(other) is not memory.about(problem)
    assert memory.about(other).problem is other


def test_the_intention_that_goes_with_a_goal_is_near_the_best_of_those_that_were_trained(
    trained: PDVMRNN, memory: DemonstrationMemory
) -> None:
    problem = problem_to(trained, bar(0.52))  # as far as one of the six
    coordinates = memory.about(problem).coordinates
    distances = (problem.space.training - coordinates).norm(dim=1)
    assert distances.argmin().item() == 2


def test_what_is_saved_is_all_there_is(memory: DemonstrationMemory, trained: PDVMRNN) -> None:
    again = DemonstrationMemory.from_tensors(memory.tensors())
    assert again.tensors().keys() == memory.tensors().keys()
    assert all(value.equal(memory.tensors()[name]) for name, value in again.tensors().items())
    problem = problem_to(trained, bar(0.8))
    assert again.about(problem).joints_at_goal.mean.equal(memory.about(problem).joints_at_goal.mean)
    with pytest.raises(TypeError):
        DemonstrationMemory.from_tensors(memory.tensors() | {"more": torch.zeros(1)})
    with pytest.raises(KeyError):
        DemonstrationMemory.from_tensors({name: value for name, value in memory.tensors().items() if name != "event_joint"})


def test_a_memory_whose_parts_do_not_fit_each_other_is_refused(memory: DemonstrationMemory) -> None:
    for name, tensor in memory.tensors().items():
        for changed in (tensor[..., None], tensor[None], torch.cat([tensor, tensor]) if tensor.ndim else tensor.repeat(2)):
            with pytest.raises(ValueError, match="shape"):
                DemonstrationMemory.from_tensors(memory.tensors() | {name: changed})


def test_the_memory_of_one_demonstration_expects_it_and_is_not_trusted(trained: PDVMRNN) -> None:
    alone = remember([bar(0.5)], trained)
    expected = alone.about(problem_to(trained, bar(0.9))).joints_at_goal
    assert expected.mean.numpy() == pytest.approx(bar(0.5).joints[-1], abs=1e-6)
    assert expected.deviation.isinf().all()
    assert alone.start_distance == 0


# What plans make of it


def test_expected_joints_are_charged_by_their_distance_in_wide_deviations(trained: PDVMRNN) -> None:
    problem = problem_to(trained, bar(0.7))
    free = objective_of(problem)
    pixels, codes = (torch.stack(parts)[None] for parts in zip(problem.start, problem.goal, strict=True))
    there = Generated(pixels, codes.log())
    joints = trained.coding.decode(problem.goal[1])
    estimate = Estimate(joints + torch.tensor([0.2, -0.1]), torch.full((2,), 0.1 / WIDER), torch.ones(2))
    charged = replace(free, terms=[*free.terms, ExpectedJoints(trained.coding, estimate)])
    assert (charged.goal_error(there) - free.goal_error(there))[0, 1].item() == pytest.approx(2.5, rel=0.02)
    error, arrival = charged.errors(there)
    assert arrival.item() == 1
    assert residuals_of(charged, there, arrival).square().sum().item() == pytest.approx(error.item(), rel=0.05)


def test_joints_of_which_nothing_is_known_are_not_charged(trained: PDVMRNN) -> None:
    problem = problem_to(trained, bar(0.7))
    nothing = ExpectedJoints(trained.coding, Estimate(torch.ones(2), torch.full((2,), torch.inf), torch.ones(2)))
    with torch.no_grad():
        generated = problem.imagine(problem.space.intention(problem.space.training))
    assert not nothing.errors(generated).any()


def test_a_plan_ends_as_much_as_memory_weighs_nearer_to_what_it_expects(trained: PDVMRNN, memory: DemonstrationMemory) -> None:
    shown = bar(0.8)
    expected = memory.about(problem_to(trained, shown)).joints_at_goal
    found = Planner(trained, memory, FULL).plan(start=shown.first, goal=Percept(shown.last.frame))
    assert found.imagined_joints is not None
    assert found.unexplained is not None
    rest = torch.from_numpy(found.imagined_joints[found.arrival_step :].mean(0))
    wanted = rest + TerminalTarget.expected(expected, found.unexplained).weight * (expected.mean - rest)
    assert found.joints[-1] == pytest.approx(wanted.numpy(), abs=1e-4)
    assert found.expected_joints == pytest.approx(expected.mean[None].numpy(), abs=1e-6)


@pytest.mark.parametrize("modalities", ["joints", "both"])
def test_a_plan_ends_with_the_joints_that_are_asked_for(trained: PDVMRNN, memory: DemonstrationMemory, modalities: str) -> None:
    shown = bar(0.65)
    planner = Planner(trained, memory, replace(FULL, modalities=modalities, iterations=3))
    found = planner.plan(start=shown.first, goal=shown.last)
    assert found.joints[-1] == pytest.approx(shown.joints[-1], abs=1e-6)
    assert found.joints[found.arrival_step] == pytest.approx(shown.joints[-1], abs=1e-6)
    assert found.expected_joints is None


# Where they begin in different joints


def begun_at(hidden: float, far: float) -> Demonstration:
    """A bar whose second joint, which nobody sees, begins somewhere and stays there."""
    shown = bar(far)
    return replace(shown, joints=np.stack([shown.joints[:, 0], np.full(len(shown), hidden)], 1))


@pytest.fixture(scope="module")
def differently() -> tuple[PDVMRNN, DemonstrationMemory]:
    rng = np.random.default_rng(0)
    shown = [begun_at(hidden, far) for hidden, far in zip(np.linspace(-1, 1, 16), rng.uniform(0.2, 1, 16), strict=True)]
    model = train(shown, ModelConfig.tiny(), config=TrainConfig(updates=1, rest_steps=2, precision="float32"))
    return model, remember(shown, model)


@pytest.mark.parametrize(("hidden", "known"), [(0.05, True), (-0.7, True), (1.11, True), (1.6, False)])
def test_a_start_among_different_ones_is_known_as_theirs_are(
    differently: tuple[PDVMRNN, DemonstrationMemory], hidden: float, known: bool
) -> None:
    model, memory = differently
    pixels, _ = problem_to(model, begun_at(min(hidden, 1.0), 0.5)).start
    assert memory.knows_start((pixels, model.coding.encode(torch.tensor([0.0, hidden]))), model.coding) == known


def test_first_joints_tell_what_no_picture_does(differently: tuple[PDVMRNN, DemonstrationMemory]) -> None:
    model, memory = differently
    unaware = replace(memory, first_joints=memory.first_joints[:1].repeat(16, 1), start_distance=torch.tensor(1e9), _last=[])
    for hidden in (-0.55, 0.0, 0.63):
        one = begun_at(hidden, 0.62)
        told, untold = (each.about(problem_to(model, one)).joints_at_goal for each in (memory, unaware))
        assert told.mean.numpy() == pytest.approx(one.joints[-1], abs=0.08)
        assert told.deviation[1] < 0.5 * untold.deviation[1]


def test_bars_begin_alike() -> None:
    assert len({tuple(one.joints[0]) for one in bars()}) == 1, "or the first laws say nothing of one beginning"
