"""docs/results.md from results/*.json: the tables of the paper, ours beside it, each cell with its command, seeds and seconds."""

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from preimage.report.charts import growth_chart, intention_map, trust_chart
from preimage.report.result_files import Results, read_results
from preimage.report.tables import (
    ablation_table,
    cells_table,
    disturbed_table,
    evaluations_among,
    grasps_table,
    held_out_table,
    modalities_table,
    presets_table,
    reach_table,
    recognition_table,
    refusals_table,
    speed_table,
    tasks_table,
    trust_table,
)
from preimage.storage.atomic_write import atomic_write

BEGIN, END = "<!-- results:begin -->", "<!-- results:end -->"
HEAD = """# Results

Written by `preimage report` from the JSON files in `results/`; nothing here is typed by hand. Every count is k/n of test goals that
neither training nor tuning saw, with the Wilson 95 % interval. The baselines stand beside: *nearest demonstration* replays the
demonstration whose last frame is most like the goal, *behaviour cloning* maps what is sensed and the goal frame to the next joints,
*memory alone* goes straight to where the model's memory, without its network, expects the arm at the goal, by way of where it expects
the gripper to close and open, *prior mean* is the same model with no goal, *do nothing* leaves the arm where it starts. Sizes are those
of `preimage train`."""
INTENTIONS = """Where the intentions of {task} lie ({num_demonstrations} demonstrations, {size}): dots are training sequences,
stars novel ones.

![intentions]({picture})"""
GROWTH = """How the work grows on {device}, {threads} threads:

![growth]({picture})"""
TRUST = """What trust in plans of the model {model} is worth, on goals of which {success[area][goals]} were drawn as the demonstrations were
and {success[rim][goals]} lie on the rim, up to 10 cm beyond (test seed {seed}; calibrated by {num_calibrated_by} other goals):

![trust]({picture})"""


def write_results(folder: str | os.PathLike[str], path: str | os.PathLike[str]) -> Path:
    """Writes the page of results.

    Raises:
        ValueError: the folder holds no evaluation, or a file that is no result.
    """
    found = read_results(folder)
    evaluations = evaluations_among(found)
    if not evaluations:
        raise ValueError(f"{folder} holds no evaluation: write one with `preimage evaluate` or `preimage reproduce`")
    path = Path(path)
    figures = path.parent / "figures"
    parts = [
        HEAD,
        presets_table(found),
        ablation_table(found),
        reach_table(evaluations),
        tasks_table(evaluations),
        grasps_table(evaluations),
        recognition_table(found),
    ]
    parts += [pictures(found, figures, "map", intention_map, INTENTIONS), modalities_table(found)]
    parts += [disturbed_table(found), trust_table(found), refusals_table(found), pictures(found, figures, "roc_area", trust_chart, TRUST)]
    parts += [held_out_table(found), speed_table(found)]
    parts += [pictures(found, figures, "growth", lambda one, to: growth_chart(one["growth"], to), GROWTH), cells_table(evaluations)]
    with atomic_write(path) as unfinished:
        unfinished.write_text("\n\n".join(part for part in parts if part) + "\n")
    return path


def fill_readme(folder: str | os.PathLike[str], readme: str | os.PathLike[str]) -> None:
    """Writes the table of the three presets between the README's marks; a README without marks stays as it is."""
    path = Path(readme)
    text = path.read_text() if path.exists() else ""
    if BEGIN not in text or END not in text:
        return
    _, _, rows = presets_table(read_results(folder)).partition("\n\n")
    before, after = text.split(BEGIN)[0], text.split(END)[1]
    with atomic_write(path) as unfinished:
        unfinished.write_text(f"{before}{BEGIN}\n{rows}\n{END}{after}")


def pictures(found: Results, folder: Path, entry: str, draw: Callable[[Mapping[str, Any], Path], Path], words: str) -> str:
    """A picture of each result that has the entry, with words in which {picture} and the result's own entries are filled in."""
    drawn = [(one, draw(one, folder / f"{Path(one['file']).stem}.png")) for one in found if entry in one]
    return "\n\n".join(words.format(**one, picture=f"{folder.name}/{path.name}") for one, path in drawn)
