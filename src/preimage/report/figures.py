"""Figures in the manner of the paper's figures 3 to 5, and the learning curve of a run.

Only matplotlib's object interface is used: no pyplot, so no backend is chosen for anybody else.
"""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import matplotlib
import numpy as np
from jaxtyping import Float, Int, Shaped
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from preimage.records import Plan, Trial, Verdict
from preimage.report.films import as_rgb, validate_filmed
from preimage.storage.atomic_write import atomic_write

NUM_COLUMNS = 8
"""Frames shown of a sequence, evenly spaced up to arrival."""
GAP = 0.06
"""Between two frames, in widths of a frame."""
WIDTH_INCHES, DOTS_PER_INCH = 10.0, 130
INK, MUTED, ARRIVAL, SUCCESS, FAILURE = "#1c2430", "#66707d", "#c47f00", "#12804a", "#c0322b"

Shown = Mapping[int, tuple[Shaped[np.ndarray, "H W C"] | None, str]]
"""Frame and caption by column."""


@dataclass(frozen=True)
class _Strip:
    """Joints that share an axis."""

    label: str
    joints: list[int]
    inches: float = 3.0
    in_degrees: bool = False


@dataclass(frozen=True)
class _Overlay:
    """Joints that are drawn over the imagined ones."""

    label: str
    joints: Float[np.ndarray, "S J"]
    rate_hz: float


def figure(
    plan: Plan,
    trial: Trial | None,
    path: str | os.PathLike[str],
    *,
    joint_unit: str | None = None,
    commands: Float[np.ndarray, "S J"] | None = None,
    commands_hz: float | None = None,
) -> Path:
    """Writes a PNG: initial and goal frame, the imagined and the executed sequence, and below them the joint curves.

    Joints are drawn in the unit of the training data, radians as degrees. Only the simulated arm executes: its joints are in rad, but
    for the gripper, which is in m and has an axis of its own.

    Args:
        joint_unit: the unit of all joints, where the data give one (`storage.runs.read_body`).
        commands: what the robot is to be sent, drawn over what is imagined (`robot.limits.commands_of`).
        commands_hz: rows a second of the commands; by default the plan's.

    Raises:
        ValueError: the trial was not filmed.
    """
    validate_filmed(trial)
    if commands is not None:
        sent = _Overlay("commanded", commands, commands_hz or plan.rate_hz)
    else:
        sent = _Overlay("executed", trial.joints, plan.rate_hz) if trial is not None else None
    num_rows = 2 if trial is None else 3
    height, width = plan.frames.shape[1:3]
    row_inches = WIDTH_INCHES * 0.86 / NUM_COLUMNS * height / width + 0.24
    strips = _strips(plan.joint_names, joint_unit, executed=trial is not None)
    strip_inches = [strip.inches for strip in strips]
    head_inches, gap_inches, foot_inches = 0.55, 0.35, 0.5
    frames_inches, curves_inches = num_rows * row_inches, sum(strip_inches)
    total = head_inches + frames_inches + gap_inches + curves_inches + foot_inches

    drawing = sheet(total)
    _draw_title(drawing, plan, trial, total)
    upper = GridSpec(
        num_rows, 1, drawing, left=0.1, right=0.98, hspace=0.24 / row_inches,
        top=1 - head_inches / total, bottom=1 - (head_inches + frames_inches) / total,
    )  # fmt: skip
    _draw_frames(drawing, upper, plan, trial)
    lower = GridSpec(
        len(strips), 1, drawing, left=0.1, right=0.82, hspace=0.12, height_ratios=strip_inches,
        top=(foot_inches + curves_inches) / total, bottom=foot_inches / total,
    )  # fmt: skip
    _draw_curves(drawing, lower, strips, plan, sent)
    return save(drawing, path)


def learning_curve(
    log_jsonl_path: str | os.PathLike[str], path: str | os.PathLike[str], *, held_out: str | os.PathLike[str] | None = None
) -> Path:
    """Writes a PNG of the vision error and the joint KL against updates, both on a logarithmic scale.

    Args:
        log_jsonl_path: the `log.jsonl` of a run. A last line cut short by a kill is left out; where a resumed run repeats an update,
            the later line counts.
        held_out: the same of episodes that were held out, one line a checkpoint; drawn where there is such a file.

    Raises:
        ValueError: the log holds no update, or a line before the last is no JSON.
    """
    updates, visual, proprioceptive = _read_log(Path(log_jsonl_path))
    checked, *unseen = _read_log(Path(held_out)) if held_out and Path(held_out).exists() else ([], [], [])
    drawing = sheet(3.6, layout="constrained")
    named = (("vision: squared error", visual, "#1f6fb2"), ("joints: KL divergence", proprioceptive, "#b0562a"))
    for column, ((name, values, colour), unseen_values) in enumerate(zip(named, unseen, strict=True)):
        axes = drawing.add_subplot(1, 2, column + 1)
        axes.plot(updates, values, color=colour, linewidth=1.4, marker="." if len(updates) < 40 else None)
        if checked:
            axes.plot(checked, unseen_values, color=INK, linewidth=1.2, marker="o", markersize=3.5, label="held-out episodes")
            axes.legend(frameon=False, fontsize=9)
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.yaxis.set_minor_formatter(NullFormatter())
        axes.set_title(f"{name} ({values[-1]:.3g} at update {updates[-1]})", fontsize=11, loc="left", color=INK)
        axes.set_xlabel("updates", fontsize=10)
        axes.grid(which="major", color="#d5dae0", linewidth=0.8)
        axes.grid(which="minor", color="#eceff2", linewidth=0.5)
        quiet(axes)
    return save(drawing, path)


def _draw_title(drawing: Figure, plan: Plan, trial: Trial | None, total_inches: float) -> None:
    at = f"at {plan.arrival_step / plan.rate_hz:.1f} s"
    title, colour = (f"In doubt: nearest {at}", FAILURE) if plan.verdict is Verdict.IN_DOUBT else (f"Imagined: arrives {at}", INK)
    if trial is not None:
        title = f"{'Success' if trial.success else 'Failure'}: {trial.deviation_m * 100:.1f} cm from the goal"
        colour = SUCCESS if trial.success else FAILURE
    details = f"arrival step {plan.arrival_step} of {len(plan)}  ·  error {plan.error:.3g}"
    if plan.unexplained is not None and plan.verdict:
        details += f" ({100 * plan.unexplained:.1f} %, {plan.verdict.value})"
    details += f"  ·  {plan.seconds:.1f} s"
    drawing.text(0.1, 1 - 0.16 / total_inches, title, fontsize=14, weight="bold", color=colour, va="top")
    drawing.text(0.98, 1 - 0.2 / total_inches, details, fontsize=9.5, color=MUTED, va="top", ha="right")


def _draw_frames(drawing: Figure, grid: GridSpec, plan: Plan, trial: Trial | None) -> None:
    steps = np.unique(np.linspace(0, plan.arrival_step, NUM_COLUMNS).round().astype(int))
    given = {0: (plan.start.frame, "initial"), max(1, len(steps) - 1): (plan.goal.frame, "goal")}
    rows = {"given": given, "imagined": _at(steps, plan.frames, plan.rate_hz)}
    if trial is not None:
        seen = np.minimum(steps, len(trial.frames) - 1)
        seen[-1] = len(trial.frames) - 1  # the column of the arrival shows how the execution ended
        rows["executed"] = _at(seen, trial.frames, plan.rate_hz)
    for row, (name, shown) in enumerate(rows.items()):
        axes = drawing.add_subplot(grid[row])
        draw_row(axes, shown, plan.frames.shape[1:3], columns=NUM_COLUMNS)
        axes.set_ylabel(name, fontsize=10.5, weight="bold", color=INK, labelpad=6)


def _at(steps: Int[np.ndarray, " N"], frames: Shaped[np.ndarray, "T H W C"], rate_hz: float) -> Shown:
    return {column: (frames[step], f"{step / rate_hz:.1f} s") for column, step in enumerate(steps)}


def draw_row(axes: Axes, shown: Shown, size: tuple[int, ...], *, columns: int) -> None:
    """Frames and captions in one pair of axes: to make axes takes longer than to draw in them.

    Args:
        size: height and width of the frames.
        columns: for how many there is room.
    """
    height, width = size
    for column, (frame, caption) in shown.items():
        left = column * (1 + GAP) * width
        if frame is None:
            axes.text(left + width / 2, height / 2, "no image", ha="center", va="center", fontsize=9, color=MUTED)
        else:
            axes.imshow(as_rgb(frame), interpolation="nearest", extent=(left, left + width, height, 0))
        axes.add_patch(Rectangle((left, 0), width, height, fill=False, edgecolor="#c3cad2", linewidth=0.8, clip_on=False))
        below = {"xytext": (0, -3), "textcoords": "offset points", "ha": "center", "va": "top"}
        axes.annotate(caption, (left + width / 2, height), fontsize=9, color=INK, annotation_clip=False, **below)
    axes.set(xticks=[], yticks=[], xlim=(0, (columns * (1 + GAP) - GAP) * width), ylim=(height, 0), aspect="equal", anchor="NW")
    axes.spines[:].set_visible(False)


def _strips(joint_names: tuple[str, ...], joint_unit: str | None, *, executed: bool) -> list[_Strip]:
    everything = list(range(len(joint_names)))
    slides = [joint for joint in everything if executed and "gripper" in joint_names[joint].lower()]
    if not executed and joint_unit != "rad":
        return [_Strip(f"joints ({joint_unit})" if joint_unit else "joints", everything)]
    turns = _Strip("joint angle (°)", [joint for joint in everything if joint not in slides], in_degrees=True)
    return [strip for strip in (turns, _Strip("gripper (m)", slides, inches=1.0)) if strip.joints]


def _draw_curves(drawing: Figure, grid: GridSpec, strips: list[_Strip], plan: Plan, sent: _Overlay | None) -> None:
    colours = matplotlib.colormaps["tab10" if len(plan.joint_names) <= 10 else "tab20"].colors  # pyright: ignore[reportAttributeAccessIssue]
    top: Axes | None = None
    for row, strip in enumerate(strips):
        axes = drawing.add_subplot(grid[row, 0], sharex=top)
        top = top or axes
        for joint in strip.joints:
            _draw_joint(axes, joint, strip.in_degrees, colours[joint % len(colours)], plan, sent)
        axes.axvline(plan.arrival_step / plan.rate_hz, color=ARRIVAL, linewidth=1.2, linestyle=":")
        axes.set_ylabel(strip.label, fontsize=10)
        axes.grid(color="#e6eaee", linewidth=0.7)
        axes.margins(x=0.01)
        axes.tick_params(labelbottom=row == len(strips) - 1)
        quiet(axes)
        if row == len(strips) - 1:
            axes.set_xlabel("time (s)", fontsize=10)
    assert top is not None, "a plan without joints"
    _draw_legend(top, colours, plan, sent)


def _draw_joint(axes: Axes, joint: int, in_degrees: bool, colour: object, plan: Plan, sent: _Overlay | None) -> None:
    """Imagined up to arrival as a broad line, beyond it as a faint one; what was commanded or executed dashed on top."""
    drawn = np.degrees if in_degrees else np.asarray
    planned = drawn(plan.joints[:, joint])
    times, arrival = np.arange(len(planned)) / plan.rate_hz, plan.arrival_step
    axes.plot(times[: arrival + 1], planned[: arrival + 1], color=colour, linewidth=2.6, alpha=0.55)
    axes.plot(times[arrival:], planned[arrival:], color=colour, linewidth=1.2, alpha=0.25)
    if sent is not None:
        way = drawn(sent.joints[:, joint])
        axes.plot(np.arange(len(way)) / sent.rate_hz, way, color=colour, linewidth=1.3, linestyle=(0, (4, 2)))


def _draw_legend(axes: Axes, colours: tuple[object, ...], plan: Plan, sent: _Overlay | None) -> None:
    names = plan.joint_names
    handles = [Line2D([], [], color=MUTED, linewidth=2.6, alpha=0.55, label="imagined")]
    if sent is not None:
        handles.append(Line2D([], [], color=MUTED, linewidth=1.3, linestyle=(0, (4, 2)), label=sent.label))
    handles.append(Line2D([], [], color=ARRIVAL, linewidth=1.2, linestyle=":", label="arrival"))
    handles += [Line2D([], [], color=colours[i % len(colours)], linewidth=2.6, label=name) for i, name in enumerate(names)]  # pyright: ignore[reportArgumentType]
    size, spacing = (9, 0.5) if len(names) <= 10 else (6, 0.2)
    axes.legend(handles=handles, loc="upper left", bbox_to_anchor=(1.01, 1.02), fontsize=size, labelspacing=spacing, frameon=False)


def sheet(height_inches: float, layout: Literal["constrained"] | None = None) -> Figure:
    """A blank figure of the width that all figures have."""
    drawing = Figure(figsize=(WIDTH_INCHES, height_inches), dpi=DOTS_PER_INCH, facecolor="white", layout=layout)
    FigureCanvasAgg(drawing)
    return drawing


def quiet(axes: Axes) -> None:
    """Axes without a frame above and to the right, with small numbers."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=9)


def save(drawing: Figure, path: str | os.PathLike[str]) -> Path:
    """The drawing as a PNG, whole or not at all."""
    path = Path(path)
    with atomic_write(path) as unfinished:
        drawing.savefig(unfinished, format="png")
    return path


def _read_log(path: Path) -> tuple[list[int], list[float], list[float]]:
    """Updates in order, with the vision error and the joint KL of each."""
    lines = path.read_text(encoding="utf-8").splitlines()
    rows: dict[int, tuple[float, float]] = {}
    for number, line in enumerate(lines, start=1):
        try:
            entry = json.loads(line)
        except json.JSONDecodeError as cause:
            if number == len(lines):
                break
            raise ValueError(f"log_jsonl_path has a line {number} that is no JSON: {path}") from cause
        if {"update", "visual", "proprioceptive"} <= entry.keys():
            rows[entry["update"]] = (entry["visual"], entry["proprioceptive"])
    if not rows:
        raise ValueError(f"log_jsonl_path holds no update yet, train for a while first: {path}")
    updates = sorted(rows)
    return updates, [rows[u][0] for u in updates], [rows[u][1] for u in updates]
