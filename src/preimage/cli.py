"""The verbs of the command line. Exit codes: 0 done, 1 the work failed or was interrupted, 2 the words are off."""

import sys
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import torch
import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from tyro.conf import Positional

from preimage import demo as demonstration_of_it_all
from preimage.bench import bench
from preimage.check import check
from preimage.dataset import fingerprint, open_recordings, save
from preimage.evaluation import Evaluated, Loop, evaluate, result_of
from preimage.execution import execute
from preimage.experiments import SIZES, cells_of, paper_of, reproduce
from preimage.held_out import compare_run, every_nth
from preimage.limits import commands_of, limits_seen, read_limits
from preimage.model import ModelConfig
from preimage.options import refuse_out_of_range
from preimage.planning import PlanConfig, join, plan_in_turn
from preimage.plans import load_plan, save_episode, save_plan
from preimage.provenance import provenance
from preimage.records import Percept
from preimage.report import figure, fill_readme, film, learning_curve, write_results
from preimage.robot import TASKS, Arm, record
from preimage.runs import BUNDLED, find_run, load_model, made_from, read_config, read_settings, read_shown, read_view, write_card
from preimage.sources import find_percept
from preimage.training import NonFinite, TrainConfig, train
from preimage.training import Progress as Told
from preimage.view import View
from preimage.whole_file import write_json

console = Console(stderr=True)


def bar() -> Progress:
    """A progress bar with the time left; in a log, where it could not move, there is none."""
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn()
    return Progress(*columns, console=console, disable=not console.is_terminal)


def demo(task: str = "reach", goals: int = 5, seed: int = 7, out: Path = Path("demo")) -> None:
    """Let the bundled model plan to goals it never saw, execute the plans, and show films and a report.

    Args:
        task: which of the bundled models: reach or move-object.
        goals: how many goals.
        seed: draws the goals.
        out: folder for films, figures and report.html.
    """
    if task not in BUNDLED:
        raise ValueError(f"there is no bundled model of {task}; there are {', '.join(BUNDLED)}")
    with bar() as progress:
        shown = progress.add_task("planning and executing", total=goals)
        report = demonstration_of_it_all.run(task, goals=goals, seed=seed, out=out, progress=lambda: progress.advance(shown))
    for line in report.lines:
        print(line)
    print(f"open {report.page}")


def record_(task: Positional[str], count: int, out: Path, seed: int = 0) -> None:
    """Record demonstrations of a task on the simulated arm, as a LeRobotDataset v3.0.

    Args:
        task: name of the task.
        count: how many demonstrations.
        out: folder to write, new or empty.
        seed: draws the scenes and the tutor's hand.
    """
    known_task(task)
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise ValueError(f"{out} is there already: give a new folder")
    with bar() as progress:
        shown = progress.add_task("recording", total=count)
        demonstrations = record(Arm(), TASKS[task], count=count, seed=seed, progress=lambda _done, _all: progress.advance(shown))
    save(demonstrations, out, task=task)
    steps = sum(map(len, demonstrations))
    print(f"{count} demonstrations, {steps} steps at {TASKS[task].rate_hz:g} Hz, in {out}")


def train_(
    data: Positional[Path],
    out: Path,
    size: Literal["tiny", "small", "paper"] = "small",
    resume: bool = False,
    hold_out: int = 0,
    rate_hz: float | None = None,
    intention_dimensions: int | None = None,
    intention_cost: float | None = None,
    intention_layers: tuple[str, ...] | None = None,
    view: View = View(),  # noqa: B008, frozen
    config: Annotated[TrainConfig, tyro.conf.arg(name="")] = TrainConfig(),  # noqa: B008, frozen
) -> None:
    """Train a network on the demonstrations of a data set.

    Args:
        data: a LeRobotDataset, v3.0 or v2.1, or a folder of pictures and tables of joints.
        out: run folder to write.
        size: tiny learns nothing worth seeing, small takes minutes on two cores, paper is Table I.
        resume: go on with the run in `out`, with the sizes, settings and held-out episodes it was started with.
        hold_out: every Nth episode is not trained on but kept for `preimage evaluate --data`; 0 trains on all.
        rate_hz: steps a second that the model runs at, instead of the size's own.
        intention_dimensions: numbers that make an intention, instead of the size's own.
        intention_cost: charge for what an intention tells, instead of the size's own: 0.2 where most can be seen at the start.
        intention_layers: layers whose initial states are the intention, instead of the size's own: top where most can be seen.
        view: how the recordings are looked at.
        config: how the network learns.
    """
    refuse_out_of_range(config)
    opened = open_recordings(data, view=read_view(out) if resume else view)
    recorded, lines = opened.demonstrations, list(opened.told)
    learned_from = {"name": data.name, "fingerprint": fingerprint(recorded), "held_out": every_nth(len(recorded), hold_out)}
    asked = {"rate_hz": rate_hz, "intention_dimensions": intention_dimensions}
    asked |= {"intention_cost": intention_cost, "intention_layers": intention_layers}
    model_config = replace(SIZES[size](), **{name: value for name, value in asked.items() if value is not None})
    refuse_out_of_range(model_config)
    if resume:
        started = read_config(find_run(out)).get("data")
        if not isinstance(started, dict) or started.get("fingerprint") != learned_from["fingerprint"]:
            raise ValueError(f"{out} was trained on other demonstrations than those in {data}: resume with the same data")
        learned_from = started
        model_config, config = read_settings(ModelConfig, out, "model"), read_settings(TrainConfig, out, "train")
    held_out = learned_from.get("held_out", [])
    demonstrations = [one for episode, one in enumerate(recorded) if episode not in held_out]
    with bar() as progress:
        shown = progress.add_task("training", total=config.updates)

        def tell(told: Told) -> None:
            while lines:  # now that nothing is refused any more, and what is printed is not beside the point
                print(lines.pop(0))
            errors = f"training  vision {told.visual:8.2f}  joints {told.proprioceptive:.4f}"
            progress.update(shown, completed=told.update, description=errors)

        about = {"size": size, "num_demonstrations": len(demonstrations), "data": learned_from, "view": asdict(opened.view)}
        about |= {"task": task_of(demonstrations), "provenance": provenance()}
        train(demonstrations, model_config, config=config, folder=out, resume=resume, about=about, progress=tell)
    learning_curve(out / "log.jsonl", out / "learning_curve.png")
    write_card(out)
    left_out = f", {len(held_out)} held out" if held_out else ""
    print(f"trained on {len(demonstrations)} demonstrations{left_out}; the run is in {out}")


def plan_(
    run: Positional[str],
    goal: tuple[str, ...],
    out: Path,
    start: str | None = None,
    goal_joints: tuple[float, ...] | None = None,
    joint_limits: Path | None = None,
    config: Annotated[PlanConfig, tyro.conf.arg(name="")] = PlanConfig(),  # noqa: B008, frozen
) -> None:
    """Imagine a way to a goal, or to several in a row.

    Args:
        run: a run folder, or the name of a bundled model.
        goal: where the goal comes from: an image file, or DATA:EPISODE or DATA:EPISODE:STEP of a data set;
            of several, each is planned to from where the plan to the one before ends, and the whole is one plan.
        out: folder to write: the plan, a film and a figure of it, and the joints to command as CSV and as a LeRobotDataset.
        start: where the start comes from, likewise; by default the mean start of the demonstrations.
        goal_joints: joint angles of the goal (rad), for --modalities joints or both.
        joint_limits: JSON of what may be commanded, joint by joint: lower, upper, velocity or step; by default what was demonstrated.
        config: how the plan is searched for.
    """
    refuse_out_of_range(config)
    if goal_joints is not None and config.modalities == "vision":
        raise ValueError("--goal-joints is not looked at while --modalities is vision: give --modalities joints, or both")
    if goal_joints is not None and len(goal) != 1:
        raise ValueError(f"--goal-joints are the joints of one goal, and --goal names {len(goal)}: plan to one goal, or without joints")
    model, view = load_model(run), read_view(run)
    limits = limits_seen(model.sensors, read_shown(find_run(run)))
    if joint_limits:
        limits = read_limits(joint_limits, limits, rate_hz=model.config.rate_hz)
    wanted = [find_percept(each, model.sensors, view=view, default_step=-1) for each in goal]
    goals = [each.percept for each in wanted]
    if goal_joints is not None:
        goals = [Percept(goals[0].frame, torch.tensor(goal_joints).double().numpy())]
    begin = find_percept(start, model.sensors, view=view, default_step=0).percept if start else None
    legs = plan_in_turn(model, start=begin, goals=goals, config=config)
    found = join(legs)
    commands, limited = commands_of(found, limits)
    save_plan(found, out, scene=wanted[-1].scene, commands=commands)
    save_episode(found, out / "lerobot", commands=commands)
    film(found, None, out / "imagined.mp4")
    figure(found, None, out / "imagined.png")
    if len(legs) > 1:
        for number, leg in enumerate(legs, start=1):
            print(f"goal {number} of {len(legs)}: arrives after {leg.arrival_step} steps, error {leg.error:.3f}, {leg.stopped.value}")
    seconds = found.arrival_step / found.rate_hz
    print(f"arrives at step {found.arrival_step} ({seconds:.1f} s), error {found.error:.3f}, planned in {found.seconds:.1f} s, in {out}")
    print(f"stopped: {found.stopped.value}")
    print("\n".join(limited) or "no limit changed the joints to command")


def execute_(folder: Positional[Path], film_: Annotated[Path | None, tyro.conf.arg(name="film")] = None) -> None:
    """Let the simulated arm execute a plan, and judge where it ends.

    Args:
        folder: what `preimage plan` wrote.
        film_: film to write, .mp4 or .gif, imagined beside executed.
    """
    found, scene = load_plan(folder)
    if scene is None:
        raise ValueError(f"the plan in {folder} is for a goal without a scene, which nothing can judge: plan with --goal DATA:EPISODE")
    trial = execute(found, Arm(), scene)
    if film_:
        film(found, trial, film_)
    for sentence in trial.limited:
        print(sentence)
    print(f"{'reached' if trial.success else 'missed'}: {100 * trial.deviation_m:.1f} cm from the goal")


def evaluate_(
    run: Positional[str],
    out: Path = Path("evaluation.json"),
    data: Path | None = None,
    films: Path | None = None,
    task: str = "reach",
    goals: int = 100,
    seed: int = 5000,
    loop: Loop = "closed",
    config: Annotated[PlanConfig, tyro.conf.arg(name="")] = PlanConfig(),  # noqa: B008, frozen
) -> None:
    """Count how often plans to goals that were never shown arrive, beside what luck would give.

    With --data nothing is executed: plans are compared with recordings that were never trained on. That is no success rate.

    Args:
        run: a run folder, or the name of a bundled model.
        out: JSON file to write.
        data: recordings to compare with, instead of the simulator; of the data that was trained on, the episodes held out.
        films: folder for a few films, recorded beside imagined; for --data.
        task: name of the task.
        goals: how many goals.
        seed: draws the goals; take another one than the demonstrations were recorded with.
        loop: closed executes the plan blind; open predicts the next joints from what the robot senses; recorded, from what the tutor saw.
        config: how the plans are searched for.
    """
    known_task(task)
    refuse_out_of_range(config)
    if data is not None:
        return compare_with(data, run, out, films, config)
    if films is not None:
        raise ValueError("--films shows recorded beside imagined, and there is no recording: give --data too")
    model, folder = load_model(run), find_run(run)
    made = made_from(folder)
    about = {"task": task, "model": run} | made
    about |= {"seed": seed, "loop": loop, "paper": paper_of(task, made["num_demonstrations"], loop)}
    about |= {"plan": asdict(config), "provenance": provenance()}
    with bar() as progress:
        shown = progress.add_task("evaluating", total=goals)
        reached: list[bool] = []

        def tell(one: Evaluated) -> None:
            reached.append(one.trial.success)
            so_far = f"evaluating  {sum(reached)}/{len(reached)} reached"
            progress.update(shown, completed=len(reached), description=so_far)
            if not console.is_terminal and len(reached) % 10 == 0:
                print(f"{so_far}, {goals - len(reached)} goals left", file=sys.stderr, flush=True)

        shown_before = read_shown(folder)
        evaluated = evaluate(model, Arm(), TASKS[task], goals=goals, seed=seed, shown=shown_before, config=config, loop=loop, progress=tell)
    result = result_of(evaluated, about)
    write_json(out, result)
    print(summary("preimage", result))
    for name, baseline in result["baselines"].items():
        print(summary(name, baseline))


def compare_with(data: Path, run: str, out: Path, films: Path | None, config: PlanConfig) -> None:
    """The part of `evaluate` that needs no simulator."""
    with bar() as progress:
        shown = progress.add_task("planning", total=None)

        def tell(done: int, of_all: int) -> None:
            progress.update(shown, completed=done, total=of_all)

        lines = compare_run(run, data, out=out, film_folder=films, config=config, progress=tell)
    print("\n".join(lines))


def reproduce_(
    table: Positional[Literal["table-2", "two-points", "table-3", "two-circles", "all"]],
    size: Literal["tiny", "small", "paper"] = "small",
    seeds: int = 3,
    demonstrations: tuple[int, ...] = (100, 50, 25),
    work: Path = Path("runs/reproduce"),
    out: Path = Path("results"),
) -> None:
    """Get the paper's numbers again, cell by cell; what was stopped goes on where it was.

    Args:
        table: which of the paper's tables, or all.
        size: of the network.
        seeds: how many of the three training seeds.
        demonstrations: which numbers of demonstrations.
        work: folder for demonstrations and runs.
        out: folder for a JSON file a cell.
    """
    with bar() as progress:
        shown = progress.add_task("training", total=None)

        def learn(told: Told) -> None:
            progress.update(shown, completed=told.update, total=told.updates)

        def tell(text: str) -> None:
            progress.update(shown, description=text)
            if not console.is_terminal:
                print(text, file=sys.stderr, flush=True)

        chosen = [cell for cell in cells_of(table, size) if cell.seed < seeds and cell.num_demonstrations in demonstrations]
        reproduce(chosen, work=work, out=out, tell=tell, progress=learn)
    print(f"{len(chosen)} cells are in {out}; `preimage report` makes the page of them")


def report_(results: Path = Path("results"), out: Path = Path("docs/results.md"), readme: Path = Path("README.md")) -> None:
    """Write the page of results from the JSON files, and the table in the README.

    Args:
        results: folder of the JSON files.
        out: page to write.
        readme: file whose table stands between two marks; without marks it is left alone.
    """
    print(f"wrote {write_results(results, out)}")
    fill_readme(results, readme)


def bench_(out: Path = Path("results/bench.json"), device: Literal["cpu", "cuda"] = "cpu", quick: bool = False) -> None:
    """Measure speed beside the machine's own limit.

    Args:
        out: JSON file to write.
        device: what to measure.
        quick: leave out the paper's size and the growth of planning time.
    """
    if device == "cuda" and not torch.cuda.is_available():
        raise ValueError("--device is cuda, and there is none on this machine: give cpu")
    write_json(out, bench(device=device, quick=quick) | {"provenance": provenance()})
    print(f"wrote {out}; `preimage report` draws it")


def summary(name: str, counted: dict[str, Any]) -> str:
    low, high = counted["interval"]
    rate = f"{counted['success']}/{counted['goals']} reached (95 % interval {100 * low:.0f} to {100 * high:.0f} %)"
    return f"{name:22s} {rate}, {counted['deviation_cm']['mean']:.2f} cm off on average"


def known_task(task: str) -> None:
    if task not in TASKS:
        raise ValueError(f"{task} is no task; known are {', '.join(TASKS)}")


def task_of(demonstrations: list) -> str | None:
    scene = demonstrations[0].scene
    return scene.task if scene else None


VERBS: dict[str, Callable[..., None]] = {
    "demo": demo,
    "record": record_,
    "check": check,
    "train": train_,
    "plan": plan_,
    "execute": execute_,
    "evaluate": evaluate_,
    "reproduce": reproduce_,
    "report": report_,
    "bench": bench_,
}


def main(arguments: list[str] | None = None) -> None:
    """Run one verb; whatever a user can cause ends in one sentence and an exit code."""
    description = "Learn from demonstrations; give a goal image; see the way imagined before the robot moves."
    try:
        tyro.extras.subcommand_cli_from_dict(VERBS, prog="preimage", description=description, args=arguments)
    except ValueError as error:
        fail(str(error), code=2)
    except NonFinite as error:
        fail(str(error), code=1)
    except FileExistsError as error:
        fail(f"{error.filename} is there already and is no folder: give another place", code=1)
    except OSError as error:
        fail(f"{error.filename}: {error.strerror}" if error.filename else error.strerror or str(error), code=1)
    except KeyboardInterrupt:
        fail("interrupted; what was saved is kept", code=1)


def fail(sentence: str, *, code: int) -> None:
    print(f"preimage: {sentence}", file=sys.stderr)
    raise SystemExit(code)
