"""Charts of results: how the work grows, where the intentions lie, and what trust is worth."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from preimage.report.figures import INK, MUTED, quiet, save, sheet

GROWTH = {
    "horizon": ("one iteration of a plan", "steps imagined"),
    "candidates": ("one iteration of a plan", "candidates"),
    "batch": ("a training update", "sequences"),
    "pixels": ("a training update", "pixels of a frame"),
}
"""Of each quantity that grows: the work, and what the quantity is."""


def growth_chart(growth: Mapping[str, Mapping[str, float]], path: str | os.PathLike[str]) -> Path:
    """Writes a PNG of the seconds that the work takes as one quantity grows, on axes from zero: a straight line is growth in proportion.

    Args:
        growth: the entry of that name in what `preimage bench` writes.
    """
    drawing = sheet(2.9, layout="constrained")
    for column, (name, (work, quantity)) in enumerate(GROWTH.items(), start=1):
        amounts, seconds = [float(amount) for amount in growth[name]], list(growth[name].values())
        axes = drawing.add_subplot(1, len(GROWTH), column)
        axes.plot(amounts, seconds, color="#1f6fb2", marker="o", markersize=4, linewidth=1.4)
        axes.set_xlim(0, None)
        axes.set_ylim(0, None)
        axes.set_title(work, fontsize=8, loc="left", color=INK)
        axes.set_xlabel(quantity, fontsize=9, color=MUTED)
        if column == 1 or work != [*GROWTH.values()][column - 2][0]:
            axes.set_ylabel("seconds", fontsize=9, color=MUTED)
        quiet(axes)
    return save(drawing, path)


def intention_map(recognition: Mapping[str, Any], path: str | os.PathLike[str]) -> Path:
    """Writes a PNG of the plane in which the intentions differ most: each is coloured by where on the table its sequence ends.

    Dots are training sequences, stars are sequences that were never shown, recognised from the whole of them (section II-C).
    """
    drawing = sheet(4.4, layout="constrained")
    for axis, name_of_axis in enumerate(("away from the base", "to the left")):
        axes = drawing.add_subplot(1, 2, axis + 1)
        goals = {name: np.array(places)[:, axis] for name, places in recognition["goals_m"].items()}
        everything = np.concatenate(list(goals.values()))
        limits = {"vmin": everything.min(), "vmax": everything.max(), "cmap": "viridis"}
        places = {name: np.array(several) for name, several in recognition["map"].items()}
        dots = axes.scatter(*places["training"].T, c=goals["training"], s=28, label="training sequences", **limits)
        stars = {"s": 110, "marker": "*", "edgecolors": INK, "linewidths": 0.7, "label": "sequences never shown, recognised"}
        axes.scatter(*places["novel"].T, c=goals["novel"], **stars, **limits)
        axes.set_title(f"colour: where it ends, {name_of_axis}", fontsize=10, loc="left", color=INK)
        axes.set_xlabel("first principal direction of the intentions", fontsize=9, color=MUTED)
        axes.set_ylabel("second principal direction", fontsize=9, color=MUTED)
        if axis == 0:
            drawing.legend(loc="outside lower center", ncols=2, fontsize=8, frameon=False, labelcolor=INK)
        drawing.colorbar(dots, ax=axes, label="m")
        quiet(axes)
    return save(drawing, path)


RANKED_BY = {"trust": "#1f6fb2", "plan's error": "#b0562a", "nearest demonstration": "#6b7684"}
"""What ranks plans, and its colour."""
BINS = 10
"""Bins of the reliability diagram, of equal width."""


def trust_chart(result: Mapping[str, Any], path: str | os.PathLike[str]) -> Path:
    """Writes a PNG of what trust is worth on goals that could be reached or just not: a reliability diagram, the ROC, and how many of the
    goals that are accepted are reached where only the best ranked are, for trust, the plan's error, and the nearest demonstration.

    Args:
        result: what `preimage evaluate --impossible` writes.
    """
    rows = [row for row in result["rows"] if row["kind"] in ("area", "rim")]
    reached = np.array([row["reached"] for row in rows])
    drawing = sheet(3.4, layout="constrained")
    diagram, roc, accepted = (drawing.add_subplot(1, 3, column) for column in (1, 2, 3))
    probable = np.array([row["trust"] for row in rows])
    bins = np.minimum((probable * BINS).astype(int), BINS - 1)
    for number in np.unique(bins):
        chosen = bins == number
        size = 18 + 4 * chosen.sum()
        diagram.scatter(probable[chosen].mean(), reached[chosen].mean(), s=size, color=RANKED_BY["trust"], alpha=0.7, clip_on=False)
    for name, colour in RANKED_BY.items():
        ordered = reached[np.argsort([-row[name] for row in rows], kind="stable")]
        hits, misses = (np.concatenate([[0], np.cumsum(each) / max(1, each.sum())]) for each in (ordered, ~ordered))
        roc.plot(misses, hits, color=colour, linewidth=1.6, label=f"{name}: {result['roc_area'][name]:.2f}")
        shares = np.arange(1, len(ordered) + 1) / len(ordered)
        accepted.plot(shares, np.cumsum(ordered) / np.arange(1, len(ordered) + 1), color=colour, linewidth=1.6, label=name)
    for axes in (diagram, roc):
        axes.plot([0, 1], [0, 1], color=MUTED, linewidth=0.8, linestyle=":")
    words = (
        (diagram, f"reliability (ECE {result['calibration_error']:.3f})", "probability of success, as said", "share reached"),
        (roc, "ROC", "share of failures accepted", "share of successes accepted"),
        (accepted, "success among accepted", "share of goals accepted", "share reached"),
    )
    for axes, title, across, up in words:
        axes.set_title(title, fontsize=10, loc="left", color=INK)
        axes.set_xlabel(across, fontsize=9)
        axes.set_ylabel(up, fontsize=9)
        axes.set_xlim(-0.03, 1.03)
        axes.set_ylim(-0.03, 1.03)
        quiet(axes)
    roc.legend(fontsize=7, loc="lower right", frameon=False, title="area under it", title_fontsize=7)
    return save(drawing, path)
