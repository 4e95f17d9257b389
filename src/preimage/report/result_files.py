"""The results that a page is made of, read from JSON files that others may have written or changed: each is what it says, or is named.

>>> misfit({"success": 3, "goals": "10", "interval": [0.1, 0.6]}, COUNTED)
"goals is '10'"
"""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from preimage.storage.reading import is_of, kind_of, non_finite_in, parse_json, tupled

Results = Sequence[Mapping[str, Any]]
Number, Pair = float, tuple[float, float]
COUNTED = {"success": int, "goals": int, "interval": Pair}
"""Shapes of what is read: the type of each entry, `?` after a name that may be missing, `*` for names of any kind."""
SEEDS = {"training_seed?": int, "training_seeds?": tuple[int, ...]}
PAPER = {"success_rate": Number, "*": Number}
EVALUATION = (
    COUNTED
    | {
        "task": str,
        "loop": str,
        "seed": int,
        "seconds_per_plan": Number,
        "deviation_cm": {"mean": Number},
        "baselines": {"*": {"success": int}},
        "preset": str,
        "size?": str,
        "num_demonstrations?": int,
        "trained_on?": str,
        "paper?": PAPER,
        "pixels?": int,
        "training_seconds?": Number,
        "provenance?": Mapping,
        "within_pixels?": {"1": COUNTED, "2": COUNTED, "3": COUNTED},
        "placed_once_grasped?": COUNTED,
    }
    | SEEDS
)
RECOGNITION = {
    "task": str,
    "num_demonstrations": int,
    "neighbours": Number,
    "error": {"training": tuple[float, ...], "novel": tuple[float, ...]},
}
MAP = {
    "task": str,
    "num_demonstrations": int,
    "size": str,
    "map": {"training": tuple[Pair, ...], "novel": tuple[Pair, ...]},
    "goals_m": {"training": tuple[Pair, ...], "novel": tuple[Pair, ...]},
}
MODALITIES = {
    "modalities": {
        "*": COUNTED
        | {
            "deviation_cm": {"mean": Number},
            "pixel_error_mean": Number,
            "joint_error_rad_mean": Number,
            "imagined_joint_error_rad_mean?": Number,
        }
    }
}
SPREAD = {"mean": Number, "median": Number}
ERRORS = {"joints_at_arrival?": SPREAD, "joints_on_the_way?": SPREAD, "frame_at_arrival?": SPREAD}
HELD_OUT = {"data": {"name": str}, "model": str, "episodes": tuple[int, ...], "imagined": ERRORS, "baselines": {"*": ERRORS}}
WORK = {"fraction_of_limit": Number, "seq_steps_per_s": Number, "peak_memory_mb?": Number}
SEARCH = {"ms_per_iteration": Number, "warm_s?": Number, "warm_s_mean?": Number, "warm_s_longest?": Number, "cold_s?": Number}
BENCH = {"device": str, "threads?": int, "train?": {"*": WORK}, "plan?": {"*": SEARCH}}
TRAINING = {"measured_updates": int, "updates": int, "task": str, "minutes_extrapolated": Number, "precision": str}
WHOLE, START_UP = {"whole_training": TRAINING}, {"start_up": {"import_s": Number, "import_all_s": Number, "help_s": Number}}
AMOUNTS = {"*": Number}
ROW = COUNTED | {"deviation_cm": Number, "seconds": Number, "iterations": Number, "gained?": int, "lost?": int, "p?": Number}
SIGN_TEST = {"gained", "lost", "p"}
"""Entries of a row that mean something together only."""
ABLATION = {"task": str, "num_demonstrations": int, "loop": str, "rows": {"*": ROW}, "paper?": PAPER} | SEEDS
REFUSED = {"refused": int, "goals": int, "interval": Pair}
TRUST = {
    "model": str,
    "seed": int,
    "success": {"area": COUNTED, "rim": COUNTED},
    "roc_area": {"*": Number},
    "roc_area_interval": {"*": Pair},
    "calibration_error": Number,
    "calibration_error_by_chance": Number,
    "falsely_refused": REFUSED,
    "refused_on_rim": REFUSED,
    "refused": {"*": REFUSED},
}
DISTURBED = {
    "loop": str,
    "disturb": str | None,
    "window": int | str | None,
    "deviation_cm": {"mean": Number},
    "seconds_per_step?": AMOUNTS,
} | COUNTED
"""A cell of what is tried with something that goes wrong."""
GROWTH = {"device": str, "threads": int, "growth": {"horizon": AMOUNTS, "candidates": AMOUNTS, "batch": AMOUNTS, "pixels": AMOUNTS}}


def read_results(folder: str | os.PathLike[str]) -> Results:
    """All results of a folder, in the order of their names.

    Raises:
        ValueError: a file is none.
    """
    return [read_result(file) for file in sorted(Path(folder).glob("*.json"))]


def read_result(file: Path) -> dict[str, Any]:
    """The result in a file, with what older ones leave out or call otherwise.

    Raises:
        ValueError: it is none, or an entry that is looked at is of another kind.
    """
    try:
        content = parse_json(file)
        if not isinstance(content, dict):
            raise ValueError(f"it holds {kind_of(content)}, not names with values")
        if place := non_finite_in(content):
            raise ValueError(f"{place}, which nothing can be computed with")
        found = {"preset": "full"} | without_nothing(content) | {"file": file.name}
        baselines = found.get("baselines")
        if isinstance(baselines, dict) and "recalled_joints" in baselines:  # as results before there were presets call it
            baselines["memory_alone"] = baselines.pop("recalled_joints")
        if reason := next(filter(None, (misfit(found, shape) for shape in shapes_of(found))), None) or odd_in(found):
            raise ValueError(reason)
        return found
    except ValueError as error:
        raise ValueError(f"{file} is no result ({error}): remove it, or write it anew") from error


def without_nothing(content: Any) -> Any:
    """JSON without the entries that say that there is nothing."""
    if not isinstance(content, dict):
        return content
    return {name: without_nothing(value) for name, value in content.items() if value is not None}


def is_evaluation(found: Mapping[str, Any]) -> bool:
    """Whether a result counts trials."""
    return {"task", "success", "loop", "seconds_per_plan", "baselines"} <= found.keys()


def shapes_of(found: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The shapes that a result has to have for what it holds."""
    known = {"neighbours": RECOGNITION, "map": MAP, "modalities": MODALITIES, "limit_gflops": BENCH, "growth": GROWTH}
    known |= {"whole_training": WHOLE, "start_up": START_UP}
    shapes = [shape for name, shape in known.items() if name in found]
    kinds = {"held-out": HELD_OUT, "ablation": ABLATION, "trust": TRUST}
    kind = found.get("kind")
    shapes += [kinds[kind]] if isinstance(kind, str) and kind in kinds else []
    return shapes + ([EVALUATION] if is_evaluation(found) else [])


def misfit(content: Any, shape: Any, name: str = "it") -> str | None:
    """The first reason why a value is not of a shape; None where it is."""
    if not isinstance(shape, dict):
        return None if is_of(tupled(content), shape) else f"{name} is {kind_of(content)}"
    if not isinstance(content, Mapping):
        return f"{name} is {kind_of(content)}"
    for key, part in shape.items():
        for each in content if key == "*" else [key.removesuffix("?")]:
            if each not in content:
                if not key.endswith("?"):
                    return f"{name} has no {each}"
                continue
            if reason := misfit(content[each], part, each):
                return reason
    return None


def odd_in(found: Mapping[str, Any]) -> str | None:
    """What of a result is of the right kind and cannot be: no goals, no sequences, as many points as there are not."""
    cells = found.get("cells", [])
    if not isinstance(cells, list):
        return f"cells is {kind_of(cells)}"
    if reason := next(filter(None, (misfit(cell, DISTURBED, "a cell") for cell in cells)), None):
        return reason
    if is_evaluation(found) and found["goals"] < 1:
        return f"goals is {found['goals']}"
    if is_evaluation(found) and found["task"] == "move-object" and "within_pixels" not in found:
        return "it has no within_pixels"
    for name, row in found["rows"].items() if found.get("kind") == "ablation" else ():
        if SIGN_TEST & row.keys() and not row.keys() >= SIGN_TEST:
            return f"{name} has some of {', '.join(sorted(SIGN_TEST))}, and not all"
    if "neighbours" in found and not all(found["error"][name] for name in ("training", "novel")):
        return "error is of no sequence"
    if "map" in found and not all(0 < len(found["map"][name]) == len(found["goals_m"][name]) for name in ("training", "novel")):
        return "map and goals_m are not of the same sequences"
    amounts = (amount for by_amount in found.get("growth", {}).values() for amount in by_amount)
    return next((f"growth has an amount of {amount!r:.40}" for amount in amounts if not is_amount(amount)), None)


def is_amount(text: str) -> bool:
    """Whether a name of JSON is a whole number above 0.

    >>> is_amount("16"), is_amount("0"), is_amount("1e9")
    (True, False, False)
    """
    return text.isascii() and text.isdigit() and int(text[:16]) > 0
