"""The verb that turns recordings into a trained model: train.

What the verb's signature does not need is loaded in its functions, so that a word that is off is answered at once.
"""

import shlex
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from tyro.conf import Positional

from preimage.cli.errors import is_first_here
from preimage.cli.screen import following
from preimage.cli.tensorboard import scalars_to, validate_tensorboard
from preimage.compute.choices import Device
from preimage.data.view import View
from preimage.network.config import ModelConfig
from preimage.presets import Preset, TrainOptions, network_config, train
from preimage.records import number_of
from preimage.storage.run_files import HELD_OUT, LOG

if TYPE_CHECKING:
    from preimage.compute.processes import ProcessGroup
    from preimage.data.dataset import Opened
    from preimage.examination import Seen
    from preimage.method.learner import Progress
    from preimage.records import Demonstration


@dataclass(frozen=True)
class NetworkOptions:
    """What is asked of the network in place of the size's own."""

    rate_hz: float | None = None
    """Steps a second that the model runs at, instead of the size's own."""
    intention: Literal["latent", "free"] | None = None
    """latent, a few Gaussian numbers, or free, the initial states themselves, as in the paper."""
    intention_dimensions: int | None = None
    """Numbers that make an intention, instead of the size's own."""
    intention_cost: float | None = None
    """Charge for the information in an intention, instead of the size's own: more where most can be seen at the start."""
    intention_layers: tuple[str, ...] | None = None
    """Layers whose initial states are the intention, instead of the size's own: top where most can be seen."""
    intention_noise: float | None = None
    """Standard deviation of the noise on a free intention while training, in those of the training intentions."""
    seen_channels: int | None = None
    """Feature maps that carry vision to the motors, instead of the size's own."""
    keypoints: int | None = None
    """Points whose places go from vision to the motors besides, for small things that have to be found; none by default."""

    def network(self, size: str, preset: Preset) -> ModelConfig:
        """The network of a size and a preset, changed as asked; ValueError where that is out of range."""
        return replace(network_config(size, preset), **{name: value for name, value in vars(self).items() if value is not None})


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
    tensorboard: bool = False,
    network: Annotated[NetworkOptions, tyro.conf.arg(name="")] = NetworkOptions(),
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
        tensorboard: write the errors for TensorBoard too, into the run folder (extra `tensorboard`).
        network: what differs from the size's own.
        view: how the recordings are looked at.
        as_: paper and regression learn as the paper does, with a free intention; full begins with a latent one.
        config: how the network learns.
    """
    from preimage.compute.precision import describe_precision
    from preimage.compute.processes import join_processes
    from preimage.report.figures import learning_curve
    from preimage.storage.checkpoints import goes_on
    from preimage.storage.provenance import provenance
    from preimage.storage.runs import read_settings, read_view, write_card

    if tensorboard:
        validate_tensorboard()
    resumed = goes_on(out, resume=resume)
    if resumed:
        view, episodes, without_episodes = read_view(out), episodes_to_resume(out, data), ()
    model_config = network.network(size, as_)
    opened, warnings = open_to_learn_from(data, view, rate_hz=model_config.rate_hz, only=episodes, without=without_episodes)
    lines, learned_from = list(opened.summary), said_of(opened, data, hold_out)
    if not resumed:
        lines += warnings
    else:
        learned_from = begun_with(out, data, learned_from["fingerprint"])
        model_config = read_settings(ModelConfig, out, "model")
        config, told = settings_to_go_on_with(out, config)
        lines += told
    recorded = dict(zip(opened.episodes, opened.demonstrations, strict=True))
    held_out = [recorded.pop(episode) for episode in learned_from.get("held_out", []) if episode in recorded]
    demonstrations = list(recorded.values())
    group = join_processes(devices=devices, num_nodes=num_nodes, device=device)
    lines.append(describe_precision(config.precision, group.device))
    about = {"size": size, "preset": as_, "num_demonstrations": len(demonstrations), "data": learned_from}
    about |= {"view": asdict(opened.view), "body": asdict(opened.body)}
    about |= {"task": task_of(demonstrations) or opened.task, "provenance": provenance(group.device)}
    kept = {"folder": out, "resume": resume, "about": about, "held_out": held_out}
    follow_training(demonstrations, model_config, lines, config=config, group=group, tensorboard=tensorboard, **kept)
    if not group.first:
        return
    learning_curve(out / LOG, out / "learning_curve.png", held_out=out / HELD_OUT)
    write_card(out)
    left_out = f", {len(held_out)} held out" if held_out else ""
    print(f"trained on {number_of(len(demonstrations), 'demonstration')}{left_out}; the run is in {out}")


def follow_training(
    demonstrations: "list[Demonstration]",
    model_config: ModelConfig,
    lines: list[str],
    *,
    config: TrainOptions,
    group: "ProcessGroup",
    folder: Path,
    tensorboard: bool,
    **kept: Any,
) -> None:
    """Train, and show how far it is; the lines that there are to say first are printed once nothing is refused any more."""
    with following("training", total=config.updates, shown=group.first) as follow:
        shown = scalars_to(folder) if tensorboard else None

        def tell(told: "Progress") -> None:
            if shown:
                shown(told)
            while lines:  # what is printed before an update is beside the point where that is refused
                print(lines.pop(0))
            follow(done=told.update, text=f"vision {told.visual:8.2f}  joints {told.proprioceptive:.4f}")

        train(demonstrations, model_config, config=config, progress=tell, group=group, folder=folder, **kept)
    for line in lines if group.first else ():  # of a run that had all its updates
        print(line)


def open_to_learn_from(data: Path, view: View, *, rate_hz: float, **which: Any) -> "tuple[Opened, list[str]]":
    """The recordings, and a line on what `preimage check` warns of, if it does; ValueError where they cannot be learned from.

    Args:
        rate_hz: steps a second of the model.
        which: the episodes that are asked for.
    """
    from preimage.data.dataset import open_recordings, written_here
    from preimage.examination import examination_of, look_through

    seen: list[Seen] = []
    with following("reading episodes", shown=is_first_here()) as follow:
        look = lambda episode: seen.append(look_through(episode, rate_hz=rate_hz))  # noqa: E731
        opened = open_recordings(data, view=view, progress=follow, look=look, **which)
    examination = examination_of(seen, joints_chosen=view.joints is not None or written_here(data))
    examination.validate()
    found = examination.warnings
    kinds = ", ".join(dict.fromkeys(finding.kind.value for finding in found))
    says = f"preimage check {shlex.quote(str(data))} says where, and what would help"
    return opened, [f"{number_of(len(found), 'warning')} ({kinds}): {says}"] if found else []


def said_of(opened: "Opened", data: Path, hold_out: int) -> dict[str, Any]:
    """What a run's config.json says of the data it learned from."""
    from preimage.data.dataset import fingerprint
    from preimage.evaluation.held_out import every_nth

    held_out = [opened.episodes[place] for place in every_nth(len(opened.episodes), hold_out)]
    return {"name": data.name, "fingerprint": fingerprint(opened.demonstrations), "episodes": list(opened.episodes), "held_out": held_out}


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
    from preimage.storage.reading import is_of, kind_of, tupled
    from preimage.storage.runs import find_run, part_of, read_config

    learned_from = part_of(read_config(find_run(out)), "data")
    if learned_from.get("fingerprint") != now:
        raise ValueError(f"{out} was trained on other demonstrations than those in {data}: resume with the same data")
    held_out = learned_from.get("held_out", [])
    if not is_of(tupled(held_out), tuple[int, ...]):
        raise ValueError(f"{out}/config.json holds out {kind_of(held_out)}, not numbers of episodes: restore it or train again")
    return dict(learned_from)


def task_of(demonstrations: "list[Demonstration]") -> str | None:
    scene = demonstrations[0].scene
    return scene.task if scene else None
