"""The verbs that lead from a trained model to an arm that moves: demo, plan, execute.

What a verb's signature does not need is loaded in its function, so that a word that is off is answered at once.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from tyro.conf import Positional

from preimage.cli.screen import bar, remark
from preimage.compute.choices import Device
from preimage.presets import PlanOptions, Preset, load_planner
from preimage.records import Percept, Plan, number_of
from preimage.storage.bundled import BUNDLED

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
        out: folder for films, figures and report.html.
        as_: paper: the paper's method alone; regression: network and search without memory; full: all ideas. Other options change it.
        config: how the plans are searched for.
    """
    if task not in BUNDLED:
        raise ValueError(f"there is no bundled model of {task}; there are {', '.join(BUNDLED)}")
    from preimage.compute.threads import choose_threads
    from preimage.evaluation import demo as demonstration_of_it_all

    remark(choose_threads())
    with bar() as progress:
        shown = progress.add_task("planning and executing", total=goals)
        report = demonstration_of_it_all.run(task, config, goals=goals, seed=seed, out=out, progress=lambda: progress.advance(shown))
    for line in report.lines:
        print(line)
    print(f"open {report.page}")


def plan_(
    run: Positional[str],
    goal: tuple[str, ...],
    out: Path,
    start: str | None = None,
    goal_joints: tuple[float, ...] | None = None,
    joint_limits: Path | None = None,
    device: Device = "cpu",
    as_: Annotated[Preset, tyro.conf.arg(name="as")] = "full",
    config: Annotated[PlanOptions, tyro.conf.arg(name="")] = PlanOptions.full(),  # noqa: B008, frozen
) -> None:
    """Imagine a way to a goal, or to several in a row.

    Args:
        run: a run folder, the name of a bundled model, or hf:OWNER/NAME of the Hugging Face Hub.
        goal: where the goal comes from: an image file, or DATA:EPISODE or DATA:EPISODE:STEP of a data set;
            of several, each is planned to from where the plan to the one before ends, and the whole is one plan.
        out: folder to write: the plan, a film and a figure of it, and the joints to command as CSV and as a LeRobotDataset.
        start: where the start comes from, likewise; by default the mean start of the demonstrations.
        goal_joints: joint angles of the goal (rad), for --modalities joints or both.
        joint_limits: JSON of what may be commanded, joint by joint: lower, upper, velocity or step; by default what was demonstrated.
        device: what computes; of a small network the CPU has a plan before a GPU has made ready.
        as_: paper: the paper's method alone; regression: network and search without memory; full: all ideas. Other options change it.
        config: how the plan is searched for.
    """
    from preimage.compute.devices import place_of
    from preimage.compute.threads import choose_threads
    from preimage.data.sources import find_percept
    from preimage.ideas.waypoints import join
    from preimage.report import figure, film
    from preimage.robot.limits import commands_of, limits_seen, read_limits
    from preimage.storage.plans import save_episode, save_plan
    from preimage.storage.runs import find_run, read_body, read_shown, read_view

    refuse_useless_joints(goal_joints, num_goals=len(goal), modalities=config.modalities)
    folder = find_run(run)  # once, so that all parts of a run on the Hub are of one revision
    planner, view, body = load_planner(folder, config, device=place_of(device)), read_view(folder), read_body(folder)
    model = planner.model
    limits = limits_seen(model.sensors, read_shown(folder), unit=body.joint_unit)
    if joint_limits:
        limits = read_limits(joint_limits, limits, rate_hz=model.config.rate_hz)
    wanted = [find_percept(each, model.sensors, view=view, default_step=-1) for each in goal]
    goals = [each.percept for each in wanted]
    if goal_joints is not None:
        goals = [Percept(goals[0].frame, np.array(goal_joints))]
    begin = find_percept(start, model.sensors, view=view, default_step=0).percept if start else None
    threads = choose_threads()
    legs = planner.plan_in_turn(start=begin, goals=goals)
    found = join(legs)
    commands, limited = commands_of(found, limits)
    save_plan(found, out, scene=wanted[-1].scene, commands=commands)
    save_episode(found, out / "lerobot", commands=commands, body=body)
    film(found, None, out / "imagined.mp4")
    figure(found, None, out / "imagined.png", joint_unit=body.joint_unit)
    print("\n".join(sentences_of(legs, found, out)))
    print(threads)
    print("\n".join(limited) or "no limit changed the joints to command")


def refuse_useless_joints(goal_joints: tuple[float, ...] | None, *, num_goals: int, modalities: str) -> None:
    """Raises ValueError where joints of the goal were given and nothing would come of them."""
    if goal_joints is None:
        return
    if modalities == "vision":
        raise ValueError("--goal-joints is not looked at while --modalities is vision: give --modalities joints, or both")
    if num_goals != 1:
        raise ValueError(f"--goal-joints are the joints of one goal, and --goal names {num_goals}: plan to one goal, or without joints")


def sentences_of(legs: Sequence[Plan], found: Plan, out: Path) -> list[str]:
    """What there is to say of a plan, and of its legs where there are several."""
    lines = [
        f"goal {number} of {len(legs)}: arrives after {number_of(leg.arrival_step, 'step')}, error {leg.error:.3f}, {leg.stopped.value}"
        for number, leg in enumerate(legs, start=1)
        if len(legs) > 1
    ]
    after = f"step {found.arrival_step} ({found.arrival_step / found.rate_hz:.1f} s)"
    lines.append(f"arrives at {after}, error {found.error:.3f}, planned in {found.seconds:.1f} s, in {out}")
    return [*lines, f"stopped: {found.stopped.value}"]


def execute_(folder: Positional[Path], film_: Annotated[Path | None, tyro.conf.arg(name="film")] = None) -> None:
    """Let the simulated arm execute a plan, and judge where it ends.

    Args:
        folder: what `preimage plan` wrote.
        film_: film to write, .mp4 or .gif, imagined beside executed.
    """
    from preimage.report import film
    from preimage.robot import Arm
    from preimage.robot.execution import execute
    from preimage.storage.plans import load_plan

    found, scene = load_plan(folder)
    if scene is None:
        raise ValueError(f"the plan in {folder} is for a goal without a scene, which nothing can judge: plan with --goal DATA:EPISODE")
    trial = execute(found, Arm(), scene)
    if film_:
        film(found, trial, film_)
    for sentence in trial.limited:
        print(sentence)
    print(f"{'reached' if trial.success else 'missed'}: {100 * trial.deviation_m:.1f} cm from the goal")
