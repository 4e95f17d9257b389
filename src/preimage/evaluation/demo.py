"""The bundled model at work: plans to goals it never saw, executed, filmed and counted."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from preimage.evaluation.evaluate import Evaluated, evaluate, result_of
from preimage.presets import PlanOptions, load_planner
from preimage.records import number_of
from preimage.report.figures import figure
from preimage.report.films import film
from preimage.report.pages import Case, page
from preimage.robot import TASKS, Arm
from preimage.storage.atomic_write import write_json
from preimage.storage.runs import find_run, made_from, read_shown


@dataclass(frozen=True)
class Report:
    """Where the page is, and a line about each goal."""

    page: Path
    lines: tuple[str, ...]


def run(name: str, options: PlanOptions, *, goals: int, seed: int, out: Path, progress: Callable[[], None]) -> Report:
    """Plan with a bundled model, execute, and write films, figures, result.json and report.html into `out`."""
    folder = find_run(name)
    planner, arm, task = load_planner(folder, options), Arm(), TASKS[name]
    cases: list[Case] = []
    lines: list[str] = []

    def show(one: Evaluated) -> None:
        case = show_case(len(cases), one, out)
        cases.append(case)
        verdict = "reached" if case.success else "missed"
        took = f"planned in {one.plan.seconds:.1f} s, error {one.plan.error:.2f}"
        lines.append(f"{case.name}: {verdict}, {100 * case.deviation_m:.1f} cm off, {took}, film {case.film}")
        progress()

    evaluated = evaluate(planner, arm, task, goals=goals, seed=seed, shown=read_shown(folder), progress=show)
    about = {"task": name, "model": name, "seed": seed, "loop": "closed"} | made_from(folder)
    result = result_of(evaluated, about)
    write_json(out / "result.json", result)
    written = page(result, cases, out / "report.html", title=f"preimage: {name}")
    verdict = f"{result['success']} of {number_of(result['goals'], 'goal')} reached"
    return Report(written, (*lines, verdict))


def show_case(index: int, one: Evaluated, out: Path) -> Case:
    """Film and figure of one goal."""
    name = f"goal-{index + 1}"
    return Case(
        name=name.replace("-", " "),
        film=film(one.plan, one.trial, out / f"{name}.mp4"),
        figure=figure(one.plan, one.trial, out / f"{name}.png"),
        deviation_m=one.trial.deviation_m,
        success=one.trial.success,
    )
