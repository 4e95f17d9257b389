"""Charts of results: how the work grows, and where the intentions lie."""

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
