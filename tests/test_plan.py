"""Laws of planning as the paper does it: from random intentions, by Adam, with nothing but a network; and of what no plan may do."""

import dataclasses
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import preimage as pi
from bars import EXACT, PAPER, REGRESSION, SOLVED, bar, bars, objective_of, problem_to, tiny_double
from preimage.ideas.memory import DemonstrationMemory
from preimage.ideas.no_goal import imagine_without_goal
from preimage.method.config import Modalities, PlanConfig, TrainConfig
from preimage.method.plan import plan, random_guesses
from preimage.method.train import train
from preimage.network.config import ModelConfig
from preimage.network.inputs import home
from preimage.network.intention import unflatten
from preimage.network.pdvmrnn import PDVMRNN, Generated
from preimage.presets import Planner, PlanOptions, load_planner
from preimage.records import Percept, Plan, Stopped
from preimage.storage.run_files import MEMORY


def imagined_by(model: PDVMRNN, found: Plan, num_steps: int | None = None) -> Generated:
    """What the network imagines from a plan's intention and start."""
    intention = unflatten(torch.from_numpy(found.intention).float()[None], model.intention_table.shapes)
    return problem_to(model, bar(0.5), start=found.start, horizon=num_steps or len(found)).imagine(intention)


def same(one: Plan, other: Plan) -> bool:
    """Whether two plans are equal to the bit, the time they took aside."""
    values = [[getattr(each, field.name) for field in dataclasses.fields(Plan)] for each in (one, other)]
    arrays = [(a, b) for a, b in zip(*values, strict=True) if isinstance(a, np.ndarray)]
    return all(np.array_equal(a, b) for a, b in arrays) and (one.error, one.stopped) == (other.error, other.stopped)


# The paper's preset


def test_the_paper_plans_without_memory(trained: PDVMRNN, memory: DemonstrationMemory) -> None:
    shown, options = bar(0.8), replace(PAPER, iterations=3)
    assert not options.needs_memory
    alone = Planner(trained, None, options).plan(start=shown.first, goal=shown.last)
    assert same(alone, plan(trained, start=shown.first, goal=shown.last, config=replace(EXACT, iterations=3)))
    assert same(alone, Planner(trained, memory, options).plan(start=shown.first, goal=shown.last)), "a memory that is there is not read"
    assert alone.expected_joints is None


def test_a_model_holds_no_memory(trained: PDVMRNN) -> None:
    weights = {name for name, _ in trained.named_parameters()}
    others = {name for name in trained.state_dict() if name not in weights and not name.startswith("coding.")}
    assert others == {"home_pixels", "home_joints", "longest", "shortest"}


def test_the_papers_training_leaves_no_memory_and_its_plans_ask_for_none(tmp_path: Path) -> None:
    train(bars(), ModelConfig.tiny(), config=TrainConfig(updates=1), folder=tmp_path / "run")
    assert not (tmp_path / "run" / MEMORY).exists()
    planner = load_planner(tmp_path / "run", replace(PAPER, iterations=0))
    assert planner.memory is None
    assert np.isfinite(planner.plan(goal=bar(0.5).last).error)
    with pytest.raises(ValueError, match=MEMORY):
        load_planner(tmp_path / "run", PlanOptions.full())


def test_a_search_starts_where_the_seed_says(trained_as_paper: PDVMRNN) -> None:
    problem = problem_to(trained_as_paper, bar(0.5))
    objective = objective_of(problem)
    first, again, other = (random_guesses(problem, objective, torch.Generator().manual_seed(seed)) for seed in (3, 3, 4))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)
    assert first.shape == (PlanConfig().candidates, problem.space.training.shape[1])


def test_guesses_lie_about_the_mean_as_far_as_the_deviation_says(trained_as_paper: PDVMRNN) -> None:
    def guesses(deviation: float, count: int = 4000) -> torch.Tensor:
        problem = problem_to(trained_as_paper, bar(0.5), initial_deviation=deviation, candidates=count)
        return random_guesses(problem, objective_of(problem), torch.Generator().manual_seed(0))

    mean = problem_to(trained_as_paper, bar(0.5)).space.training.mean(0)
    torch.testing.assert_close(guesses(0.0, 2), mean.expand(2, -1))
    torch.testing.assert_close(guesses(0.6) - mean, 3 * (guesses(0.2) - mean))
    assert guesses(0.2).std(0).numpy() == pytest.approx(0.2, rel=0.05)


def test_the_same_seed_gives_the_same_plan_and_another_seed_begins_elsewhere(trained_as_paper: PDVMRNN) -> None:
    few = replace(EXACT, candidates=2, iterations=2)
    one, same_seed, other = (plan(trained_as_paper, goal=bar(0.6).last, config=replace(few, search_seed=seed)) for seed in (1, 1, 2))
    assert same(one, same_seed)
    assert one.errors[0] != other.errors[0]


@pytest.fixture(scope="module")
def found(trained_as_paper: PDVMRNN) -> Plan:
    """The paper's plan to a goal between the demonstrations."""
    return plan(trained_as_paper, start=bar(0.8).first, goal=Percept(frame=bar(0.8).last.frame), config=EXACT)


def test_the_error_falls(found: Plan) -> None:
    assert found.errors[-1] < 0.5 * found.errors[0]
    assert (np.diff(found.errors) <= 0).all()


def test_a_plan_reaches_a_goal_between_the_demonstrations(found: Plan) -> None:
    assert np.abs(found.joints[found.arrival_step] - bar(0.8).joints[-1]).max() < 0.2 * np.abs(bar(0.8).joints[-1]).max()
    assert found.rate_hz == 2.5


def test_the_joints_of_the_papers_plan_are_those_that_are_imagined(trained_as_paper: PDVMRNN, found: Plan) -> None:
    generated = imagined_by(trained_as_paper, found)
    np.testing.assert_array_equal(found.joints, trained_as_paper.coding.decode(generated.log_codes[0].exp()).double())
    np.testing.assert_array_equal(found.joints, found.imagined_joints)


def test_the_error_is_that_of_the_plan_that_is_returned(trained_as_paper: PDVMRNN, found: Plan) -> None:
    problem = problem_to(trained_as_paper, bar(0.8))
    error, arrival = objective_of(problem).errors(imagined_by(trained_as_paper, found))
    assert (found.error, found.arrival_step) == (pytest.approx(error.item(), rel=1e-6), arrival.item())
    assert found.unexplained == pytest.approx(found.error / objective_of(problem).to_explain)


def test_a_search_says_why_it_ended(trained: PDVMRNN) -> None:
    def stopped(options: PlanOptions) -> Stopped:
        return Planner(trained, None, options).plan(goal=bar(0.6).last).stopped

    assert stopped(replace(PAPER, iterations=1, candidates=2)) is Stopped.ITERATIONS
    assert stopped(replace(PAPER, iterations=60, candidates=1, learning_rate=1e-9)) is Stopped.CONVERGED


# Every preset


@pytest.mark.parametrize("modalities", ["joints", "both", "vision"])
def test_joints_that_were_never_demonstrated_are_no_goal_in_python_either(trained: PDVMRNN, modalities: Modalities) -> None:
    planner = Planner(trained, None, replace(PAPER, modalities=modalities, iterations=0), joint_unit="rad")
    far = Percept(bar(0.4).last.frame, np.full(trained.sensors.num_joints, 100.0))
    if modalities == "vision":  # nobody looks at them
        planner.plan(goal=far)
        return
    name, low, high = trained.sensors.joint_names[0], trained.sensors.joint_lower[0], trained.sensors.joint_upper[0]
    sentence = f"the goal has {name} at 100: it was demonstrated from {low:.4g} to {high:.4g} rad; 100 degrees are 1.745 rad"
    for planned in (lambda: planner.plan(goal=far), lambda: planner.plan_in_turn(goals=[bar(0.4).last, far])):
        with pytest.raises(ValueError, match=re.escape(sentence)):
            planned()


@pytest.mark.parametrize("options", [PAPER, REGRESSION, SOLVED], ids=["paper", "regression", "gauss-newton"])
def test_planning_leaves_the_weights_alone(trained: PDVMRNN, options: PlanOptions) -> None:
    before = {name: value.clone() for name, value in trained.state_dict().items()}
    Planner(trained, None, replace(options, iterations=2)).plan(goal=bar(0.4).last)
    assert all(torch.equal(value, before[name]) for name, value in trained.state_dict().items())


def test_a_goal_of_joints_alone_brings_the_picture_along(trained: PDVMRNN) -> None:
    shown, planner = bar(0.65), Planner(trained, None, replace(REGRESSION, modalities="joints"))
    found = planner.plan(start=shown.first, goal=Percept(joints=shown.last.joints))
    missed = np.abs(found.frames[found.arrival_step].astype(float) - shown.last.frame).mean()
    ignored = np.abs(found.frames[0].astype(float) - shown.last.frame).mean()
    assert missed < 0.4 * ignored


def test_a_modality_that_is_left_out_is_not_looked_at(trained: PDVMRNN) -> None:
    shown = bar(0.65)
    misleading = Percept(shown.last.frame, shown.first.joints)
    config = replace(EXACT, iterations=3)
    true, misled = (plan(trained, start=shown.first, goal=goal, config=config) for goal in (shown.last, misleading))
    assert np.array_equal(true.joints, misled.joints)


def test_a_plan_starts_at_home_unless_it_is_told_otherwise(trained: PDVMRNN) -> None:
    config = replace(EXACT, iterations=0)
    unsaid, said = (plan(trained, start=start, goal=bar(0.5).last, config=config) for start in (None, home(trained)))
    assert same(unsaid, said)


def test_a_plan_is_as_long_as_the_longest_demonstration_or_the_horizon(trained: PDVMRNN) -> None:
    lengths = [len(plan(trained, goal=bar(0.5).last, config=replace(EXACT, iterations=0, horizon=steps))) for steps in (None, 4, 9)]
    assert lengths == [6, 4, 9]


def test_what_gauss_newton_has_imagined_is_not_imagined_again(trained: PDVMRNN, monkeypatch: pytest.MonkeyPatch) -> None:
    counts: list[int] = []
    imagine = PDVMRNN.generate_closed_loop
    monkeypatch.setattr(PDVMRNN, "generate_closed_loop", lambda *given, **more: (counts.append(len(given[1])), imagine(*given, **more))[1])
    Planner(trained, None, replace(SOLVED, iterations=3, candidates=2)).plan(goal=bar(0.3).last)
    assert counts
    assert 1 not in counts


def test_without_a_goal_the_intention_is_the_prior_mean(trained: PDVMRNN) -> None:
    found = imagine_without_goal(trained, bar(0.3).first, config=EXACT)
    prior = trained.intention_table.prior_mean(1).flatten()[0]
    np.testing.assert_array_equal(found.intention, prior.double())
    np.testing.assert_array_equal(found.joints, trained.coding.decode(imagined_by(trained, found).log_codes[0].exp()).double())


@pytest.mark.parametrize("options", [PAPER, REGRESSION, SOLVED], ids=["paper", "regression", "gauss-newton"])
def test_a_model_of_one_demonstration_plans(options: PlanOptions) -> None:
    """Once random guesses were scaled by how much training intentions differ, of which there was one, and were no numbers."""
    alone = train([bar(0.5)], ModelConfig.tiny(), config=TrainConfig(updates=2, rest_steps=1, precision="float32"))
    found = Planner(alone, None, replace(options, iterations=2)).plan(goal=bar(0.5).last)
    assert np.isfinite(found.error)
    assert np.isfinite(found.joints).all()


def test_plan_is_the_papers_where_nothing_is_added() -> None:
    assert pi.plan is plan
    model = tiny_double()
    one, other = (pi.plan(model, goal=bar(0.5).last, config=PlanConfig(iterations=1), **more) for more in ({}, {"ideas": pi.Ideas()}))
    assert same(one, other)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("start", "goal", "words"),
    [
        (Percept(np.zeros((8, 16, 1), np.uint8), np.zeros(2)), None, r"start's frame is \(8, 16, 1\)"),
        (Percept(np.zeros((16, 16, 1), np.uint8), np.zeros(3)), None, "start has 3 joints, the model was trained with 2"),
        (Percept(np.zeros((16, 16, 1), np.uint8), np.array([0, np.nan])), None, "start's joints are not finite"),
        (None, Percept(joints=np.zeros(2)), "goal has no frame"),
        (None, Percept(), "goal has no frame"),
    ],
)
def test_percepts_that_do_not_fit_are_named(trained: PDVMRNN, start: Percept | None, goal: Percept | None, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        plan(trained, start=start, goal=goal or bar(0.5).last, config=EXACT)


@pytest.mark.usefixtures("unchecked")
def test_frames_of_floating_point_are_refused(trained: PDVMRNN) -> None:
    """A picture of 0 to 1 would pass for one that is nearly black."""
    bright = Percept((bar(0.5).last.frame / 255).astype(np.float32))
    with pytest.raises(ValueError, match=r"goal's frame holds float32: give 8-bit pixels, 0 to 255 \(uint8\)"):
        plan(trained, goal=bright, config=EXACT)
