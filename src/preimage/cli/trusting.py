"""The verb that makes plans say how likely they succeed: calibrate; and the part of evaluate that examines what they say."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import tyro
from tyro.conf import Positional

from preimage.cli.screen import counted, following, known_task, remark, validate_goals, validate_seed
from preimage.compute.choices import Device
from preimage.presets import PlanOptions, Preset, load_planner
from preimage.storage.atomic_write import write_json
from preimage.storage.run_files import CALIBRATION

MOST_GOALS = 10_000
FEWEST_GOALS = 12
"""Goals of the area; of fewer, those that set the limit could not promise to refuse less than a tenth of possible goals."""
GOALS_A_PICTURE = 10
"""Impossible pictures are many times as slow to plan to, for no search ends: of each kind there is one for so many goals."""


def calibrate_(
    run: Positional[str],
    goals: int = 80,
    seed: int = 600,
    task: str | None = None,
    data: Path | None = None,
    device: Device = "cpu",
    as_: Annotated[Preset, tyro.conf.arg(name="as")] = "full",
    config: Annotated[PlanOptions, tyro.conf.arg(name="")] = PlanOptions.full(),  # noqa: B008, frozen
) -> None:
    """Learn from goals of known outcome how likely a run's plans succeed, and which goals to refuse; it is kept with the run.

    Args:
        run: a run folder, or the name of a bundled model.
        goals: how many the simulator draws as the demonstrations were; as many lie beyond, a quarter as many are impossible pictures.
        seed: draws the goals; take another one than the demonstrations were recorded with, and than is evaluated with.
        task: name of the task; by default the one that the run was trained on.
        data: recordings instead of the simulator, those of them that were never trained on: a plan succeeds that ends in their joints.
        device: what computes.
        as_: paper: the paper's method alone; regression: the same, begun near the goal; full: all ideas. Other options change it.
        config: how plans are searched for; a calibration holds for no other options.
    """
    from preimage.compute.devices import torch_device
    from preimage.compute.precision import describe_precision
    from preimage.compute.threads import choose_threads
    from preimage.evaluation.trust import PRACTICE_SHARE, calibrate, calibrate_by_recordings
    from preimage.robot import TASKS, Arm, with_frames
    from preimage.storage.runs import find_run, read_config

    validate_goals(goals, fewest=FEWEST_GOALS, most=MOST_GOALS)
    validate_seed(seed)
    folder = find_run(run)
    task = task or read_config(folder).get("task")
    if data is None:
        known_task(str(task))
    recorded = never_trained_on(folder, data) if data else []
    planner = load_planner(folder, config, device=torch_device(device))
    remark(describe_precision(config.precision, planner.model.home_pixels.device))
    remark(choose_threads())
    num_possible = len(recorded) if data else 2 * goals
    with following("calibrating", total=num_possible + (len(recorded) or goals) // PRACTICE_SHARE) as follow:
        tell = counted(follow)
        if data:
            calibration = calibrate_by_recordings(planner, recorded, seed=seed, progress=tell)
        else:
            filmed = with_frames(TASKS[str(task)], planner.model.sensors.height)
            calibration = calibrate(planner, Arm(), filmed, goals=goals, seed=seed, progress=tell)
    write_json(folder / CALIBRATION, asdict(calibration))
    print(calibration.note)
    print(f"wrote {folder / CALIBRATION}")


def never_trained_on(folder: Path, data: Path) -> list[Any]:
    """The recordings of a data set that a run was not trained on.

    Raises:
        ValueError: there are too few.
    """
    from preimage.data.dataset import open_recordings
    from preimage.evaluation.held_out import never_shown
    from preimage.storage.runs import read_shown, read_view

    recorded = open_recordings(data, view=read_view(folder)).demonstrations
    unseen = [recorded[place] for place in never_shown(recorded, read_shown(folder))]
    if len(unseen) < FEWEST_GOALS:
        raise ValueError(
            f"{data} has {len(unseen)} recordings that {folder} was not trained on: {FEWEST_GOALS} are needed; train with --hold-out 4"
        )
    return unseen


def evaluate_trust(run: str, out: Path, task: str, goals: int, seed: int, device: Device, options: PlanOptions) -> None:
    """The part of `evaluate` that counts which goals are refused, rightly and wrongly."""
    from preimage.compute.devices import torch_device
    from preimage.compute.threads import choose_threads
    from preimage.evaluation.trust import examine, result_of_trust
    from preimage.robot import TASKS, Arm, with_frames
    from preimage.storage.provenance import provenance
    from preimage.storage.runs import find_run, made_from, read_shown

    folder = find_run(run)
    place = torch_device(device)
    planner = load_planner(folder, options, device=place)
    if planner.assessment.calibration is None:
        raise ValueError(f"{run} is not calibrated for plans with these options: run `preimage calibrate {run}` with the same ones first")
    remark(choose_threads())
    about = {"task": task, "model": run, "seed": seed, "num_calibrated_by": planner.assessment.calibration.num_goals} | made_from(folder)
    with following("evaluating") as follow:
        tell = counted(follow)
        filmed = with_frames(TASKS[task], planner.model.sensors.height)
        pictures = max(1, goals // GOALS_A_PICTURE)
        assessed = examine(planner, Arm(), filmed, goals=goals, pictures=pictures, seed=seed, progress=tell)
    result = result_of_trust(assessed, read_shown(folder), about | {"plan": asdict(planner.options), "provenance": provenance(place)})
    write_json(out, result)
    print("\n".join(lines_of(result)))


def lines_of(result: dict[str, Any]) -> list[str]:
    """What there is to say of an examination of trust."""

    def of_refused(one: dict[str, Any]) -> str:
        low, high = one["interval"]
        return f"{one['refused']}/{one['goals']} refused (95 % interval {100 * low:.0f} to {100 * high:.0f} %)"

    lines = [
        f"{'possible goals':22s} {of_refused(result['falsely_refused'])}",
        f"{'goals on the rim':22s} {of_refused(result['refused_on_rim'])}",
    ]
    lines += [f"{kind:22s} {of_refused(one)}" for kind, one in result["refused"].items()]
    lines += [f"area under the ROC, by {name}: {area:.3f}" for name, area in result["roc_area"].items()]
    error, by_chance = result["calibration_error"], result["calibration_error_by_chance"]
    return [*lines, f"expected calibration error {error:.3f} ({by_chance:.3f} by chance alone, with so few goals)"]
