"""The verbs that lead from recordings to a trained model: record, check, train.

What a verb's signature does not need is loaded in its function, so that a word that is off is answered at once.
"""

import sys
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from tyro.conf import Positional

from preimage.cli.errors import is_first_here
from preimage.cli.screen import followed, following, known_task, validate_seed
from preimage.cli.tensorboard import scalars_to, validate_tensorboard
from preimage.compute.choices import Device
from preimage.data.clocks import bounds, is_rate
from preimage.data.view import View
from preimage.network.config import ModelConfig
from preimage.presets import Preset, TrainOptions, network_config, train
from preimage.records import number_of
from preimage.storage.output_folders import validate_output_file, validate_output_folder

CHECK_PAGE = {"noun": "page", "marks": (b"<!doctype html>", b"preimage check")}


def record_(task: Positional[str], count: int, out: Path, seed: int = 0, pixels: int = 64) -> None:
    """Record demonstrations of a task on the simulated arm, as a LeRobotDataset v3.0.

    Args:
        task: name of the task.
        count: how many demonstrations.
        out: folder to write, new or empty.
        seed: draws the scenes and the demonstrator's hand.
        pixels: height and width of the frames.
    """
    from preimage.robot import TASKS, Arm, record, with_frames
    from preimage.storage.recordings import save

    known_task(task)
    if not 16 <= pixels <= 1024:
        raise ValueError(f"--pixels is {pixels}: give 16 to 1024")
    validate_seed(seed)
    validate_output_folder(out)
    arm, filmed = Arm(), with_frames(TASKS[task], pixels)
    with following("recording", total=count) as follow:
        demonstrations = record(arm, filmed, count=count, seed=seed, progress=lambda done, _all: follow(done=done))
    save(demonstrations, out, task=task, joint_unit=arm.joint_unit)
    steps = sum(map(len, demonstrations))
    print(f"{number_of(count, 'demonstration')}, {number_of(steps, 'step')} at {TASKS[task].rate_hz:g} Hz, in {out}")


def check(
    data: Positional[Path],
    out: Path = Path("check.html"),
    episodes: tuple[int, ...] | None = None,
    without_episodes: tuple[int, ...] = (),
    rate_hz: float = ModelConfig.rate_hz,
    view: View = View(),  # noqa: B008, frozen
) -> None:
    """Say whether recordings can be learned from, what is wrong with them and what would help.

    Args:
        data: a LeRobotDataset, v3.0, v2.1 or v2.0, or a folder of pictures and tables of joints.
        out: page to write, with pictures.
        episodes: numbers of the episodes to look at; by default all.
        without_episodes: numbers of episodes to leave out.
        rate_hz: steps a second of the model that is going to be trained.
        view: how the recordings are looked at.
    """
    from preimage.data.dataset import describe, episode_numbers, read_episodes
    from preimage.examination import examine
    from preimage.report import examined_page

    validate_output_file(out, **CHECK_PAGE)
    if not is_rate(rate_hz):
        raise ValueError(f"--rate-hz is {rate_hz}: {bounds()}")
    recordings = read_episodes(data, view=view, only=episodes, without=without_episodes)
    total = len(episode_numbers(data)) if episodes is None else len(episodes)
    recordings = followed(recordings, "reading episodes", total=total - len(without_episodes))
    examination = examine(recordings, rate_hz=rate_hz, joints_chosen=view.joints is not None)
    about = describe(data, state=view.state)
    camera = view.camera or next(iter(about.cameras))
    examined_page(examination, out, title=f"preimage check: {data.name}", camera=camera, joint_unit=about.joint_unit)
    for finding in examination.findings:
        print(finding)
    print(f"the pictures are in {out}")
    print(examination.verdict)
    if not examination.trainable:
        raise SystemExit(1)


def train_(
    data: Positional[Path],
    out: Path,
    size: Literal["tiny", "small", "paper"] = "small",
    resume: bool = False,
    device: Device = "auto",
    devices: int = 1,
    num_nodes: int = 1,
    episodes: tuple[int, ...] | None = None,
    without_episodes: tuple[int, ...] = (),
    hold_out: int = 0,
    rate_hz: float | None = None,
    intention: Literal["latent", "free"] | None = None,
    intention_dimensions: int | None = None,
    intention_cost: float | None = None,
    intention_layers: tuple[str, ...] | None = None,
    seen_channels: int | None = None,
    keypoints: int | None = None,
    tensorboard: bool = False,
    view: View = View(),  # noqa: B008, frozen
    as_: Annotated[Preset, tyro.conf.arg(name="as")] = "full",
    config: Annotated[TrainOptions, tyro.conf.arg(name="")] = TrainOptions(),  # noqa: B008, frozen
) -> None:
    """Train a network on the demonstrations of a data set.

    Args:
        data: a LeRobotDataset, v3.0, v2.1 or v2.0, or a folder of pictures and tables of joints.
        out: run folder to write.
        size: tiny learns nothing worth seeing, small takes minutes on two cores, paper is Table I.
        resume: go on with the run in `out`, with the sizes, settings and held-out episodes it was started with.
        device: what computes; auto is a GPU where there is one, or one for each of the devices.
        devices: processes on this machine that share every update.
        num_nodes: machines with as many processes each, started by torchrun or Slurm.
        episodes: numbers of the episodes to learn from; by default all. The run keeps them.
        without_episodes: numbers of episodes to leave out.
        hold_out: every Nth episode is not trained on but kept for `preimage evaluate --data`; 0 trains on all.
        rate_hz: steps a second that the model runs at, instead of the size's own.
        intention: latent, a few Gaussian numbers, or free, the initial states themselves, as in the paper.
        intention_dimensions: numbers that make an intention, instead of the size's own.
        intention_cost: charge for the information in an intention, instead of the size's own: more where most can be seen at the start.
        intention_layers: layers whose initial states are the intention, instead of the size's own: top where most can be seen.
        seen_channels: feature maps that carry vision to the motors, instead of the size's own.
        keypoints: points whose places go from vision to the motors besides, for small things that have to be found; none by default.
        tensorboard: write the errors for TensorBoard too, into the run folder (extra `tensorboard`).
        view: how the recordings are looked at.
        as_: paper is the paper's network and learning alone; regression and full begin with a latent intention.
        config: how the network learns.
    """
    from preimage.compute.precision import describe_precision
    from preimage.compute.processes import join_processes
    from preimage.data.dataset import fingerprint, open_recordings
    from preimage.evaluation.held_out import every_nth
    from preimage.examination import validate
    from preimage.method.train import Progress as Told
    from preimage.report import learning_curve
    from preimage.storage.checkpoints import goes_on
    from preimage.storage.provenance import provenance
    from preimage.storage.runs import read_settings, read_view, write_card

    if tensorboard:
        validate_tensorboard()
    resumed = goes_on(out, resume=resume)
    if resumed:
        view, episodes, without_episodes = read_view(out), episodes_to_resume(out, data), ()
    with following("reading episodes", shown=is_first_here()) as follow:
        opened = open_recordings(data, view=view, only=episodes, without=without_episodes, progress=follow)
    recorded, lines = opened.demonstrations, list(opened.summary)
    validate(recorded, opened.episodes)
    learned_from = {"name": data.name, "fingerprint": fingerprint(recorded), "episodes": list(opened.episodes)}
    learned_from |= {"held_out": [opened.episodes[place] for place in every_nth(len(recorded), hold_out)]}
    capacity = {
        "intention": intention,
        "intention_dimensions": intention_dimensions,
        "intention_cost": intention_cost,
        "intention_layers": intention_layers,
    }
    model_config = sized(size, as_, rate_hz=rate_hz, seen_channels=seen_channels, keypoints=keypoints, **capacity)
    if resumed:
        learned_from = begun_with(out, data, learned_from["fingerprint"])
        config, told = settings_to_go_on_with(out, config)
        model_config = read_settings(ModelConfig, out, "model")
        lines += told
    held_out = learned_from.get("held_out", [])
    demonstrations = [one for episode, one in zip(opened.episodes, recorded, strict=True) if episode not in held_out]
    about = {"size": size, "preset": as_, "num_demonstrations": len(demonstrations), "data": learned_from}
    group = join_processes(devices=devices, num_nodes=num_nodes, device=device)
    lines.append(describe_precision(config.precision, group.device))
    about |= {"view": asdict(opened.view), "body": asdict(opened.body)}
    about |= {"task": task_of(demonstrations) or opened.task, "provenance": provenance(group.device)}
    with following("training", total=config.updates, shown=group.first) as follow:
        shown = scalars_to(out) if tensorboard else None

        def tell(told: Told) -> None:
            if shown:
                shown(told)
            while lines:  # now that nothing is refused any more, and what is printed is not beside the point
                print(lines.pop(0))
            follow(done=told.update, text=f"vision {told.visual:8.2f}  joints {told.proprioceptive:.4f}")

        train(demonstrations, model_config, config=config, folder=out, resume=resume, about=about, progress=tell, group=group)
    if not group.first:
        return
    for line in lines:  # of a run that had all its updates
        print(line)
    learning_curve(out / "log.jsonl", out / "learning_curve.png")
    write_card(out)
    left_out = f", {len(held_out)} held out" if held_out else ""
    print(f"trained on {number_of(len(demonstrations), 'demonstration')}{left_out}; the run is in {out}")


def settings_to_go_on_with(out: Path, asked: TrainOptions) -> tuple[TrainOptions, list[str]]:
    """The settings that the run in `out` was started with, to as many updates as are asked for now; and what there is to say of it."""
    from preimage.storage.runs import read_settings

    kept = read_settings(TrainOptions, out, "train")
    given = asked.updates != TrainOptions.updates or any(word.split("=")[0] == "--updates" for word in sys.argv)
    config = replace(kept, updates=asked.updates) if given else kept
    lines = []
    if replace(asked, updates=1) not in (replace(TrainOptions(), updates=1), replace(kept, updates=1)):
        lines.append(f"{out} goes on with the settings it was started with; those given now are left aside")
    if config != kept:
        lines.append(
            f"{out} goes on to {number_of(config.updates, 'update')} instead of {kept.updates}, at the rates of a training so long"
        )
    return config, lines


def sized(size: str, preset: Preset, **asked: Any) -> ModelConfig:
    """The network of a size and a preset, with what was asked for in place of its own; ValueError where that is out of range."""
    return replace(network_config(size, preset), **{name: value for name, value in asked.items() if value is not None})


def episodes_to_resume(out: Path, data: Path) -> tuple[int, ...] | None:
    """The episodes that the run in `out` was given; ValueError where the data have others."""
    from preimage.data.dataset import episode_numbers
    from preimage.storage.runs import episodes_of

    given = episodes_of(out)
    if given and not set(given) <= set(episode_numbers(data)):
        raise ValueError(f"{out} was trained on other demonstrations than those in {data}: resume with the same data")
    return given


def begun_with(out: Path, data: Path, now: str) -> dict[str, Any]:
    """What the run in `out` learned from; ValueError where that has another fingerprint than now."""
    from preimage.storage.runs import find_run, read_config

    learned_from = read_config(find_run(out)).get("data")
    if not isinstance(learned_from, dict) or learned_from.get("fingerprint") != now:
        raise ValueError(f"{out} was trained on other demonstrations than those in {data}: resume with the same data")
    return learned_from


def task_of(demonstrations: list) -> str | None:
    scene = demonstrations[0].scene
    return scene.task if scene else None
