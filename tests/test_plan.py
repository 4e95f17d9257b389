"""Laws of planning and recognition, by a model that learned a little: residuals, memory, legs, glances; the weights stay untouched."""

import itertools
from dataclasses import fields, replace

import numpy as np
import pytest
import torch

from bars import bar, objective, objective_to
from preimage.ideas.end_correction import End
from preimage.ideas.memory import expected_joints
from preimage.ideas.test_time_augmentation import glances
from preimage.ideas.waypoints import join, plan_in_turn
from preimage.method.error_regression import Places, regress_intention, slopes_among
from preimage.method.plan import (
    PlanConfig,
    as_inputs,
    imagine,
    imagine_library,
    imagine_without_goal,
    library_at,
    plan,
    recognise,
)
from preimage.method.prediction_error import WIDER, ExpectedJoints, ToGoal, ToSequence
from preimage.method.train import TrainConfig, train
from preimage.network.coding import to_frames
from preimage.network.config import ModelConfig
from preimage.network.intention import unflatten
from preimage.network.pdvmrnn import PDVMRNN, Generated, InputSequence
from preimage.records import Demonstration, Percept, Plan, Stopped

CONFIG = PlanConfig(precision="float32", glance=0.0, enough=0.0)
DESCEND = replace(CONFIG, method="descend")


@pytest.fixture(scope="module")
def model() -> PDVMRNN:
    shown = [bar(far) for far in np.linspace(0.2, 1, 6)]
    config = TrainConfig(updates=120, batch_size=6, learning_rate=1e-2, rest_steps=3, precision="float32")
    return train(shown, replace(ModelConfig.tiny(), intention_cost=1e-3), config=config)


def sensed_of(model: PDVMRNN, shown: Demonstration) -> InputSequence:
    percepts = [as_inputs(model, shown[step], name="step") for step in range(len(shown))]
    return torch.stack([one[0] for one in percepts])[None], torch.stack([one[1] for one in percepts])[None]


def nearly(codes: torch.Tensor) -> torch.Tensor:
    """Log codes a few percent off."""
    off = torch.linspace(-0.05, 0.05, codes.shape[-1])
    return (codes.log() + off).log_softmax(-1)


@pytest.mark.parametrize("modalities", ["vision", "joints", "both"])
def test_residuals_are_the_error_near_the_goal(model: PDVMRNN, modalities: str) -> None:
    goal = objective(model, modalities)
    (pixels, codes), (goal_pixels, goal_codes) = goal.start, goal.goal
    near = Generated(torch.stack([pixels, goal_pixels])[None] + 0.01, nearly(torch.stack([codes, goal_codes]))[None])
    error, arrival = goal.errors(near)
    assert arrival.item() == 1
    assert goal.residuals(near, arrival).square().sum().item() == pytest.approx(error.item(), rel=0.05)


def test_what_follows_does_not_count_where_a_goal_is_passed_through(model: PDVMRNN) -> None:
    goal = replace(objective(model), rests=False)
    (pixels, codes), (goal_pixels, goal_codes) = goal.start, goal.goal
    passing = Generated(torch.stack([pixels, goal_pixels, pixels])[None] + 0.01, nearly(torch.stack([codes, goal_codes, codes]))[None])
    until = Generated(passing.pixels[:, :2], passing.log_codes[:, :2])
    error, arrival = goal.errors(passing)
    assert arrival.item() == 1
    assert goal.residuals(passing, arrival).equal(goal.residuals(until, arrival))
    assert goal.residuals(passing, arrival).square().sum().item() == pytest.approx(error.item(), rel=0.05)


def test_expected_joints_are_charged_by_their_distance_in_wide_deviations(model: PDVMRNN) -> None:
    goal = objective(model)
    pixels, codes = (torch.stack(parts)[None] for parts in zip(goal.start, goal.goal, strict=True))
    there = Generated(pixels, codes.log())
    joints = model.coding.decode(goal.goal[1])
    expected = ExpectedJoints(model.coding, joints + torch.tensor([0.2, -0.1]), torch.full((2,), 0.1 / WIDER), torch.ones(2))
    charged, free = replace(goal, expected=expected), goal
    assert (charged.goal_error(there) - free.goal_error(there))[0, 1].item() == pytest.approx(2.5, rel=0.02)
    error, arrival = charged.errors(there)
    assert arrival.item() == 1
    assert charged.residuals(there, arrival).square().sum().item() == pytest.approx(error.item(), rel=0.05)


def test_memory_expects_the_joints_of_a_goal_between_the_demonstrations(model: PDVMRNN) -> None:
    shown = bar(0.8)
    expected = expected_joints(imagine_library(model, shown.first, config=CONFIG), objective_to(model, shown), model.coding)
    assert expected.mean.numpy() == pytest.approx(shown.joints[-1], abs=0.08)


def test_memory_weighs_little_where_it_tells_endings_badly(model: PDVMRNN) -> None:
    goal = objective(model)
    library = imagine_library(model, bar(0.7).first, config=CONFIG)
    ends = torch.rand(library.ends.shape, generator=torch.Generator().manual_seed(1))
    weights = [End.expected(expected_joints(each, goal, model.coding), 0.0).weight for each in (library, replace(library, ends=ends))]
    assert (weights[0] > 0.3).all()
    assert (weights[1] < 0.1).all()


def test_a_plan_ends_as_much_as_memory_weighs_nearer_to_what_it_expects(model: PDVMRNN) -> None:
    shown = bar(0.8)
    goal = objective_to(model, shown)
    expected = expected_joints(imagine_library(model, shown.first, config=CONFIG), goal, model.coding)
    found = plan(model, start=shown.first, goal=Percept(shown.last.frame), config=CONFIG)
    unexplained = found.error / replace(goal, expected=expected).start_to_goal
    start, way = as_inputs(model, shown.first, name="start"), torch.from_numpy(found.intention).float()[None]
    imagined = imagine(model, unflatten(way, model.intention_table.shapes), start, num_steps=len(found), precision="float32")
    rest = model.coding.decode(imagined.log_codes[0, found.arrival_step :].exp()).mean(0)
    wanted = rest + End.expected(expected, unexplained).weight * (expected.mean - rest)
    assert found.joints[-1] == pytest.approx(wanted.numpy(), abs=1e-4)
    assert found.recalled == pytest.approx(expected.mean[None].numpy(), abs=1e-6)
    assert plan(model, start=shown.first, goal=shown.last, config=replace(CONFIG, recalls=False, iterations=1)).recalled is None


def test_what_lies_about_and_stays_does_not_change_what_is_expected(model: PDVMRNN) -> None:
    shown = bar(0.8)
    start, goal = shown.first.frame.copy(), shown.last.frame.copy()
    start[12:], goal[12:] = 90, 90  # something that hides the lowest rows from the first frame to the last
    about = ToGoal(
        as_inputs(model, Percept(start, shown.joints[0]), name="start"), as_inputs(model, Percept(goal, shown.joints[-1]), name="goal")
    )
    library = imagine_library(model, Percept(start, shown.joints[0]), config=CONFIG)
    assert torch.equal(library.ends, model.shown_ends)
    expected = expected_joints(library, about, model.coding)
    assert expected.mean.numpy() == pytest.approx(shown.joints[-1], abs=0.15)


def test_memory_is_imagined_where_a_plan_begins_with_other_joints(model: PDVMRNN) -> None:
    shown = bar(0.8)
    assert torch.equal(imagine_library(model, shown.first, config=CONFIG).arrivals, model.shown_arrivals)
    assert not torch.equal(imagine_library(model, shown.last, config=CONFIG).arrivals, model.shown_arrivals)


def test_residuals_of_a_sequence_are_its_error(model: PDVMRNN) -> None:
    shown = bar(0.5)
    sensed = sensed_of(model, shown)
    goal = ToSequence(sensed)
    near = Generated(sensed[0] + 0.01, nearly(sensed[1]))
    error, aims = goal.errors(near)
    assert goal.residuals(near, aims).square().sum().item() == pytest.approx(error.item(), rel=0.05)


@pytest.mark.parametrize("config", [CONFIG, DESCEND], ids=["leap", "descend"])
def test_a_plan_reaches_a_goal_between_the_demonstrations(model: PDVMRNN, config: PlanConfig) -> None:
    shown = bar(0.8)
    found = plan(model, start=shown.first, goal=Percept(frame=shown.last.frame), config=config)
    assert np.abs(found.joints[found.arrival_step] - shown.joints[-1]).max() < 0.08
    assert found.errors[-1] < found.errors[0]
    assert found.error == pytest.approx(found.errors[-1], rel=1e-4)
    assert (np.diff(found.errors) <= 0).all()
    assert found.stopped in Stopped
    assert found.rate_hz == 2.5


@pytest.fixture(scope="module")
def legs(model: PDVMRNN) -> list[Plan]:
    goals = [Percept(bar(far).last.frame) for far in (0.5, 0.9, 0.3)]
    return plan_in_turn(model, start=bar(0.5).first, goals=goals, config=CONFIG)


def test_each_leg_is_the_plan_from_where_the_one_before_arrives(model: PDVMRNN, legs: list[Plan]) -> None:
    for before, leg in itertools.pairwise(legs):
        start = Percept(before.frames[before.arrival_step], before.joints[before.arrival_step])
        np.testing.assert_array_equal(leg.start.frame, start.frame)
        np.testing.assert_array_equal(leg.start.joints, start.joints)
        np.testing.assert_array_equal(leg.joints, plan(model, start=start, goal=leg.goal, config=CONFIG).joints)


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


def test_one_leg_joined_is_that_leg(legs: list[Plan]) -> None:
    whole = join(legs[:1])
    for field in fields(Plan):
        np.testing.assert_equal(getattr(whole, field.name), getattr(legs[0], field.name))


def test_no_goal_is_told(model: PDVMRNN) -> None:
    with pytest.raises(ValueError, match="there is no goal: give one or more"):
        plan_in_turn(model, goals=[])


@pytest.mark.parametrize("config", [CONFIG, DESCEND], ids=["leap", "descend"])
def test_planning_leaves_the_weights_alone(model: PDVMRNN, config: PlanConfig) -> None:
    before = {name: value.clone() for name, value in model.state_dict().items()}
    plan(model, goal=bar(0.4).last, config=replace(config, iterations=2))
    assert all(torch.equal(value, before[name]) for name, value in model.state_dict().items())


def test_a_goal_of_joints_alone_brings_the_picture_along(model: PDVMRNN) -> None:
    shown = bar(0.65)
    found = plan(model, start=shown.first, goal=Percept(joints=shown.last.joints), config=replace(CONFIG, modalities="joints"))
    missed = np.abs(found.frames[found.arrival_step].astype(float) - shown.last.frame).mean()
    ignored = np.abs(found.frames[0].astype(float) - shown.last.frame).mean()
    assert missed < 0.4 * ignored


@pytest.mark.parametrize("modalities", ["joints", "both"])
def test_a_plan_ends_with_the_joints_that_are_asked_for(model: PDVMRNN, modalities: str) -> None:
    shown = bar(0.65)
    found = plan(model, start=shown.first, goal=shown.last, config=replace(CONFIG, modalities=modalities))
    assert found.joints[-1] == pytest.approx(shown.joints[-1], abs=1e-6)
    assert found.joints[found.arrival_step] == pytest.approx(shown.joints[-1], abs=1e-6)
    assert found.recalled is None


def test_a_modality_that_is_left_out_is_not_looked_at(model: PDVMRNN) -> None:
    shown = bar(0.65)
    misleading = Percept(shown.last.frame, shown.first.joints)
    true, misled = (plan(model, start=shown.first, goal=goal, config=CONFIG) for goal in (shown.last, misleading))
    assert np.array_equal(true.joints, misled.joints)


@pytest.mark.parametrize(("doubt", "searches"), [(0.0, [2, 4]), (1e9, [2])])
def test_a_plan_in_doubt_tries_the_other_first_guesses(model: PDVMRNN, monkeypatch, doubt: float, searches: list[int]) -> None:
    tried = []

    def counted(space, coordinates, *rest, **config):
        tried.append(len(coordinates))
        return regress_intention(space, coordinates, *rest, **config)

    monkeypatch.setattr("preimage.method.plan.regress_intention", counted)
    shown = bar(0.7)
    plan(model, start=shown.first, goal=shown.last, config=replace(CONFIG, doubt=doubt, candidates=2, guesses=6, iterations=2))
    assert tried == searches


@pytest.mark.parametrize("config", [CONFIG, DESCEND], ids=["leap", "descend"])
def test_a_search_ends_where_the_error_is_small_enough(model: PDVMRNN, config: PlanConfig) -> None:
    shown = bar(0.8)
    wanted, library = objective_to(model, shown), imagine_library(model, shown.first, config=CONFIG)
    wanted = replace(wanted, expected=expected_joints(library, wanted, model.coding))
    once = replace(config, guesses=1)
    whole = plan(model, start=shown.first, goal=shown.last, config=once)
    half = (whole.errors.min() + whole.errors[0]) / 2
    sooner = replace(once, enough=float(half) / wanted.start_to_goal)
    found = plan(model, start=shown.first, goal=shown.last, config=sooner)
    assert found.stopped is Stopped.ENOUGH
    assert found.errors[-1] <= half < found.errors[-2]
    np.testing.assert_array_equal(found.errors, whole.errors[: len(found.errors)])


def test_a_search_without_memory_goes_on(model: PDVMRNN) -> None:
    shown, alone = bar(0.8), replace(CONFIG, recalls=False)
    found = [plan(model, start=shown.first, goal=shown.last, config=replace(alone, enough=share)) for share in (0.0, 1e9)]
    np.testing.assert_array_equal(*(one.errors for one in found))


@pytest.mark.parametrize(("doubt", "imagined"), [(0.0, True), (1e9, False)])
def test_training_sequences_are_imagined_only_for_a_plan_in_doubt(model: PDVMRNN, doubt: float, imagined: bool) -> None:
    shown = bar(0.7)
    library = library_at(model, as_inputs(model, shown.first, name="start"), CONFIG)
    plan(model, start=shown.first, goal=shown.last, config=replace(CONFIG, doubt=doubt, iterations=1), library=library)
    assert (library.at_hand is not None) == imagined


def test_what_there_is_to_explain_is_the_error_of_staying(model: PDVMRNN) -> None:
    wanted = objective(model)
    pixels = wanted.start[0] - wanted.goal[0]
    assert wanted.start_to_goal == pytest.approx(float(pixels.square().sum()) * 16 / 40)  # 16x16 pixels count as 64x64
    assert replace(wanted, goal=wanted.start, modalities="both").start_to_goal == pytest.approx(0, abs=1e-6)


def test_a_way_is_the_mean_of_what_is_imagined_from_all_looks(model: PDVMRNN) -> None:
    start = bar(0.3).first
    alone = [imagine_without_goal(model, start, config=CONFIG)]
    pixels, _ = as_inputs(model, start, name="start")
    for look in glances(pixels, 0.05)[1:]:
        alone.append(imagine_without_goal(model, Percept(to_frames(look).numpy(), start.joints), config=CONFIG))
    together = imagine_without_goal(model, start, config=replace(CONFIG, glance=0.05))
    np.testing.assert_allclose(together.joints, np.mean([one.joints for one in alone], 0), atol=2e-3)  # frames are of whole grey levels
    np.testing.assert_array_equal(together.frames, alone[0].frames)
    assert np.abs(together.joints - alone[0].joints).max() > 1e-4


def test_slopes_are_told_by_what_is_known_around(model: PDVMRNN) -> None:
    space = model.intention_table.space(2)
    start, goal = as_inputs(model, bar(0.5).first, name="start"), as_inputs(model, bar(0.5).last, name="goal")
    generator = torch.Generator().manual_seed(0)
    points = torch.cat([torch.zeros(1, 2), 0.02 * torch.randn(20, 2, generator=generator)])
    objective = ToGoal(start, goal)
    generated = imagine(model, space.intention(points), start, num_steps=6, precision="float32")
    errors, aims = objective.errors(generated)
    residuals = objective.residuals(generated, aims[:1].expand(21))
    here = Places(points[:1], errors[:1], aims[:1], residuals[:1])
    told = slopes_among(here, points, generated, objective)[0]
    for way in torch.eye(2):
        near = imagine(model, space.intention(points[:1] + 0.01 * way), start, num_steps=6, precision="float32")
        measured = (objective.residuals(near, aims[:1]) - residuals[:1])[0] / 0.01
        assert (way @ told - measured).norm() < 0.1 * measured.norm()


def test_a_library_that_looks_less_far_ahead_is_not_used(model: PDVMRNN) -> None:
    library = imagine_library(model, config=replace(CONFIG, horizon=4))
    assert len(plan(model, goal=bar(0.5).last, config=replace(CONFIG, horizon=6), library=library).joints) == 6


def test_a_model_of_one_demonstration_plans() -> None:
    config = TrainConfig(updates=2, rest_steps=1, precision="float32")
    alone = train([bar(0.5)], ModelConfig.tiny(), config=config)
    found = plan(alone, goal=bar(0.5).last, config=replace(CONFIG, dimensions=None, iterations=2))
    assert np.isfinite(found.error)


def test_recognition_regenerates_a_new_sequence(model: PDVMRNN) -> None:
    found = recognise(model, bar(0.55), config=CONFIG)
    nothing = ToSequence(sensed_of(model, bar(0.55)))
    start = as_inputs(model, bar(0.55).first, name="start")
    prior = imagine(model, model.intention_table.prior_mean(1), start, num_steps=6, precision="float32")
    assert found.error < 0.5 * nothing.errors(prior)[0].item()


@pytest.mark.parametrize(
    ("start", "goal", "words"),
    [
        (Percept(np.zeros((8, 16, 1), np.uint8), np.zeros(2)), None, r"start's frame is \(8, 16, 1\)"),
        (Percept(np.zeros((16, 16, 1), np.uint8), np.zeros(3)), None, "start has 3 joints, the model was trained with 2"),
        (Percept(np.zeros((16, 16, 1), np.uint8), np.array([0, np.nan])), None, "start's joints are not finite"),
        (None, Percept(joints=np.zeros(2)), "goal has no frame"),
    ],
)
def test_percepts_that_do_not_fit_are_named(model: PDVMRNN, start: Percept | None, goal: Percept | None, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        plan(model, start=start, goal=goal or bar(0.5).last, config=CONFIG)


def test_a_goal_is_not_reached_before_its_earliest_step(model: PDVMRNN) -> None:
    goal = replace(objective(model), rests=False)
    (pixels, codes), (goal_pixels, goal_codes) = goal.start, goal.goal
    seen, felt = (pixels, goal_pixels, pixels, pixels), (codes, goal_codes, codes, codes)
    passing = Generated(torch.stack(seen)[None], torch.stack(felt).log()[None])
    assert goal.errors(passing)[1].item() == 1
    error, arrival = replace(goal, earliest=2).errors(passing)
    assert arrival.item() == 2
    assert error.item() > 10 * goal.errors(passing)[0].item()
