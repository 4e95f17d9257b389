"""The verbs that end in figures: evaluate, reproduce, report, bench.

What a verb's signature does not need is loaded in its function, so that a word that is off is answered at once.
"""

from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from tyro.conf import Positional

from preimage.cli.screen import console, following, known_task, remark, validate_goals, validate_seed
from preimage.cli.trusting import evaluate_trust
from preimage.compute.choices import Device
from preimage.evaluation.loops import Disturbed, Loop
from preimage.presets import Planner, PlanOptions, Preset, ReplanConfig, load_planner
from preimage.storage.atomic_write import write_json
from preimage.storage.output_folders import validate_output_file

if TYPE_CHECKING:
    from preimage.compute.processes import ProcessGroup

MOST_GOALS = 100_000
EVALUATION = {"noun": "evaluation", "marks": (b'"provenance"',)}
BENCH = {"noun": "bench", "marks": (b'"provenance"',)}


def evaluate_(
    run: Positional[str],
    out: Path = Path("evaluation.json"),
    data: Path | None = None,
    episodes: tuple[int, ...] | None = None,
    without_episodes: tuple[int, ...] = (),
    films: Path | None = None,
    task: str = "reach",
    goals: int = 100,
    seed: int = 5000,
    loop: Loop = "closed",
    impossible: bool = False,
    disturb: Disturbed | Literal["all"] | None = None,
    baselines: bool = True,
    device: Device = "auto",
    devices: int = 1,
    replan: Annotated[ReplanConfig, tyro.conf.arg(name="")] = ReplanConfig(),  # noqa: B008, frozen
    as_: Annotated[Preset, tyro.conf.arg(name="as")] = "full",
    config: Annotated[PlanOptions, tyro.conf.arg(name="")] = PlanOptions.full(),  # noqa: B008, frozen
) -> None:
    """Count how often plans to goals that were never shown arrive, beside what luck would give.

    With --data nothing is executed: plans are compared with recordings that were never trained on. That is no success rate.

    Args:
        run: a run folder, the name of a bundled model, or hf:OWNER/NAME of the Hugging Face Hub.
        out: JSON file to write.
        data: recordings to compare with, instead of the simulator; of the data that was trained on, the episodes held out.
        episodes: numbers of the episodes of --data to compare with; by default, of the data that was trained on, those the run was given.
        without_episodes: numbers of episodes to leave out.
        films: folder for a few films, recorded beside imagined; for --data.
        task: name of the task.
        goals: how many goals.
        seed: draws the goals; take another one than the demonstrations were recorded with.
        loop: closed executes the plan blind; open predicts the next joints from what the robot senses; replan plans the rest of the way
            anew at every step; recorded predicts from the demonstration.
        impossible: count instead which goals are refused, twelve impossible kinds among them, and what trust in the others is worth.
        disturb: what goes wrong on the way: the hand is pushed, an encoder is off (bias), the goal or the object is elsewhere, frames
            are missing (camera) or late; all is each of them, and nothing, in each of the loops, from the same plans.
        baselines: whether to execute what luck and memory would give as well.
        device: what computes; auto is a GPU where there is one, or one for each of the devices.
        devices: processes on this machine that share the goals.
        replan: how --loop replan goes about it.
        as_: paper: the paper's method alone; regression: the same, begun near the goal; full: all ideas. Other options change it.
        config: how the plans are searched for.
    """
    from preimage.compute.processes import join_processes
    from preimage.evaluation.recipes import paper_of
    from preimage.storage.runs import find_run, read_shown

    known_task(task)
    validate_goals(goals, most=MOST_GOALS)
    validate_seed(seed)
    validate_output_file(out, **EVALUATION)
    if disturb is not None:
        validate_disturbance(disturb, task, loop)
    if data is None and films is not None:
        raise ValueError("--films shows recorded beside imagined, and there is no recording: give --data too")
    if data is not None:
        which = {"only": episodes, "without": without_episodes}
        return compare_with(data, run, out, films, config, device, devices, **which)
    if impossible:
        return evaluate_trust(run, out, task, goals, seed, device, config)
    group = join_processes(devices=devices, num_nodes=1, device=device)
    if disturb == "all" and group.size > 1:
        raise ValueError(f"--disturb all is one process's work: give --devices 1, not {devices}")
    folder = find_run(run)
    shown = read_shown(folder)
    planner, about = load_to_evaluate(folder, config, group)
    about = {"task": task, "model": run, "preset": as_, "seed": seed, "loop": loop} | about
    about |= {"paper": paper_of(task, about["num_demonstrations"], loop)}
    if disturb or loop == "replan":
        about |= {"disturb": disturb, "replan": asdict(replan)}
    if disturb == "all":
        return side_by_side(planner, about, out, goals=goals, seed=seed, replan=replan)
    how = {"loop": loop, "disturb": disturb, "replan": replan, "with_baselines": baselines, "shown": shown}
    return count_reached(planner, about, out, group, goals=goals, seed=seed, **how)


def load_to_evaluate(folder: Path, config: PlanOptions, group: "ProcessGroup") -> tuple[Planner, dict[str, Any]]:
    """The planner of a run, and what a result says of it."""
    from preimage.compute.precision import describe_precision
    from preimage.compute.threads import choose_threads
    from preimage.storage.provenance import provenance
    from preimage.storage.runs import made_from

    planner = load_planner(folder, config, device=group.device)
    remark(describe_precision(config.precision, group.device))
    if group.size == 1:
        remark(choose_threads())
    plan = {"pixels": planner.model.sensors.height, "plan": asdict(planner.options)}
    return planner, made_from(folder) | plan | {"provenance": provenance(group.device)}


def count_reached(planner: Planner, about: dict[str, Any], out: Path, group: "ProcessGroup", *, goals: int, **how: Any) -> None:
    """The part of `evaluate` that counts, in one loop; the result is written by the first process."""
    from preimage.evaluation.evaluate import Evaluated, evaluate, result_of
    from preimage.robot import TASKS, Arm, with_frames

    task = with_frames(TASKS[about["task"]], about["pixels"])
    with following("evaluating", total=len(group.share(goals)), shown=group.first) as follow:
        reached: list[bool] = []

        def tell(one: Evaluated) -> None:
            reached.append(one.trial.success)
            follow(done=len(reached), text=f"{sum(reached)}/{len(reached)} reached")

        evaluated = evaluate(planner, Arm(), task, goals=goals, **how, progress=tell, group=group)
    if not group.first:
        return
    result = result_of(evaluated, about)
    write_json(out, result)
    print(summary("preimage", result))
    for name, baseline in result["baselines"].items():
        print(summary(name, baseline))


def validate_disturbance(disturb: str, task: str, loop: Loop) -> None:
    """Raises ValueError where nothing of the kind can happen in a task or a loop."""
    import numpy as np

    from preimage.robot import TASKS
    from preimage.robot.disturbances import disturbance_of

    if loop == "recorded":
        raise ValueError("--loop recorded plays what was recorded, where nothing can go wrong: give closed, open or replan")
    if disturb != "all":
        scene = TASKS[task].sample(np.random.default_rng(0))
        disturbance_of(disturb, scene, half=1, grasp=1, seed=(0,), other=scene)


def side_by_side(planner: Planner, about: dict[str, Any], out: Path, **how: Any) -> None:
    """The part of `evaluate` that lets everything go wrong in every loop; the counts so far are written after each goal."""
    from preimage.evaluation.disturbed import cells_of, try_all
    from preimage.robot import TASKS, Arm, with_frames

    task = with_frames(TASKS[about["task"]], about["pixels"])
    about = {name: value for name, value in about.items() if name not in ("loop", "paper")}
    with following("evaluating", total=how["goals"]) as follow:

        def tell(tried: Any) -> None:
            write_json(out, about | {"cells": cells_of(tried)})
            follow(done=min(map(len, tried.values())))

        tried = try_all(planner, Arm(), task, **how, progress=tell)
    for cell in cells_of(tried):
        name = f"{cell['loop']} {cell['disturb'] or 'nothing'}"
        print(summary(name if cell["window"] is None else f"{name} {cell['window']}", cell))


def compare_with(
    data: Path, run: str, out: Path, films: Path | None, options: PlanOptions, device: Device, devices: int, **which: Any
) -> None:
    """The part of `evaluate` that needs no simulator."""
    from preimage.compute.processes import join_processes
    from preimage.compute.threads import choose_threads
    from preimage.evaluation.held_out import compare_run

    group = join_processes(devices=devices, num_nodes=1, device=device)
    if group.size == 1:
        remark(choose_threads())
    with following("planning", shown=group.first) as follow:

        def tell(done: int, of_all: int) -> None:
            follow(done=done, total=of_all)

        lines = compare_run(run, data, out=out, film_folder=films, options=options, progress=tell, group=group, **which)
    if group.first:
        print("\n".join(lines))


def reproduce_(
    table: Positional[Literal["table-2", "two-points", "table-3", "two-circles", "all", "ablation"]],
    size: Literal["tiny", "small", "paper"] = "small",
    as_: Annotated[Preset, tyro.conf.arg(name="as")] = "full",
    seeds: int = 3,
    demonstrations: tuple[int, ...] = (100, 50, 25),
    tasks: tuple[str, ...] = (),
    goals: int | None = None,
    bundled: bool = False,
    device: Device = "auto",
    work: Path = Path("runs/reproduce"),
    out: Path = Path("results"),
) -> None:
    """Get the paper's numbers again, cell by cell; what was stopped goes on where it was.

    Args:
        table: which of the paper's tables, or all; ablation: what each idea brings, by all presets.
        size: of the network.
        as_: paper: the paper's method alone; regression: the same, begun near the goal; full: all ideas.
        seeds: how many of the three training seeds.
        demonstrations: which numbers of demonstrations.
        tasks: which tasks; by default all of the table.
        goals: test goals a cell; by default as many as the paper's.
        bundled: let the bundled models plan, of the ablation what needs no training.
        device: what computes; auto is a GPU where there is one.
        work: folder for demonstrations and runs.
        out: folder for a JSON file a cell.
    """
    from preimage.compute.devices import torch_device
    from preimage.evaluation.ablation import ablate
    from preimage.evaluation.experiments import reproduce
    from preimage.evaluation.recipes import cells_of
    from preimage.method.learner import Progress as Told
    from preimage.storage.bundled import BUNDLED

    if bundled and table != "ablation":
        raise ValueError(
            f"--bundled is for the ablation alone, and this is {table}: `preimage evaluate` counts what a bundled model reaches"
        )
    with following("training") as follow:

        def learn(told: Told) -> None:
            follow(done=told.update, total=told.updates)

        def tell(text: str) -> None:
            console.print(text, highlight=False, soft_wrap=True)

        cells = [replace(cell, preset=as_, goals=goals) for cell in cells_of(table, size)]
        chosen = [cell for cell in cells if cell.seed < seeds and cell.num_demonstrations in demonstrations]
        chosen = [cell for cell in chosen if not tasks or cell.task in tasks]
        if bundled:
            chosen = [replace(cell, bundled=True) for cell in chosen if cell.task in BUNDLED and cell.num_demonstrations == 100]
        run = ablate if table == "ablation" else reproduce
        run(chosen, place=torch_device(device), work=work, out=out, tell=tell, progress=learn)
    print(f"{len(chosen)} cells are in {out}; `preimage report` makes the page of them")


def report_(results: Path = Path("results"), out: Path = Path("docs/results.md"), readme: Path = Path("README.md")) -> None:
    """Write the page of results from the JSON files, and the table in the README.

    Args:
        results: folder of the JSON files.
        out: page to write.
        readme: file whose table stands between two marks; without marks it is left alone.
    """
    from preimage.report.results import fill_readme, write_results

    validate_output_file(out, "page of results", marks=(b"`preimage report`",))
    print(f"wrote {write_results(results, out)}")
    fill_readme(results, readme)


def bench_(out: Path = Path("results/bench.json"), device: Device = "cpu", quick: bool = False) -> None:
    """Measure speed beside the machine's own limit.

    Args:
        out: JSON file to write.
        device: what to measure.
        quick: a minute instead of five, without the paper's size and the growth of planning time.
    """
    from preimage.compute.devices import torch_device
    from preimage.evaluation.bench import bench
    from preimage.storage.provenance import provenance

    validate_output_file(out, **BENCH)
    place = torch_device(device)
    write_json(out, bench(place, quick=quick) | {"provenance": provenance(place)})
    print(f"wrote {out}; `preimage report` draws it")


def summary(name: str, counted: dict[str, Any]) -> str:
    low, high = counted["interval"]
    rate = f"{counted['success']}/{counted['goals']} reached (95 % interval {100 * low:.0f} to {100 * high:.0f} %)"
    return f"{name:22s} {rate}, {counted['deviation_cm']['mean']:.2f} cm off on average"
