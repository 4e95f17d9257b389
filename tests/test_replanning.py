"""Laws of replanning: what is sensed is explained better and better, in time; who does not believe stops; robots may be late."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from bars import FULL, PAPER, bar, objective_of, problem_to
from preimage.ideas.belief import Belief
from preimage.ideas.leg import nearest_step
from preimage.ideas.memory import DemonstrationMemory
from preimage.ideas.replan_config import ReplanConfig
from preimage.ideas.replanning import Replanner
from preimage.ideas.timed_search import ByGaussNewton, Clock, Solution, by_adam
from preimage.ideas.underway import Sensed, Underway, Window
from preimage.method.prediction_error import sequence_error
from preimage.method.seam import Problem
from preimage.network.pdvmrnn import PDVMRNN
from preimage.presets import Planner
from preimage.records import Percept, Plan
from preimage.robot.limits import Limits
from preimage.robot.protocol import drive

PATIENT = ReplanConfig(budget_ms=60_000, looks=0)
"""A loop that has all the time in the world."""
LIMITS = Limits(("a", "b"), ("rad", "rad"), np.array([-9.0, -9.0]), np.array([9.0, 9.0]), np.array([50.0, 50.0]))


@pytest.fixture(scope="module")
def planner(trained: PDVMRNN, memory: DemonstrationMemory) -> Planner:
    return Planner(trained, memory, FULL)


@pytest.fixture(scope="module")
def found(planner: Planner) -> Plan:
    return planner.plan(start=bar(0.8).first, goal=Percept(bar(0.8).last.frame))


class FakeRobot:
    """Goes where it is commanded, and looks there like the bar of those joints; frames and joints may come late, or not at all.

    Args:
        latency: frames are so many steps old.
        slow: joints arrive so many steps late.
        drop_every: one frame in so many does not come.
    """

    limits = LIMITS

    def __init__(self, *, latency: int = 0, slow: int = 0, drop_every: int = 0) -> None:
        self._commands = [np.zeros(2)]
        self._latency, self._slow, self._drop_every = latency, slow, drop_every

    def sense(self) -> Percept:
        dropped = self._drop_every and len(self._commands) % self._drop_every == 0
        return Percept(None if dropped else self._looks(self._at(self._latency)), self._at(0))

    def command(self, joints: np.ndarray) -> None:
        self._commands.append(joints)

    def _at(self, late: int) -> np.ndarray:
        return self._commands[max(0, len(self._commands) - 1 - self._slow - late)]

    @staticmethod
    def _looks(joints: np.ndarray) -> np.ndarray:
        return bar(float(joints[0]), num_steps=2).last.frame


def run(replanner: Replanner, robot: FakeRobot | None = None) -> list[Belief]:
    return drive(robot or FakeRobot(), replanner, period_s=0.4, most_steps=40).decisions


def turning(replanner: Replanner, *, at: int) -> list[Belief]:
    """What is believed where another goal is wanted from a step on."""

    def decide(percept: Percept) -> Belief:
        belief = replanner(percept)
        if belief.step == at:
            replanner.change_goal(Percept(bar(0.3).last.frame))
        return belief

    return drive(FakeRobot(), decide, period_s=0.4, most_steps=40).decisions


# What is charged


def window_of(shown, steps: list[int], model: PDVMRNN, seen: list[bool] | None = None) -> Window:
    """Percepts of a demonstration at some of its steps."""
    parts = []
    for step, is_seen in zip(steps, seen or [True] * len(steps), strict=True):
        pixels, codes = problem_to(model, shown, start=shown[step]).start
        parts.append(Sensed(step, pixels, codes, is_seen))
    return Window.of(parts)


def test_the_error_of_a_whole_window_is_that_of_the_sequence(trained: PDVMRNN) -> None:
    shown, problem = bar(0.6), problem_to(trained, bar(0.9))
    generated = problem.imagine(problem.space.intention(problem.space.training[:2]), 6)
    window = window_of(shown, list(range(6)), trained)
    pixels, codes = (part.expand(2, *part.shape) for part in (window.pixels, window.codes))
    torch.testing.assert_close(window.errors(generated), sequence_error(generated, pixels, codes, torch.ones(2, 6)).total)


def test_a_frame_that_did_not_come_is_not_charged(trained: PDVMRNN) -> None:
    shown, problem = bar(0.6), problem_to(trained, bar(0.9))
    generated = problem.imagine(problem.space.intention(problem.space.training[:1]), 6)
    both, one = window_of(shown, [2, 4], trained, [True, False]), window_of(shown, [2], trained)
    other = replace(both, pixels=torch.cat([both.pixels[:1], both.pixels[1:] + 1]))
    assert both.errors(generated) == other.errors(generated)
    pixels = both.imagined(generated).pixels[:, :1]
    assert both.residuals(generated)[:, : pixels.numel()].square().sum() == pytest.approx(
        float(one.residuals(generated)[:, : pixels.numel()].square().sum()), rel=1e-5
    )


def test_the_residuals_are_about_the_error(trained: PDVMRNN) -> None:
    problem = problem_to(trained, bar(0.9))
    objective = Underway(objective_of(problem), window_of(bar(0.85), [1, 2, 3], trained))
    generated = problem.imagine(problem.space.intention(problem.space.training))
    error, arrival = objective.errors(generated)
    near = error.argmin()
    assert float(objective.residuals(generated, arrival)[near].square().sum()) == pytest.approx(float(error[near]), rel=0.2)


# The search


class FakeClock:
    """Time that passes only while sequences are imagined, so many seconds each, and as many more each time."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, per_sequence_s: float, each_time_s: float = 0.0) -> None:
        self.now, imagine = 0.0, Problem.imagine

        def slowly(problem, intention, num_steps=None):
            self.now += each_time_s + per_sequence_s * len(intention)
            return imagine(problem, intention, num_steps)

        monkeypatch.setattr(Problem, "imagine", slowly)

    def __call__(self) -> float:
        return self.now


@pytest.mark.parametrize("improve", [ByGaussNewton(), by_adam])
def test_a_solution_is_never_exchanged_for_a_worse_one(trained: PDVMRNN, improve) -> None:
    problem = problem_to(trained, bar(0.9))
    objective = Underway(objective_of(problem), window_of(bar(0.9), [1, 2], trained))
    clock, points = Clock(lambda: 0.0, 1.0), problem.space.training[:1]
    here = Solution(points, problem.imagine(problem.space.intention(points)))
    errors = [objective.errors(here.generated)[0].item()]
    for _ in range(20):
        clock.begin()
        better = improve(problem, objective, here, clock)
        here = better or here
        errors.append(objective.errors(here.generated)[0].item())
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 0.9 * errors[0]


def test_no_step_takes_longer_than_it_may(planner: Planner, found: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = FakeClock(monkeypatch, per_sequence_s=0.02)
    settings = ReplanConfig(budget_ms=90, enough=0.0, looks=0, rounds=9)
    poor = replace(found, intention=0 * found.intention, error=0.0)
    replanner = planner.replanner(goals=[found.goal], found=poor, settings=settings, clock=clock)
    beliefs = run(replanner)
    assert max(belief.seconds for belief in beliefs[1:]) <= 0.09
    assert sum(belief.num_imagined for belief in beliefs[1:]) > 4
    assert all(belief.num_imagined <= 3 for belief in beliefs[1:])


@pytest.mark.parametrize("budget_ms", [70, 150])
def test_no_step_of_a_goal_that_changes_takes_longer_than_it_may(
    planner: Planner, found: Plan, monkeypatch: pytest.MonkeyPatch, budget_ms: int
) -> None:
    clock = FakeClock(monkeypatch, per_sequence_s=0.015, each_time_s=0.03)
    settings = ReplanConfig(budget_ms=budget_ms, enough=0.0, looks=0)
    beliefs = turning(planner.replanner(goals=[found.goal], found=found, settings=settings, clock=clock), at=3)
    assert max(belief.seconds for belief in beliefs[1:]) <= budget_ms / 1000
    assert beliefs[-1].command[0] == pytest.approx(0.3, abs=0.15)


def test_a_goal_for_which_there_is_no_time_is_turned_to_at_rest(planner: Planner, found: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = FakeClock(monkeypatch, per_sequence_s=0.05)
    replanner = planner.replanner(goals=[found.goal], found=found, settings=ReplanConfig(budget_ms=1, looks=0), clock=clock)
    beliefs = turning(replanner, at=1)
    on_the_way = [belief for belief in beliefs if belief.step < found.arrival_step]
    np.testing.assert_allclose(on_the_way[-1].command, found.joints[found.arrival_step])
    assert not any(belief.done for belief in on_the_way)
    assert beliefs[-1].command[0] == pytest.approx(0.3, abs=0.15)


def test_without_time_the_last_solution_is_commanded(planner: Planner, found: Plan) -> None:
    settings = ReplanConfig(budget_ms=0, enough=0.0, looks=0)
    beliefs = run(planner.replanner(goals=[found.goal], found=found, settings=settings))
    assert all(belief.num_imagined == 0 for belief in beliefs[1:])
    np.testing.assert_allclose(beliefs[-1].command, found.joints[found.arrival_step])


# The loop


def test_undisturbed_it_ends_where_the_blind_plan_does(planner: Planner, found: Plan) -> None:
    beliefs = run(planner.replanner(goals=[found.goal], found=found, settings=PATIENT))
    assert len(beliefs) == found.arrival_step
    assert beliefs[-1].done
    np.testing.assert_allclose(beliefs[-1].command, found.joints[found.arrival_step], atol=0.05)
    assert [belief.steps_left for belief in beliefs] == list(range(found.arrival_step, 0, -1))


def test_what_is_imagined_can_be_looked_at_and_stays_while_nothing_is_searched(planner: Planner, found: Plan) -> None:
    replanner, ways = planner.replanner(goals=[found.goal], found=found, settings=PATIENT), []

    def decide(percept: Percept) -> Belief:
        belief = replanner(percept)
        ways.append((belief, replanner.imagined))
        if belief.step == 2:
            replanner.change_goal(Percept(bar(0.3).last.frame))
        return belief

    drive(FakeRobot(), decide, period_s=0.4, most_steps=40)
    assert all(belief.steps_left == imagined.arrival - imagined.at for belief, imagined in ways)
    first, third, fourth = (ways[step][1] for step in (0, 2, 3))
    assert third.generated is first.generated
    assert fourth.generated is not first.generated
    assert fourth.joints[fourth.arrival][0] == pytest.approx(0.3, abs=0.15)


def test_what_is_sensed_is_explained_better_and_better(planner: Planner) -> None:
    """A plan to a near goal is taken along a far one: the window shows it, and the intention follows."""
    far = bar(0.9)
    wrong = planner.plan(start=far.first, goal=Percept(bar(0.3).last.frame))
    errors = {}
    for rounds in (0, 6):
        settings = replace(PATIENT, rounds=rounds, enough=0.0, window="all", disbelief=9.0)
        replanner = planner.replanner(goals=[Percept(far.last.frame)], found=wrong, settings=settings)
        errors[rounds] = [replanner(far[step]) for step in range(4)][-1].window_error
    assert errors[6] < 0.7 * errors[0]


def test_it_stops_where_it_does_not_believe_and_stays_there(planner: Planner, found: Plan) -> None:
    replanner = planner.replanner(goals=[found.goal], found=found, settings=replace(PATIENT, rounds=0, patience=2, disbelief=0.1))
    replanner(bar(0.8).first)
    elsewhere = Percept(255 - bar(0.8).first.frame, np.array([-0.2, 0.4]))
    one, two = replanner(elsewhere), replanner(elsewhere)
    three = replanner(Percept(elsewhere.frame, elsewhere.joints - 0.1))  # it sinks, and is held where it was
    assert (one.held, one.done) == (None, False)
    assert two.held is not None
    assert "what is sensed is not what is imagined" in two.held
    assert two.done
    np.testing.assert_array_equal(two.command, elsewhere.joints)
    np.testing.assert_array_equal(three.command, elsewhere.joints)


def test_a_robot_that_does_not_come_along_is_not_believed_to(planner: Planner, found: Plan) -> None:
    replanner = planner.replanner(goals=[found.goal], found=found, settings=replace(PATIENT, window=1, rounds=0))
    doubts = [replanner(bar(0.8).first).doubt for _ in range(found.arrival_step)]
    assert doubts == sorted(doubts)
    assert doubts[0] < 0.05
    assert doubts[-1] > 0.5


def test_a_plan_that_is_refused_is_not_begun(planner: Planner, found: Plan) -> None:
    replanner = planner.replanner(goals=[found.goal], found=found, settings=PATIENT, refuse=lambda plan: "not to be trusted")
    (belief,) = run(replanner)
    assert (belief.held, belief.done) == ("not to be trusted", True)
    np.testing.assert_array_equal(belief.command, np.zeros(2))


def test_the_errors_of_a_windows_steps_are_those_of_windows_of_one_step(trained: PDVMRNN) -> None:
    problem = problem_to(trained, bar(0.9))
    generated, steps = problem.imagine(problem.space.intention(problem.space.training[:1]), 6), [1, 3, 4]
    alone = [window_of(bar(0.6), [step], trained).errors(generated)[0] for step in steps]
    torch.testing.assert_close(window_of(bar(0.6), steps, trained).errors_by_step(generated)[0], torch.stack(alone))


@pytest.mark.parametrize("robot", [{"latency": 1}, {"slow": 1}, {"drop_every": 3}, {"latency": 1, "slow": 1, "drop_every": 3}])
def test_a_robot_that_is_late_or_blind_at_times_arrives(planner: Planner, found: Plan, robot: dict[str, int]) -> None:
    settings = replace(PATIENT, disbelief=0.8)  # of a way of six steps, two are much
    beliefs = run(planner.replanner(goals=[found.goal], found=found, settings=settings), FakeRobot(**robot))
    assert beliefs[-1].done
    assert beliefs[-1].held is None
    assert beliefs[-1].command[0] == pytest.approx(0.8, abs=0.15)


def test_the_goal_may_change_under_way(planner: Planner, found: Plan) -> None:
    last = turning(planner.replanner(goals=[found.goal], found=found, settings=PATIENT), at=1)[-1]
    assert last.done
    assert last.command[0] == pytest.approx(0.3, abs=0.15)


def test_a_plan_of_another_horizon_is_gone_as_well(planner: Planner) -> None:
    short = Planner(planner.model, planner.memory, replace(FULL, horizon=5))
    found = short.plan(start=bar(0.5).first, goal=Percept(bar(0.5).last.frame))
    beliefs = run(planner.replanner(goals=[found.goal], found=found, settings=PATIENT))
    assert beliefs[-1].done
    assert len(beliefs) == found.arrival_step


def test_several_goals_are_reached_in_a_row(planner: Planner, found: Plan) -> None:
    asked: list[Plan] = []

    def refuse(plan: Plan) -> None:
        asked.append(plan)

    replanner = planner.replanner(goals=[found.goal, Percept(bar(0.4).last.frame)], found=found, settings=PATIENT, refuse=refuse)
    beliefs = run(replanner)
    assert beliefs[-1].done
    assert len(asked) == 2
    np.testing.assert_allclose(asked[1].start.joints, found.joints[found.arrival_step], atol=0.05)
    assert len(beliefs) == found.arrival_step + asked[1].arrival_step


def test_a_goal_where_the_robot_stands_is_done_at_once(planner: Planner, found: Plan) -> None:
    beliefs = run(planner.replanner(goals=[found.goal], found=replace(found, arrival_step=0), settings=PATIENT))
    assert len(beliefs) == 1


def test_the_papers_plans_are_made_anew_as_well(trained: PDVMRNN) -> None:
    planner = Planner(trained, None, replace(PAPER, iterations=2, candidates=2))
    beliefs = run(planner.replanner(goals=[bar(0.8).last], settings=replace(PATIENT, rounds=1, disbelief=99.0)))
    assert beliefs[-1].done


def test_what_does_not_fit_is_refused(planner: Planner, found: Plan) -> None:
    with pytest.raises(ValueError, match="there is no goal: give one or more"):
        planner.replanner(goals=[])
    replanner = planner.replanner(goals=[found.goal], found=found)
    replanner(bar(0.8).first)
    with pytest.raises(ValueError, match="the percept has no joints"):
        replanner(Percept(bar(0.8).first.frame))


@pytest.mark.parametrize("window", [0, -1])
def test_a_window_has_a_step(window: int) -> None:
    with pytest.raises(ValueError, match=r"window \(--window\) is .*: give 1 or more steps, or all"):
        ReplanConfig(window=window)


def test_the_point_of_an_intention_is_found_again(trained: PDVMRNN) -> None:
    space = trained.intention_table.space(None)
    points = torch.linspace(-1, 1, space.training.shape[1])[None]
    intention = space.intention(points).flatten()[0].double().numpy()
    torch.testing.assert_close(space.coordinates_of(torch.from_numpy(intention)[None]), points, atol=1e-3, rtol=0)


def test_a_way_is_entered_where_it_passes_nearest() -> None:
    way = np.array([[0.0, 0.0], [0.0, 1.0], [0.0, 1.0], [1.0, 1.0]])
    assert [nearest_step(way, np.array(at), np.ones(2)) for at in ([0.0, 0.1], [0.1, 1.0], [1.0, 1.0])] == [0, 2, 2]
