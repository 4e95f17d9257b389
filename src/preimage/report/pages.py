"""One page about an evaluation: the count and its interval, the baselines beside it, cases to look at, every goal.

The page is one HTML file that opens from disk without a network. Films and figures stay files of their own; the page names them
relative to its folder, so that a folder that holds all of them can be moved or sent as a whole.
"""

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import quote

from preimage.records import number_of
from preimage.storage.atomic_write import atomic_write

SUCCESS_MEANS = {
    "reach": "the hand ends within 4 cm of the goal position",
    "two-points": "the hand touches the marker and then ends within 4 cm of the goal position",
    "move-object": "the object was lifted and stands upright and released inside the circle",
    "two-circles": "the object was lifted and stands upright and released inside the circle that the goal frame shows it in",
}

_REQUIRED = ("task", "goals", "success", "interval", "deviation_cm", "rows", "baselines")
_BASELINES: dict[str, str] = {
    "nearest_demonstration": "nearest demonstration: replay the one whose last frame is most like the goal",
    "memory_alone": "memory alone: straight through the joints expected where a gripper switches and at the goal, nothing imagined",
    "prior_mean": "no goal: the same model, its intention at the prior mean",
    "do_nothing": "do nothing: the arm stays where it starts",
}
_COMPARED = ("reached", "share of goals", "95 % interval", "deviation (cm): mean", "median", "max")
_GOAL = ("deviation (cm)", "outcome", "arrival step", "prediction error", "seconds")
_LOOPS = {"closed": "plans executed without looking again", "open": "plans corrected step by step by what is sensed"}


@dataclass(frozen=True)
class Case:
    """One goal to look at on the page, reached or missed."""

    name: str
    film: Path
    """An `.mp4` or `.gif` that `film` wrote."""
    figure: Path
    """A `.png` that `figure` wrote."""
    deviation_m: float
    success: bool


def page(
    results: Mapping[str, Any],
    cases: Sequence[Case],
    path: str | os.PathLike[str],
    *,
    title: str,
    success_means: str | None = None,
) -> Path:
    """Writes the HTML report of an evaluation.

    Args:
        results: what `preimage evaluate` writes as JSON.
        cases: shown in this order, failures marked.
        success_means: ends the sentence "A goal counts as reached when ...", in plain words and without a full stop; not needed for the
            paper's tasks.

    Raises:
        ValueError: `results` lacks one of the entries of an evaluation.
    """
    lacking = [name for name in _REQUIRED if name not in results]
    if lacking:
        raise ValueError(f"results has no {', '.join(lacking)}; give the JSON that `preimage evaluate` writes")
    path = Path(path)
    body = [
        f"<h1>{escape(title)}</h1>",
        _facts(results),
        _headline(results),
        _explanation(success_means or SUCCESS_MEANS.get(results["task"], "the judge of its task says so")),
        _comparison(results),
        _cases(cases, path.parent),
        _all_goals(results["rows"]),
    ]
    with atomic_write(path) as unfinished:
        unfinished.write_text(document(title, "\n".join(body)), encoding="utf-8")
    return path


def document(title: str, body: str) -> str:
    """A page that opens without a network: the design of all pages, which the studio has too, and the report's own, lie in it."""
    style = "".join(files("preimage.report").joinpath(name).read_text(encoding="utf-8") for name in ("design.css", "page.css"))
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{escape(title)}</title>\n<style>\n{style}</style>\n</head>\n<body>\n<main>\n{body}\n</main>\n</body>\n</html>\n"
    )


def _facts(results: Mapping[str, Any]) -> str:
    """The line under the title: what was evaluated, as far as the results say."""
    known = {name: results[name] for name in ("model", "size", "num_demonstrations", "seed") if results.get(name) is not None}
    facts = [f"task {results['task']}"]
    facts += [number_of(value, "demonstration") if name == "num_demonstrations" else f"{name} {value}" for name, value in known.items()]
    if results.get("loop") in _LOOPS:
        facts.append(f"{results['loop']} loop: {_LOOPS[results['loop']]}")
    if results.get("seconds_per_plan") is not None:
        facts.append(f"{_number(results['seconds_per_plan'], 1)} s a plan")
    return f'<p class="facts">{escape(" · ".join(facts))}</p>'


def _headline(results: Mapping[str, Any]) -> str:
    k, n = results["success"], results["goals"]
    return (
        f'<div class="headline"><strong>{k}/{n}</strong> goals reached '
        f"<span>{_percent(k / n)}, Wilson 95 % interval {_interval(results['interval'])}; "
        f"deviation {_deviation(results['deviation_cm'])}</span></div>"
    )


def _explanation(success_means: str) -> str:
    return (
        "<p>The robot was shown a number of demonstrations and learned from them what its camera sees and how its joints move "
        "along the way. Then it got goals it had never seen. A <b>goal</b> is a single picture of how the scene should look at the "
        "end. From the start and this picture the model <b>imagined</b> a whole way there: a short film and "
        "the joint angles that belong to it. The robot then <b>executed</b> those joint angles, while the camera recorded what really "
        "happened. The deviation is the distance that was left to the goal at the end. "
        f"A goal counts as reached when {escape(success_means)}.</p>"
    )


def _comparison(results: Mapping[str, Any]) -> str:
    ours = _comparison_row("imagined plans", results, results["goals"], "ours")
    rest = [
        _comparison_row(_BASELINES.get(name) or name.replace("_", " "), baseline, results["goals"], "other")
        for name, baseline in results["baselines"].items()
    ]
    return (
        "<h2>Beside doing without a model</h2>\n"
        f'<div class="card"><table class="numbers">\n{_head("method", *_COMPARED)}<tbody>\n{ours}{"".join(rest)}</tbody></table></div>\n'
        '<p class="note">The grey bar spans the Wilson 95 % interval, the dot is the share that was reached.</p>'
    )


def _comparison_row(name: str, counts: Mapping[str, Any], num_goals: int, kind: str) -> str:
    head, _, rest = name.partition(": ")
    numbers = [_number(counts["deviation_cm"].get(key), 1) for key in ("mean", "median", "max")]
    cells = (f"<b>{counts['success']}/{num_goals}</b>", _bar(counts, num_goals), _interval(counts["interval"]), *numbers)
    described = f'<br><span class="note">{escape(rest)}</span>' if rest else ""
    return f'<tr class="{kind}"><th scope="row"><b>{escape(head)}</b>{described}</th>{_cells(_COMPARED, cells)}</tr>\n'


def _bar(counts: Mapping[str, Any], num_goals: int) -> str:
    """The share that was reached, and its interval, from 0 to 100 %."""
    low, high = (100 * bound for bound in counts["interval"])
    return (
        '<svg class="interval" viewBox="0 0 100 10" aria-hidden="true"><rect class="all" y="2" width="100" height="6" rx="3"></rect>'
        f'<rect class="span" x="{low:.1f}" y="2" width="{max(1, high - low):.1f}" height="6" rx="3"></rect>'
        f'<circle class="best" cx="{100 * counts["success"] / num_goals:.1f}" cy="5" r="4"></circle></svg>'
    )


def _head(*names: str) -> str:
    cells = "".join(f'<th scope="col">{escape(name)}</th>' for name in names)
    return f"<thead><tr>{cells}</tr></thead>"


def _cells(heads: Sequence[str], cells: Sequence[str]) -> str:
    """Cells of a row, each with the head that stands above it where there is room for columns, and in it where there is none."""
    return "".join(f'<td data-head="{escape(head)}">{cell}</td>' for head, cell in zip(heads, cells, strict=True))


def _cases(cases: Sequence[Case], folder: Path) -> str:
    if not cases:
        return ""
    missed = sum(not case.success for case in cases)
    return (
        f"<h2>{len(cases)} {'case' if len(cases) == 1 else 'cases'} to look at"
        f"{f', {missed} of them missed' if missed else ''}</h2>\n"
        '<p class="note">Each film runs the goal, the imagined way and the executed way side by side. Below it the same as a strip, '
        "and the joint angles: planned as broad lines, executed dashed.</p>\n" + "\n".join(_case(case, folder) for case in cases)
    )


def _case(case: Case, folder: Path) -> str:
    film, figure = _relative(case.film, folder), _relative(case.figure, folder)
    label = escape(case.name, quote=True)
    moving = f'<img src="{film}" alt="film of {label}">'
    if case.film.suffix.lower() == ".mp4":
        moving = f'<video src="{film}" controls loop muted playsinline preload="auto" aria-label="film of {label}"></video>'
    return (
        f'<section class="case {"success" if case.success else "failure"}"><h3>{escape(case.name)} '
        f"<span>{_number(case.deviation_m * 100, 1)} cm off</span>{_verdict(case.success)}</h3>\n"
        f'{moving}\n<a href="{figure}"><img src="{figure}" alt="frames and joint curves of {label}" loading="lazy"></a></section>'
    )


def _all_goals(rows: Sequence[Mapping[str, Any]]) -> str:
    body = "\n".join(_goal_row(row) for row in rows)
    return f'<h2>Every goal</h2>\n<div class="card"><table class="numbers">\n{_head("goal", *_GOAL)}<tbody>\n{body}\n</tbody></table></div>'


def _goal_row(row: Mapping[str, Any]) -> str:
    numbers = _number(row["error"], 2), _number(row["seconds"], 1)
    cells = _number(row["deviation_cm"], 1), _verdict(row["success"]), escape(str(row["arrival_step"])), *numbers
    kind, goal = "success" if row["success"] else "failure", escape(str(row["goal"]))
    return f'<tr class="{kind}"><th scope="row" data-head="goal">{goal}</th>{_cells(_GOAL, cells)}</tr>'


def _verdict(success: bool) -> str:
    return '<span class="good">✓ success</span>' if success else '<span class="bad">✗ failure</span>'


def _relative(file: Path, folder: Path) -> str:
    return quote(Path(os.path.relpath(file, folder)).as_posix())


def _number(value: float | None, decimals: int) -> str:
    """The number with so many decimal places; a dash where there is none (JSON has no NaN)."""
    return "–" if value is None or not math.isfinite(value) else f"{value:.{decimals}f}"


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def _interval(bounds: Sequence[float]) -> str:
    low, high = bounds
    return f"{100 * low:.0f}–{100 * high:.0f} %"


def _deviation(deviation_cm: Mapping[str, float | None]) -> str:
    return ", ".join(f"{name} {_number(deviation_cm.get(name), 1)} cm" for name in ("mean", "median", "max"))
