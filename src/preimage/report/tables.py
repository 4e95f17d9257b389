"""The tables of docs/results.md, in Markdown, each of the results that have what it shows."""

from collections.abc import Mapping, Sequence
from typing import Any

from preimage.report.result_files import Results, is_evaluation

BASELINES = ("nearest_demonstration", "behaviour_cloning", "memory_alone", "prior_mean", "do_nothing")


def evaluations_among(found: Results) -> Results:
    """Those that count trials."""
    return [one for one in found if is_evaluation(one)]


PRESETS = ("paper", "regression", "full")


def counts_by_preset(found: Results) -> Results:
    """Evaluations, and of ablations the rows that are a preset as it is."""
    counts = list(evaluations_among(found))
    for one in found:
        for preset in PRESETS if one.get("kind") == "ablation" else ():
            if preset in one["rows"]:
                counts.append({**one, **one["rows"][preset], "preset": preset})
    return counts


def presets_table(found: Results) -> str:
    """What the paper reports, beside its method alone, network and search without memory, and all ideas: all seeds together."""
    kinds = [("reach", 100, "closed"), ("reach", 50, "closed"), ("reach", 25, "closed"), ("two-points", 100, "closed")]
    kinds += [("move-object", 100, "closed"), ("move-object", 100, "open")]
    rows, counts = [], counts_by_preset(found)
    for task, count, loop in kinds:
        alike = of(counts, task=task, num_demonstrations=count, loop=loop, size="small")
        alike = [one for one in alike if one.get("pixels", 64) == 64]
        cells = [pooled([one for one in alike if one["preset"] == preset]) for preset in PRESETS]
        if any(cells):
            rows.append([task, f"{count}", loop, next((paper_rate(one) for one in alike if one.get("paper")), ""), *cells])
    return table(
        "The method alone, and what is added", ["task", "demonstrations", "loop", "paper", *(f"as {name}" for name in PRESETS)], rows
    )


def ablation_table(found: Results) -> str:
    """What each idea brings."""
    rows = []
    for one in found:
        for name, row in one["rows"].items() if one.get("kind") == "ablation" else ():
            model = f"{one['num_demonstrations']}" + (", bundled model" if one.get("bundled") else "")
            setting = [one["task"], model, one["loop"], name, counted(row)]
            changed = f"+{row['gained']} -{row['lost']} ({row['p']:.2f})" if "gained" in row else ""
            rows.append([*setting, changed, f"{row['deviation_cm']:.2f} cm", f"{row['seconds']:.2f} s", f"{row['iterations']:.1f}"])
    head = ["task", "demonstrations", "loop", "as", "reached", "gained, lost (p)", "mean", "a plan", "iterations"]
    note = "Gained and lost: goals against the preset itself, on the same goals; p by the sign test."
    return table("What each idea brings", head, rows) + (f"\n\n{note}" if rows else "")


def pooled(evaluations: Results) -> str:
    """Successes of several evaluations together, and of how many training seeds."""
    if not evaluations:
        return ""
    reached, goals = (sum(one[name] for one in evaluations) for name in ("success", "goals"))
    seeds = len({seed for one in evaluations for seed in one.get("training_seeds", [one.get("training_seed")])})
    return f"{reached}/{goals} ({percent(reached / goals)}, {seeds} training seed{'' if seeds == 1 else 's'})"


def reach_table(evaluations: Results) -> str:
    """Table II of the paper."""
    rows = []
    for count in (100, 50, 25):
        for one in of(evaluations, task="reach", num_demonstrations=count, loop="closed"):
            deviation = (one.get("paper") or {}).get("deviation_cm")
            mean = f"{deviation} cm" if deviation else ""
            rows.append([f"{count}", size_of(one), one["preset"], paper_rate(one), counted(one), mean, mean_cm(one), *baselines(one)])
    return table(
        "Reaching (Table II)", ["demonstrations", "size, seeds", "as", "paper", "ours", "paper, mean", "ours, mean", *BASELINES], rows
    )


def tasks_table(evaluations: Results) -> str:
    """Experiments 2 and 3."""
    rows = []
    for task in ("two-points", "move-object", "two-circles"):
        for one in of(evaluations, task=task):
            rows.append([task, one["loop"], size_of(one), one["preset"], paper_rate(one), counted(one), mean_cm(one), *baselines(one)])
    return table("Two points, and moving an object", ["task", "loop", "size, seeds", "as", "paper", "ours", "mean", *BASELINES], rows)


def grasps_table(evaluations: Results) -> str:
    """Table III."""
    rows: list[list[str]] = []
    for one in of(evaluations, task="move-object"):
        paper = one.get("paper")
        if paper and [one["loop"], "paper"] not in [row[:2] for row in rows]:
            names = ("success_rate", "within_1", "within_2", "within_3", "placed_once_grasped")
            rows.append([one["loop"], "paper", *(percent(paper[name]) if name in paper else "" for name in names)])
        within = [counted(one["within_pixels"][pixels]) for pixels in "123"]
        placed = counted(one["placed_once_grasped"]) if "placed_once_grasped" in one else "none grasped"
        rows.append([one["loop"], size_of(one), counted(one), *within, placed])
    return table("Grasping (Table III)", ["loop", "size, seeds", "strict", "1 px", "2 px", "3 px", "placed once grasped"], rows)


def recognition_table(found: Results) -> str:
    """Section II-C."""
    rows = []
    for one in found:
        if "neighbours" in one:
            training, novel = (sum(one["error"][name]) / len(one["error"][name]) for name in ("training", "novel"))
            cell = [one["task"], str(one["num_demonstrations"]), str(one.get("size"))]
            rows.append([*cell, f"{training:.3f}", f"{novel:.3f}", f"{one['neighbours']:.2f}"])
    head = ["task", "demonstrations", "size", "error, training sequences", "error, novel sequences", "neighbours (rank correlation)"]
    return table("Recognition of whole sequences", head, rows)


RANKS = ("trust", "plan's error", "nearest demonstration")


def disturbed_table(found: Results) -> str:
    """What becomes of plans when something goes wrong (`preimage evaluate --disturb`), in each loop."""
    rows = []
    for one in found:
        for cell in one.get("cells", ()):
            loop = cell["loop"] if cell["window"] is None else f"{cell['loop']}, window of {cell['window']}"
            took = cell.get("seconds_per_step", {})
            a_step = f"{took['median']:.3f}, {took['99 %']:.3f} s" if {"median", "99 %"} <= took.keys() else ""
            rows.append(
                [str(one.get("task")), f"{one.get('seed')}", cell["disturb"] or "nothing", loop, counted(cell), mean_cm(cell), a_step]
            )
    head = ["task", "test seed", "what goes wrong", "loop", "reached", "mean", "a step: median, 99th percentile"]
    return table("When something goes wrong", head, sorted(rows, key=lambda row: (row[0], row[2] != "nothing", row[2])))


def trust_table(found: Results) -> str:
    """How well plans know whether they succeed (`preimage evaluate --impossible`)."""
    rows = []
    for one in found:
        if one.get("kind") == "trust":
            reached = [counted(one["success"][kind]) for kind in ("area", "rim")]
            areas = [f"{one['roc_area'][name]:.3f} ({'–'.join(f'{end:.2f}' for end in one['roc_area_interval'][name])})" for name in RANKS]
            refused = [of_refused(one[name]) for name in ("falsely_refused", "refused_on_rim")]
            errors = [f"{one[name]:.3f}" for name in ("calibration_error", "calibration_error_by_chance")]
            rows.append([one["model"], f"{one['seed']}", *reached, *areas, *errors, *refused])
    head = ["model", "test seed", "reached, demonstrated area", "reached, rim", *(f"area under the ROC, {name}" for name in RANKS)]
    return table(
        "Trust", [*head, "calibration error (ECE)", "the same by chance alone", "refused, demonstrated area", "refused, rim"], rows
    )


def refusals_table(found: Results) -> str:
    """How many impossible goals of each kind are refused."""
    tried = [one for one in found if one.get("kind") == "trust"]
    kinds = list(dict.fromkeys(kind for one in tried for kind in one["refused"]))
    rows = [[kind, *(of_refused(one["refused"][kind]) if kind in one["refused"] else "" for one in tried)] for kind in kinds]
    return table("Impossible goals refused", ["kind", *(one["model"] for one in tried)], rows)


def of_refused(one: Mapping[str, Any]) -> str:
    low, high = one["interval"]
    return f"{one['refused']}/{one['goals']} ({100 * low:.0f}–{100 * high:.0f} %)"


def modalities_table(found: Results) -> str:
    """Section II-D: the goal given in one modality or in both."""
    rows = [
        [
            given,
            counted(row),
            mean_cm(row),
            f"{row['pixel_error_mean']:.2f}",
            imagined_joints_off(row),
            f"{row['joint_error_rad_mean']:.3f}",
        ]
        for one in found
        for given, row in one.get("modalities", {}).items()
    ]
    return table(
        "The goal in one modality or both",
        ["goal given in", "reached", "mean", "grey levels off", "joints off as imagined (rad)", "as commanded"],
        rows,
    )


def imagined_joints_off(row: Mapping[str, Any]) -> str:
    off = row.get("imagined_joint_error_rad_mean")
    return "" if off is None else f"{off:.3f}"


def held_out_table(found: Results) -> str:
    """Plans beside recordings that were never trained on (`preimage evaluate --data`)."""
    names = "joints_at_arrival", "joints_on_the_way", "frame_at_arrival"
    rows = []
    for one in found:
        if one.get("kind") == "held-out":
            for way, errors in {"imagined": one["imagined"], **one["baselines"]}.items():
                known = [errors.get(name) for name in names]
                spread = [f"{each['mean']:.3g} ({each['median']:.3g})" if each else "" for each in known]
                rows.append([one["data"]["name"], one["model"], f"{len(one['episodes'])}", way.replace("_", " "), *spread])
    head = ["recordings", "run", "held out", "way", "joints at arrival", "joints on the way", "frame at arrival"]
    note = "Mean (median) difference from what was recorded, joints in the unit of the data, frames in squared grey levels. No robot moved."
    return table("Recordings of real robots, held-out episodes", head, rows) + (f"\n\n{note}" if rows else "")


def speed_table(found: Results) -> str:
    """What `preimage bench` measured."""
    rows = []
    for one in found:
        device = one.get("device", "")
        if device == "cpu":
            instructions = f"{one['instruction_set']}, " if one.get("instruction_set") else ""
            device = f"cpu, {instructions}threads: {one.get('threads')}"
        for name, work in one.get("train", {}).items() if "limit_gflops" in one else ():
            share = f"{work['fraction_of_limit']:.0%}"
            memory = f"{work['peak_memory_mb']:.0f} MB" if "peak_memory_mb" in work else ""
            measured = f"{work['seq_steps_per_s']} sequence steps/s"
            rows.append([device, f"train {name}", measured, share, memory])
        for name, work in one.get("plan", {}).items() if "limit_gflops" in one else ():
            measured = f"{work['ms_per_iteration']} ms an iteration"
            if {"warm_s", "warm_s_mean", "warm_s_longest", "cold_s"} <= work.keys():
                spread = f"mean {work['warm_s_mean']}, longest {work['warm_s_longest']}"
                measured = f"{work['warm_s']} s warm ({spread}), {work['cold_s']} s cold, {measured}"
            rows.append([device, f"plan {name}", measured, "", ""])
        rows += [[device, work, measured, "", ""] for work, measured in other_speeds(one).items()]
    return table("Speed", ["device", "work", "measured", "share of the machine's limit", "memory"], rows)


def other_speeds(one: Mapping[str, Any]) -> dict[str, str]:
    """How long a whole training and a start take, as benched."""
    speeds: dict[str, str] = {}
    if "whole_training" in one:
        whole = one["whole_training"]
        of_updates = f"extrapolated from {whole['measured_updates']} of {whole['updates']} updates"
        speeds[f"train {whole['task']}, whole"] = f"{whole['minutes_extrapolated']} minutes ({of_updates}), {whole['precision']}"
    if "start_up" in one:
        start_up = one["start_up"]
        speeds["start"] = f"import {start_up['import_s']} s, all names {start_up['import_all_s']} s, --help {start_up['help_s']} s"
    return speeds


def cells_table(evaluations: Results) -> str:
    """How to obtain each number again."""
    rows = []
    for one in evaluations:
        made = one.get("provenance", {})
        learned = f"{one['training_seconds'] / 60:.1f} min" if "training_seconds" in one else ""
        learned += f", {one['trained_on']}" if one.get("trained_on") else ""
        rows.append(
            [
                one["file"],
                f"`{made.get('command')}`",
                str(one["seed"]),
                learned,
                f"{one['seconds_per_plan']:.2f} s",
                str(made.get("machine")),
            ]
        )
    return table("Every cell", ["file", "command", "test seed", "training", "a plan", "machine"], rows)


def of(evaluations: Results, **wanted: Any) -> list[Mapping[str, Any]]:
    return [one for one in evaluations if all(one.get(name) == value for name, value in wanted.items())]


def paper_rate(one: Mapping[str, Any]) -> str:
    return percent(one["paper"]["success_rate"]) if one.get("paper") else ""


def percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def size_of(one: Mapping[str, Any]) -> str:
    learned, pixels = one.get("training_seed"), one.get("pixels", 64)
    frames = f" {pixels}x{pixels}" if pixels != 64 else ""
    return f"{one.get('size')}{frames}, {'–' if learned is None else learned}/{one['seed']}"


def counted(one: Mapping[str, Any]) -> str:
    low, high = one["interval"]
    return f"{one['success']}/{one['goals']} ({100 * low:.0f}–{100 * high:.0f} %)"


def mean_cm(one: Mapping[str, Any]) -> str:
    return f"{one['deviation_cm']['mean']:.2f} cm"


def baselines(one: Mapping[str, Any]) -> list[str]:
    return [f"{one['baselines'][name]['success']}/{one['goals']}" if name in one["baselines"] else "" for name in BASELINES]


def table(title: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    if not rows:
        return ""
    lines = [f"| {' | '.join(cells)} |" for cells in (tuple(name.replace("_", " ") for name in head), ("---",) * len(head), *rows)]
    return f"## {title}\n\n" + "\n".join(lines)
