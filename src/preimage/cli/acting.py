"""The verbs that lead from a trained model to an arm that moves: demo, plan, execute.

What a verb's signature does not need is loaded in its function, so that a word that is off is answered at once.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import tyro
from tyro.conf import Positional

from preimage.cli.screen import counted, following, remark, validate_goals, waiting
from preimage.compute.choices import Device
from preimage.evaluation.loops import Disturbed
from preimage.presets import PlanOptions, Preset, ReplanConfig, load_planner
from preimage.records import HIGHEST_RATE_HZ, LOWEST_RATE_HZ, GoalRefused, Percept, Plan, Scene, Verdict, number_of
from preimage.storage.bundled import BUNDLED
from preimage.storage.output_folders import Kind, output_folder, validate_output_file, validate_output_folder

if TYPE_CHECKING:
    from preimage.presets import Planner

MOST_GOALS = 1000
DEMO = Kind("demo", required=("report.html", "result.json"), pattern="goal-*.*")
BundledTask = Annotated[str, tyro.conf.arg(help=f"which of the bundled models: {' or '.join(BUNDLED)}.")]


def demo(
    task: BundledTask = "reach",
    goals: int = 5,
    seed: int = 7,
    out: Path = Path("demo"),
    as_: Annotated[Preset, tyro.conf.arg(name="as")] = "full",
    config: Annotated[PlanOptions, tyro.conf.arg(name="")] = PlanOptions.full(),  # noqa: B008, frozen
) -> None:
    """Let the bundled model plan to goals it never saw, execute the plans, and show films and a report.

    Args:
        goals: how many goals.
        seed: draws the goals.
        out: folder for films, figures and report.html: new, empty, or that of a demo before, which is replaced.
        as_: paper: the paper's method alone; regression: the same, begun near the goal; full: all ideas. Other options change it.
        config: how the plans are searched for.
    """
    if task not in BUNDLED:
        raise ValueError(f"there is no bundled model of {task}; there are {', '.join(BUNDLED)}")
    validate_goals(goals, most=MOST_GOALS)
    from preimage.compute.devices import CPU
    from preimage.compute.precision import describe_precision
    from preimage.compute.threads import choose_threads
    from preimage.evaluation import demo as demonstration_of_it_all

    remark(describe_precision(config.precision, CPU))
    remark(choose_threads())
    with following("planning and executing", total=goals) as follow, output_folder(out, DEMO, overwrite=True) as draft:
        words = {"goals": goals, "seed": seed, "out": draft}
        report = demonstration_of_it_all.run(task, config, **words, progress=counted(follow))
    for line in report.lines:
        print(line.replace(str(draft), str(out)))
    print(f"open {out / report.page.name}")


def plan_(
    run: Positional[str],
    goal: tuple[str, ...],
    out: Path,
    start: str | None = None,
    goal_joints: tuple[float, ...] | None = None,
    joint_limits: Path | None = None,
    rate_hz: float | None = None,
    overwrite: bool = False,
    anyway: bool = False,
    device: Device = "cpu",
    as_: Annotated[Preset, tyro.conf.arg(name="as")] = "full",
    config: Annotated[PlanOptions, tyro.conf.arg(name="")] = PlanOptions.full(),  # noqa: B008, frozen
) -> None:
    """Imagine a way to a goal, or to several in a row.

    Args:
        run: a run folder, the name of a bundled model, or hf:OWNER/NAME of the Hugging Face Hub.
        goal: where the goal comes from: an image file, or DATA:EPISODE or DATA:EPISODE:STEP of a data set;
            of several, each is planned to from where the plan to the one before ends, and the whole is one plan.
        out: folder to write, new or empty: the plan, a film and a figure of it, and the joints to command as CSV and as a LeRobotDataset.
        start: where the start comes from, likewise; by default the mean start of the demonstrations.
        goal_joints: joint angles of the goal, in the unit of the recordings (rad), for --modalities joints or both.
        joint_limits: JSON of what may be commanded, joint by joint: lower, upper, velocity or step; by default what was demonstrated.
        rate_hz: rows a second of the joints to command; by default as many as the recordings have.
        overwrite: replace the plan that is in `out`.
        anyway: write the plan even where the goal is refused, because nothing like it was ever reached (`preimage calibrate`).
        device: what computes; of a small network the CPU has a plan before a GPU has made ready.
        as_: paper: the paper's method alone; regression: the same, begun near the goal; full: all ideas. Other options change it.
        config: how the plan is searched for.
    """
    from preimage.compute.devices import torch_device
    from preimage.compute.precision import describe_precision
    from preimage.compute.threads import choose_threads
    from preimage.data.sources import find_percept
    from preimage.data.view import read_through
    from preimage.ideas.waypoints import join
    from preimage.report.figures import figure
    from preimage.report.films import film
    from preimage.robot.limits import commands_of, limits_seen, read_limits
    from preimage.storage.plans import PLAN, save_episode, save_plan
    from preimage.storage.runs import find_run, read_body, read_shown, read_view

    validate_use_of_joints(goal_joints, num_goals=len(goal), modalities=config.modalities)
    validate_rate(rate_hz)
    validate_output_folder(out, PLAN, overwrite=overwrite)
    folder = find_run(run)  # once, so that all parts of a run on the Hub are of one revision
    planner = load_planner(folder, config, device=torch_device(device))
    view, body, shown = read_view(folder), read_body(folder), read_shown(folder)
    model = planner.model
    limits = limits_seen(model.sensors, shown, unit=body.joint_unit)
    if joint_limits:
        limits = read_limits(joint_limits, limits, rate_hz=model.config.rate_hz)
    wanted = [find_percept(each, model.sensors, view=view, default_step=-1) for each in goal]
    goals = [each.percept for each in wanted]
    if goal_joints is not None:
        goals = [Percept(goals[0].frame, read_through(view, np.array([goal_joints]), model.sensors.joint_names)[0])]
    planner.validate_goals(goals, source="--goal" if goal_joints is None else "--goal-joints")
    begin = find_percept(start, model.sensors, view=view, default_step=0).percept if start else None
    precision, threads = describe_precision(config.precision, model.home_pixels.device), choose_threads()
    with waiting("planning" if len(goals) == 1 else f"planning to {len(goals)} goals in a row"):
        legs = planner.plan_in_turn(start=begin, goals=goals)
    found = join(legs)
    if found.trust and found.trust.refused and not anyway:
        raise GoalRefused.by(found.trust, "plan all the same with --anyway")
    rate_hz = rate_hz or max(one.rate_hz for one in shown)
    commands, limited = commands_of(found, limits, rate_hz=rate_hz)
    with output_folder(out, PLAN, overwrite=overwrite) as draft:
        save_plan(found, draft, scene=wanted[-1].scene, commands=commands, rate_hz=rate_hz)
        save_episode(found, draft / "lerobot", commands=commands, rate_hz=rate_hz, body=body)
        film(found, None, draft / "imagined.mp4")
        figure(found, None, draft / "imagined.png", joint_unit=body.joint_unit, commands=commands, commands_hz=rate_hz)
    print("\n".join(sentences_of(legs, found, out)))
    print(precision)
    print(threads)
    print("\n".join(limited) or "no limit changed the joints to command")


def validate_rate(rate_hz: float | None) -> None:
    """Raises ValueError where commands would be that slow or fast that a unit must be wrong."""
    if rate_hz is not None and not LOWEST_RATE_HZ <= rate_hz <= HIGHEST_RATE_HZ:
        raise ValueError(f"--rate-hz is {rate_hz:g}: give {LOWEST_RATE_HZ:g} to {HIGHEST_RATE_HZ:g} rows a second")


def validate_use_of_joints(goal_joints: tuple[float, ...] | None, *, num_goals: int, modalities: str) -> None:
    """Raises ValueError where joints of the goal were given and nothing would come of them."""
    if goal_joints is None:
        return
    if modalities == "vision":
        raise ValueError("--goal-joints is not looked at while --modalities is vision: give --modalities joints, or both")
    if num_goals != 1:
        raise ValueError(f"--goal-joints are the joints of one goal, and --goal names {num_goals}: plan to one goal, or without joints")


def sentences_of(legs: Sequence[Plan], found: Plan, out: Path) -> list[str]:
    """What there is to say of a plan, and of its legs where there are several."""
    lines = []
    for number, leg in enumerate(legs, start=1) if len(legs) > 1 else ():
        verdict = verdict_on(leg, f"after {number_of(leg.arrival_step, 'step')}")
        lines.append(f"goal {number} of {len(legs)}: {verdict}, {leg.stopped.value}")
    at = f"at step {found.arrival_step} ({found.arrival_step / found.rate_hz:.1f} s)"
    lines.append(f"{verdict_on(found, at)}, planned in {found.seconds:.1f} s, in {out}")
    lines.append(f"stopped: {found.stopped.value}")
    return [*lines, *(line for line in (found.trust.sentence, found.trust.note) if line)] if found.trust else lines


def verdict_on(plan: Plan, when: str) -> str:
    """Whether a plan arrives, when, and with which error beside that of staying at the start."""
    words = {
        Verdict.REACHED: f"reached: arrives {when}",
        Verdict.NEAR: f"near: arrives {when}, not quite at the goal",
        Verdict.IN_DOUBT: f"in doubt: does not arrive, and is nearest {when}",
        None: f"arrives {when}",
    }
    share = "" if plan.unexplained is None else f", {100 * plan.unexplained:.1f} % of that of staying at the start"
    return f"{words[plan.verdict]}, error {plan.error:.3f}{share}"


def execute_(
    plan: Positional[str],
    film_: Annotated[Path | None, tyro.conf.arg(name="film")] = None,
    loop: Literal["closed", "open", "replan"] = "closed",
    run: str | None = None,
    goal: tuple[str, ...] = (),
    disturb: Disturbed | None = None,
    anyway: bool = False,
    replan: Annotated[ReplanConfig, tyro.conf.arg(name="")] = ReplanConfig(),  # noqa: B008, frozen
    as_: Annotated[Preset, tyro.conf.arg(name="as")] = "full",
    config: Annotated[PlanOptions, tyro.conf.arg(name="")] = PlanOptions.full(),  # noqa: B008, frozen
) -> None:
    """Let the simulated arm execute a plan, and judge where it ends.

    Args:
        plan: what `preimage plan` wrote; or, with --goal, a run, which plans first.
        film_: film to write, .mp4 or .gif, imagined beside executed.
        loop: closed executes the plan blind; open predicts the next joints from what the robot senses; replan plans the rest of the way
            anew at every step, and says what it believes.
        run: the network that made the plan, for --loop open and replan: a run folder, a bundled model, or hf:OWNER/NAME.
        goal: DATA:EPISODE of what is wanted, where a run is given in place of a plan; of several, --loop replan goes to one after
            the other, in the scene of the last.
        disturb: what goes wrong on the way: the hand is pushed, an encoder is off (bias), the object is elsewhere, frames are missing
            (camera) or late.
        anyway: execute even a plan to a goal that is refused.
        replan: how --loop replan goes about it.
        as_: paper: the paper's method alone; regression: the same, begun near the goal; full: all ideas. Other options change it.
        config: how plans are searched for.
    """
    import time

    from preimage.evaluation.trials import Circumstances, try_out
    from preimage.report.films import FILM_SUFFIXES, film
    from preimage.robot import Arm, with_frames
    from preimage.robot.execution import execute, task_of

    if film_:
        validate_output_file(film_, "film", suffixes=FILM_SUFFIXES)
    if disturb == "goal":
        raise ValueError("--disturb goal needs goals to choose from: preimage evaluate has them")
    if len(goal) > 1 and loop != "replan":
        raise ValueError(f"--goal names {len(goal)} goals: give --loop replan, or plan to them first (preimage plan)")
    planner, found, scene, then = planned_anew(plan, goal, config) if goal else planned_before(plan, run, loop, config)
    if scene is None:
        raise ValueError(f"the plan in {plan} is for a goal without a scene, which nothing can judge: plan with --goal DATA:EPISODE")
    if found.trust and found.trust.refused and not anyway:
        raise GoalRefused.by(found.trust, "execute all the same with --anyway")
    if loop == "closed" and disturb is None:
        trial = execute(found, Arm(), scene)
    else:
        circumstances = Circumstances(disturb, settings=replan, then=then, clock=time.perf_counter)
        task = with_frames(task_of(scene), found.frames.shape[1])
        trial, beliefs = try_out(planner, found, Arm(), task, scene, loop, circumstances)
        if beliefs:
            print("\n".join(beliefs_in_words(beliefs)))
    if film_:
        film(found, trial, film_)
    for sentence in trial.limited:
        print(sentence)
    print(f"{'reached' if trial.success else 'missed'}: {100 * trial.deviation_m:.1f} cm from the goal")


def planned_before(folder: str, run: str | None, loop: str, options: PlanOptions) -> "tuple[Planner | None, Plan, Scene | None, tuple]":
    """A plan from its folder, with the network that made it where the loop needs it."""
    from preimage.storage.plans import load_plan

    found, scene = load_plan(folder)
    if loop == "closed":
        return None, found, scene, ()
    if run is None:
        raise ValueError(f"--loop {loop} asks the network at every step: give the one that made the plan, as --run reach")
    planner = load_planner(run, options)
    sensors = planner.model.sensors
    num_numbers = planner.model.intention_table.prior_mean(1).flatten().shape[1]
    fits = found.joint_names == sensors.joint_names and found.frames.shape[1:] == (sensors.height, sensors.width, sensors.channels)
    if not fits or len(found.intention) != num_numbers:
        raise ValueError(f"the plan in {folder} was not made by {run}, or leads to several goals: give that run, or the run and --goal")
    return planner, found, scene, ()


def planned_anew(run: str, goals: Sequence[str], options: PlanOptions) -> "tuple[Planner, Plan, Scene | None, tuple]":
    """A plan by a run to the first of some goals, from where the arm stands in the scene of the last, and the goals after it."""
    from preimage.data.sources import find_percept
    from preimage.robot import Arm, with_frames
    from preimage.robot.execution import task_of
    from preimage.robot.simulated import SimulatedRobot
    from preimage.storage.runs import find_run, read_view

    folder = find_run(run)
    planner, view = load_planner(folder, options), read_view(folder)
    wanted = [find_percept(each, planner.model.sensors, view=view, default_step=-1) for each in goals]
    scene = wanted[-1].scene
    if scene is None:
        raise ValueError(f"{goals[-1]} is a goal without a scene, which nothing can judge: give DATA:EPISODE of simulated recordings")
    task = with_frames(task_of(scene), planner.model.sensors.height)
    start = SimulatedRobot(Arm(), task, scene, rate_hz=planner.model.config.rate_hz).sense()
    found = planner.plan(start=start, goal=wanted[0].percept)
    return planner, found, scene, tuple(each.percept for each in wanted[1:])


def beliefs_in_words(beliefs: Sequence[Any]) -> list[str]:
    """A line for each step of a loop that plans anew."""
    lines = []
    for each in beliefs:
        off = f"sensed {100 * each.doubt:.1f} % and goal {100 * each.unexplained:.1f} % off what staying at the start would be"
        moved = ", something was moved" if each.moved else ""
        lines.append(f"step {each.step}: {number_of(each.steps_left, 'step')} left, {off}, {1000 * each.seconds:.0f} ms{moved}")
    return [*lines, *(f"held where it is: {each.held}" for each in beliefs if each.held)]
