"""How near plans come to recordings that were never trained on: what can be measured without the robot.

Each held-out episode is planned anew, from its first percept to its last frame, and what is imagined is compared with what was recorded.
That is no success rate: no robot moved, and a way that differs from the recorded one may lead to the goal as well. Beside it stand the
demonstration that ends most alike, the straight way to the joints that memory expects at the goal, the same model without a goal, and
staying at the start.

Two ways of different lengths are compared at the same share of the way, from 0 at the start to 1 at arrival (time-normalised).

>>> every_nth(10, 4)
[3, 7]
>>> moments(np.array([[0.0], [1.0], [2.0]]), 5)[:, 0].tolist()
[0.0, 0.5, 1.0, 1.5, 2.0]
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Shaped, UInt8

from preimage.compute.processes import ProcessGroup
from preimage.data.dataset import fingerprint, open_recordings
from preimage.data.sequences import at_rate
from preimage.evaluation.evaluate import goal_of, nearest_shown
from preimage.presets import Planner, PlanOptions, load_planner
from preimage.records import Demonstration, Plan, Shown, number_of
from preimage.report.films import film
from preimage.storage.atomic_write import write_json
from preimage.storage.provenance import provenance
from preimage.storage.runs import episodes_of, find_run, made_from, part_of, read_config, read_shown, read_view

NOTE = "How near what is imagined comes to what was recorded. This is no success rate: no robot moved, and other ways may lead there too."
NUM_MOMENTS = 50
"""Moments, evenly spread over the way, at which two ways are compared."""
MAX_LISTED = 20
"""At most so many episodes are listed by number."""


@dataclass(frozen=True)
class Errors:
    """How far one way through percepts is from the recorded one. Joints in the unit of the data; frames in grey levels, squared."""

    joints_at_arrival: float
    """Absolute difference of the joints at the end of both ways, mean over joints."""
    joints_at_arrival_rms: float
    """Root of the mean square over joints, likewise."""
    joints_on_the_way: float
    """Absolute difference, mean over joints and moments of the way."""
    joints_on_the_way_rms: float
    frame_at_arrival: float | None
    """Mean squared difference of the last frames, over pixels and channels of 0 to 255; None where a way has joints alone."""
    frames_on_the_way: float | None
    """The same, mean over moments of the way; None where nothing but the last frame is known."""


@dataclass(frozen=True, eq=False)
class Compared:
    """One recorded episode, the plan from its first percept to its last frame, and the errors of plan and baselines."""

    episode: int
    demonstration: Demonstration
    plan: Plan
    imagined: Errors
    by_joint: Float[np.ndarray, " J"]
    """Absolute difference of each joint at arrival, in the unit of the data."""
    baselines: Mapping[str, Errors]


@dataclass(frozen=True, eq=False)
class Way:
    """What joints and camera went through, from the start to the arrival."""

    joints: Float[np.ndarray, "T J"]
    last_frame: UInt8[np.ndarray, "H W C"] | None = None
    frames: UInt8[np.ndarray, "T H W C"] | None = None


def every_nth(num_episodes: int, nth: int) -> list[int]:
    """The episodes that are held out: every nth, counted from 1; none where nth is 0.

    Raises:
        ValueError: nth would leave nothing to train on, or nothing to hold out.
    """
    if nth == 0:
        return []
    if not 2 <= nth <= num_episodes:
        raise ValueError(
            f"hold-out is {nth} with {number_of(num_episodes, 'episode')}: give 2 to as many as there are, or 0 to train on all"
        )
    return list(range(nth - 1, num_episodes, nth))


def never_shown(demonstrations: Sequence[Demonstration], shown: Sequence[Shown]) -> list[int]:
    """The episodes that a model was not trained on, by number: those that are not among the demonstrations its run keeps."""
    return [index for index, one in enumerate(demonstrations) if not any(is_same(one, other) for other in shown)]


def compare(
    planner: Planner,
    demonstrations: Mapping[int, Demonstration],
    *,
    shown: Sequence[Shown],
    progress: Callable[[Compared], None] | None = None,
    group: ProcessGroup = ProcessGroup(),  # noqa: B008, frozen
) -> list[Compared]:
    """Plan from the first percept to the last frame of each recording, and compare.

    Args:
        demonstrations: the recordings, by number of the episode.
        shown: the demonstrations the model was trained on, for the baseline that replays one of them.
        progress: called after each episode of this process.
        group: the processes that share the episodes; each gets the results of all.

    Raises:
        ValueError: the recordings have other joints or frames than the model's.
        ProcessLost: another process of the group is no longer there.
    """
    model = planner.model
    for episode, one in demonstrations.items():
        if one.joint_names != model.sensors.joint_names:
            raise ValueError(f"episode {episode} has joints {one.joint_names}, the model was trained with {model.sensors.joint_names}")
    compared, episodes = dict[int, Compared](), list(demonstrations)
    for episode in (episodes[number] for number in group.share(len(episodes))):
        one = demonstrations[episode]
        found = planner.plan(start=one.first, goal=goal_of(one, planner))
        baselines = {name: errors_of(one, way) for name, way in baselines_of(planner, one, found, shown).items()}
        by_joint = np.abs(found.joints[found.arrival_step] - one.joints[-1])
        compared[episode] = Compared(episode, one, found, errors_of(one, way_of(found)), by_joint, baselines)
        if progress:
            progress(compared[episode])
    return group.gather(compared)


def compare_run(
    run: str,
    data: Path,
    *,
    out: Path,
    film_folder: Path | None,
    options: PlanOptions,
    progress: Callable[[int, int], None],
    group: ProcessGroup = ProcessGroup(),  # noqa: B008, frozen
    only: Collection[int] | None = None,
    without: Collection[int] = (),
) -> list[str]:
    """Compare a run with the episodes of a data set that it was not trained on, and write the result as JSON and a few films.

    Args:
        only: numbers of the episodes to compare with; by default all; of the data set that was trained on, those that the run was given.
        without: numbers of episodes to leave out.
        progress: called after each episode of this process with the number done and the number of its own.
        group: the processes that share the episodes, of which only the first writes.

    Returns:
        the result in a few lines.

    Raises:
        ValueError: there is no such run or data set, they do not fit together, or every episode was trained on.
    """
    folder = find_run(run)
    planner, shown = load_planner(folder, options, device=group.device), read_shown(folder)
    if only is None and part_of(read_config(folder), "data").get("name") == data.name:
        only = episodes_of(folder)
    opened = open_recordings(data, view=read_view(folder), only=only, without=without)
    recorded = dict(zip(opened.episodes, opened.demonstrations, strict=True))
    episodes = [opened.episodes[place] for place in never_shown(opened.demonstrations, shown)]
    if not episodes:
        raise ValueError(f"{run} was trained on every episode of {data}: train with --hold-out 4, or give other recordings")
    done: list[Compared] = []

    def report(one: Compared) -> None:
        done.append(one)
        progress(len(done), len(group.share(len(episodes))))

    chosen = {episode: recorded[episode] for episode in episodes}
    compared = compare(planner, chosen, shown=shown, progress=report, group=group)
    result = result_of_comparison(
        compared,
        about_run(run, folder, data, opened.demonstrations) | {"plan": asdict(planner.options), "provenance": provenance(group.device)},
    )
    if not group.first:
        return []
    write_json(out, result)
    written = write_films(compared, film_folder) if film_folder else []
    return lines_of(result) + [f"film: {path}" for path in written]


def result_of_comparison(compared: Sequence[Compared], about: dict[str, Any]) -> dict[str, Any]:
    """Medians and means over the episodes, and a row for each of them, ready to be written as JSON.

    Args:
        about: what was compared and how: model, data, plan and whatever else should be kept.
    """
    seconds = np.array([one.plan.seconds for one in compared])
    names = compared[0].demonstration.joint_names
    by_joint = np.mean([one.by_joint for one in compared], axis=0)
    ways = {"imagined": [one.imagined for one in compared]}
    ways |= {name: [one.baselines[name] for one in compared] for name in compared[0].baselines}
    counted = {name: spread_of(errors) for name, errors in ways.items()}
    against = {name: ratios(counted["imagined"], counted[name]) for name in compared[0].baselines}
    return {
        **about,
        "note": NOTE,
        "units": {"joints": "as in the data", "frames": "grey levels of 0 to 255, squared"},
        "along_the_way": "time-normalised: compared at the same share of the way from start to arrival",
        "episodes": [one.episode for one in compared],
        "imagined": counted.pop("imagined"),
        "imagined_by_joint": dict(zip(names, by_joint.round(6).tolist(), strict=True)),
        "baselines": counted,
        "imagined_as_share_of": against,
        "seconds_per_plan": round(float(seconds.mean()), 3),
        "seconds_per_plan_max": round(float(seconds.max()), 3),
        "rows": [row_of(one) for one in compared],
    }


def lines_of(result: Mapping[str, Any]) -> list[str]:
    """A result in a few lines, for people."""
    episodes = result["episodes"]
    listed = ", ".join(map(str, episodes[:MAX_LISTED])) + (", ..." if len(episodes) > MAX_LISTED else "")
    heads = "joints at arrival", "joints on the way", "frame at arrival"
    lines = [
        f"{number_of(len(episodes), 'episode')} never trained on: {listed}",
        f"{'mean (median) error':22s}" + "".join(f"{head:>24s}" for head in heads),
    ]
    for name, counted in {"imagined": result["imagined"], **result["baselines"]}.items():
        cells = [counted[key] for key in ("joints_at_arrival", "joints_on_the_way", "frame_at_arrival")]
        lines.append(
            f"{name:22s}" + "".join(f"{cell['mean']:>13.4g} ({cell['median']:>8.4g})" if cell else f"{'–':>24s}" for cell in cells)
        )
    shares = result["imagined_as_share_of"]
    for what, key, against in (
        ("joints are", "joints_at_arrival", "nearest_demonstration"),
        ("frame is", "frame_at_arrival", "staying"),
    ):
        if (share := shares[against][key]) is not None:
            lines.append(f"At arrival the imagined {what} off by {share:.2f} of the error of {against}, on average.")
    return [*lines, "Joints are in the unit of the data, frames in squared grey levels (0 to 255).", result["note"]]


def write_films(compared: Sequence[Compared], folder: Path) -> list[Path]:
    """Films of the episodes with the smallest, the middle and the largest error of the joints at arrival, recorded beside imagined."""
    ranked = sorted(compared, key=lambda one: one.imagined.joints_at_arrival)
    chosen = {len(ranked) - 1: "worst", (len(ranked) - 1) // 2: "median", 0: "best"}
    paths = []
    for rank, name in sorted(chosen.items()):
        one = ranked[rank]
        recorded = at_rate(one.demonstration, one.plan.rate_hz)
        paths.append(film(one.plan, None, folder / f"{name}-episode-{one.episode}.mp4", recorded=recorded))
    return paths


def moments(values: Float[np.ndarray, "T J"], count: int) -> Float[np.ndarray, "N J"]:
    """The values at `count` moments evenly spread from the first step to the last, straight lines between steps."""
    steps, wanted = np.arange(len(values)), np.linspace(0, len(values) - 1, count)
    return np.stack([np.interp(wanted, steps, column) for column in values.T], axis=-1)  # (N, J)


def frames_at_moments(frames: UInt8[np.ndarray, "T H W C"], count: int) -> UInt8[np.ndarray, "N H W C"]:
    """The frames nearest to the moments, as there are none between two steps."""
    return frames[np.linspace(0, len(frames) - 1, count).round().astype(int)]


def about_run(run: str, folder: Path, data: Path, recorded: Sequence[Demonstration]) -> dict[str, Any]:
    """Which run is compared with which data, and whether those are the data whose other episodes it was trained on."""
    trained_on, name = part_of(read_config(folder), "data"), fingerprint(recorded)
    compared_with = {"name": data.name, "fingerprint": name, "rest_was_trained_on": trained_on.get("fingerprint") == name}
    return {"kind": "held-out", "model": run, "data": compared_with} | made_from(folder)


def is_same(demonstration: Demonstration, shown: Shown) -> bool:
    joints = demonstration.joints.astype(np.float32), shown.joints.astype(np.float32)
    return np.array_equal(*joints) and np.array_equal(demonstration.frames[-1], shown.last_frame)


def way_of(plan: Plan) -> Way:
    end = plan.arrival_step + 1
    return Way(plan.joints[:end], plan.frames[end - 1], plan.frames[:end])


def baselines_of(planner: Planner, one: Demonstration, found: Plan, shown: Sequence[Shown]) -> dict[str, Way]:
    nearest = nearest_shown(shown, one.last)
    expected = {} if found.expected_joints is None else {"memory_alone": Way(np.vstack([one.joints[:1], found.expected_joints]))}
    return {
        "nearest_demonstration": Way(nearest.joints, nearest.last_frame),
        **expected,
        "prior_mean": way_of(planner.imagine_without_goal(one.first)),
        "staying": Way(one.joints[:1], one.frames[0], one.frames[:1]),
    }


def errors_of(recorded: Demonstration, way: Way) -> Errors:
    end = way.joints[-1] - recorded.joints[-1]
    on_the_way = moments(way.joints, NUM_MOMENTS) - moments(recorded.joints, NUM_MOMENTS)
    frames = None
    if way.frames is not None:
        seen, truth = (frames_at_moments(each, NUM_MOMENTS) for each in (way.frames, recorded.frames))
        frames = squared_difference(seen, truth)
    return Errors(
        joints_at_arrival=float(np.abs(end).mean()),
        joints_at_arrival_rms=float(np.sqrt(np.square(end).mean())),
        joints_on_the_way=float(np.abs(on_the_way).mean()),
        joints_on_the_way_rms=float(np.sqrt(np.square(on_the_way).mean())),
        frame_at_arrival=None if way.last_frame is None else squared_difference(way.last_frame, recorded.frames[-1]),
        frames_on_the_way=frames,
    )


def squared_difference(one: Shaped[np.ndarray, "*size"], other: Shaped[np.ndarray, "*size"]) -> float:
    return float(np.square(one.astype(np.float32) - other).mean())


def spread_of(errors: Sequence[Errors]) -> dict[str, dict[str, float] | None]:
    """Mean, median and largest of each error over the episodes."""
    spreads: dict[str, dict[str, float] | None] = {}
    for name in (field.name for field in fields(Errors)):
        values = [getattr(one, name) for one in errors]
        known = None not in values
        spread = {"mean": np.mean(values), "median": np.median(values), "max": np.max(values)} if known else {}
        spreads[name] = {which: round(float(value), 6) for which, value in spread.items()} or None
    return spreads


def ratios(one: Mapping[str, Any], other: Mapping[str, Any]) -> dict[str, float | None]:
    """Mean errors of one way as a share of another's; None where that is unknown or 0."""
    return {name: round(one[name]["mean"] / other[name]["mean"], 4) if other[name] and other[name]["mean"] else None for name in one}


def row_of(one: Compared) -> dict[str, Any]:
    return {
        "episode": one.episode,
        "recorded_steps": len(at_rate(one.demonstration, one.plan.rate_hz)) - 1,
        "arrival_step": one.plan.arrival_step,
        "error": one.plan.error,
        "seconds": round(one.plan.seconds, 3),
        "stopped": one.plan.stopped.name.lower(),
        "imagined": asdict(one.imagined),
        "baselines": {name: asdict(errors) for name, errors in one.baselines.items()},
    }
