"""A run folder: everything a trained model is, on disk.

    config.json          sizes, sensors, training configuration, seed, data, commit, versions
    model.safetensors    weights and intention table
    resume.pt            weights, optimiser and update number, to continue a training
    log.jsonl            one line an update
    held_out.jsonl       the errors of held-out episodes, one line a checkpoint, where there are any
    shown.npz            what is kept of the demonstrations: joints and last frames, for the baseline that replays one of them
    calibration.json     what trust in its plans is calibrated by, where it is (`preimage calibrate`)
    README.md            the model card

Files are written beside their place and then moved into it, so that a killed process or a full disk leaves the former file as it was.
What is read is checked once, when it is read: names, shapes, ranges, and that every number is finite. Weights and memory, for which torch
is needed, are read by `storage.networks`.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from preimage.data.view import View, seen_by
from preimage.network.config import Sensors
from preimage.records import HIGHEST_RATE_HZ, LOWEST_RATE_HZ, Body, Demonstration, Shown, number_of
from preimage.storage import hub
from preimage.storage.atomic_write import atomic_write, write_json
from preimage.storage.bundled import BUNDLED
from preimage.storage.reading import read_arrays, read_json, record_of
from preimage.storage.run_files import LOG
from preimage.storage.validation import validate_sensors

if TYPE_CHECKING:
    from preimage.network.pdvmrnn import PDVMRNN

Record = TypeVar("Record")

NETWORK_KEYS = ("model", "sensors", "num_sequences")
"""What of config.json builds the network."""


def find_run(name: str | Path) -> Path:
    """The folder of a run: a path, the name of a bundled model, or where a run of the Hugging Face Hub, `hf:owner/name`, was fetched to.

    Raises:
        ValueError: there is none of them.
        ConnectionError: it is on the Hub, was never fetched, and the Hub cannot be reached.
    """
    if isinstance(name, str) and hub.is_meant(name):
        return hub.download(name)
    path = Path(name)
    if str(name) in BUNDLED and not path.exists():
        path = Path(str(resources.files("preimage"))) / "bundled" / str(name)
    if not (path / "config.json").is_file():
        raise ValueError(
            f"{name} is no run folder: it has no config.json; give a folder that `preimage train` wrote, {', '.join(BUNDLED)}, "
            f"or {hub.PREFIX}OWNER/NAME of the Hugging Face Hub"
        )
    return path


def write_config(folder: Path, model: "PDVMRNN", about: Mapping[str, Any]) -> None:
    """Write config.json: what builds the network again, and what is to be known about the run."""
    num_sequences = len(model.intention_table)
    config = {"model": asdict(model.config), "sensors": asdict(model.sensors), "num_sequences": num_sequences, **about}
    write_json(folder / "config.json", config)


def write_shown(folder: Path, demonstrations: Sequence[Demonstration]) -> None:
    """Write shown.npz: joints, lengths, rates and last frames of the demonstrations."""
    arrays = {
        "last_frames": np.stack([demonstration.frames[-1] for demonstration in demonstrations]),
        "joints": np.concatenate([demonstration.joints for demonstration in demonstrations]).astype(np.float32),
        "lengths": np.array([len(demonstration) for demonstration in demonstrations]),
        "rates_hz": np.array([demonstration.rate_hz for demonstration in demonstrations]),
    }

    with atomic_write(folder / "shown.npz") as path, path.open("wb") as file:
        np.savez_compressed(file, **arrays)


def read_shown(folder: Path) -> list[Shown]:
    """What the run keeps of its demonstrations.

    Raises:
        ValueError: it is missing or broken, or not of the joints and frames of the run.
    """
    path = folder / "shown.npz"
    try:
        arrays = read_arrays(path)
        if missing := [name for name in ("last_frames", "joints", "lengths", "rates_hz") if name not in arrays]:
            raise ValueError(f"it has no {missing[0]}")
        last_frames, joints, lengths, rates_hz = (arrays[name] for name in ("last_frames", "joints", "lengths", "rates_hz"))
        sensors = read_settings(Sensors, folder, "sensors")
        shape = sensors.height, sensors.width, sensors.channels
        if last_frames.dtype != np.uint8 or last_frames.shape[1:] != shape:
            raise ValueError(f"its frames are {last_frames.dtype} of {last_frames.shape[1:]}, the run's uint8 of {shape}")
        if joints.ndim != 2 or joints.shape[1] != sensors.num_joints:
            raise ValueError(f"its joints are {joints.shape}, the run has {sensors.num_joints}")
        if not lengths.shape == rates_hz.shape == (len(last_frames),) or not len(last_frames):
            raise ValueError(f"it has {len(last_frames)} frames, lengths of {lengths.shape} and rates of {rates_hz.shape}")
        if lengths.dtype.kind not in "iu" or lengths.min() < 2 or lengths.sum() != len(joints):
            raise ValueError(f"its lengths do not add up to {len(joints)} steps of joints")
        if not (rates_hz.min() >= LOWEST_RATE_HZ and rates_hz.max() <= HIGHEST_RATE_HZ):
            raise ValueError(f"its rates are {rates_hz.min():g} to {rates_hz.max():g} Hz")
    except ValueError as error:
        raise ValueError(f"{path} cannot be read ({error}): restore it or train again") from error
    ways = np.split(joints.astype(np.float64), np.cumsum(lengths)[:-1])
    return [Shown(*part) for part in zip(last_frames, ways, rates_hz.tolist(), strict=True)]


def read_config(folder: Path) -> dict[str, Any]:
    """The config.json of a run.

    Raises:
        ValueError: it is missing, no JSON, or holds a number that is not finite.
    """
    path = find_run(folder) / "config.json"
    try:
        return read_json(path)
    except ValueError as error:
        raise ValueError(f"{path} holds no settings of a run ({error}): restore it or train again") from error


def made_from(folder: Path) -> dict[str, Any]:
    """Size of a run's network, number of its demonstrations, seed, seconds and machine of its training, as results report them.

    What its config.json, or its log, does not say is None, or, of the seconds, not there.
    """
    config = read_config(folder)
    made = {name: config.get(name) for name in ("size", "num_demonstrations")}
    made |= {"training_seed": part_of(config, "train").get("seed"), "trained_on": part_of(config, "provenance").get("machine")}
    return made | ({"training_seconds": training_seconds(folder)} if (folder / LOG).is_file() else {})


def part_of(config: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    """What config.json holds under a key, where it holds anything."""
    part = config.get(key)
    return part if isinstance(part, Mapping) else {}


def training_seconds(folder: Path) -> float:
    """Seconds of all updates of a run."""
    return round(sum(line["seconds"] for line in read_log(folder)), 1)


def read_log(folder: Path, *, name: str = LOG) -> list[dict[str, Any]]:
    """The lines of a run's log, or of that of its held-out episodes, but for a last one that was cut short by a kill.

    Raises:
        ValueError: the log is missing, or a line of it is none of a training.
    """
    path = folder / name
    if not path.is_file():
        raise ValueError(f"{folder} has no {name}, of which the model card tells: restore it or train again")
    texts = path.read_text(encoding="utf-8", errors="replace").splitlines()
    lines: list[dict[str, Any]] = []
    for number, text in enumerate(texts, start=1):
        try:
            line = json.loads(text)
            if not all(isinstance(line[name], int | float) for name in ("update", "visual", "proprioceptive", "seconds")):
                raise ValueError("no number")
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            if number == len(texts) > 1:
                break
            raise ValueError(f"{path} is damaged in line {number}: restore it or train again") from error
        lines.append(line)
    if not lines:
        raise ValueError(f"{path} holds no update yet: train for a while first")
    return lines


def read_settings(record: type[Record], folder: Path, key: str) -> Record:
    """The settings that config.json holds under a key.

    Raises:
        ValueError: it holds none, or those of another version.
    """
    config = read_config(folder)
    if not any(each in config for each in NETWORK_KEYS):
        kind = config.get("model_type") or config.get("type")
        other = f", but holds a model of another program ({kind:.40})" if isinstance(kind, str) else ""
        none = f"its config.json has none of {', '.join(NETWORK_KEYS)}"
        raise ValueError(f"{folder} is no run{other}: {none}; give a folder that `preimage train` wrote")
    if key not in config:
        raise ValueError(f"{folder}/config.json has no {key} settings: train again")
    try:
        found = record_of(record, config[key])
        if isinstance(found, Sensors):
            validate_sensors(found)
        return found
    except ValueError as error:
        raise ValueError(f"{folder}/config.json has no {key} settings that are known here ({error}): train again") from error


def read_view(name: str | Path) -> View:
    """How the run looked at the recordings that it learned from, and so how its starts and goals are to be looked at.

    Raises:
        ValueError: there is no such run, or its config.json is broken.
    """
    return kept_by(name, View, "view", seen_by)


def episodes_of(name: str | Path) -> tuple[int, ...] | None:
    """The numbers of the episodes that the run was given, trained on or held out; None where it was given all there are, or does not say.

    Raises:
        ValueError: there is no such run, or its config.json is broken.
    """
    data = read_config(find_run(name)).get("data")
    kept = data.get("episodes") if isinstance(data, dict) else None
    return tuple(kept) if isinstance(kept, list) and all(isinstance(number, int) for number in kept) else None


def read_body(name: str | Path) -> Body:
    """All joints of the recordings that the run learned from, those that it does not move too.

    Raises:
        ValueError: there is no such run, its config.json is broken, or it does not say where a joint is held.
    """
    folder = find_run(name)
    body = kept_by(folder, Body, "body", lambda sensors: Body(sensors.joint_names))
    moved = read_settings(Sensors, folder, "sensors").joint_names
    if missing := [joint for joint in moved if joint not in body.joint_names]:
        raise ValueError(f"{folder}/config.json moves {missing[0]}, which is none of the joints of its body: train again")
    if unheld := [joint for joint in body.joint_names if joint not in moved and joint not in body.held]:
        raise ValueError(f"{folder}/config.json does not say where {unheld[0]} is held: train again")
    return body


def kept_by(name: str | Path, record: type[Record], key: str, otherwise: Callable[[Sensors], Record]) -> Record:
    """What a run keeps under a key; of one that was not trained by `preimage train`, or before it kept this, what its sensors say."""
    folder = find_run(name)
    if key in read_config(folder):
        return read_settings(record, folder, key)
    return otherwise(read_settings(Sensors, folder, "sensors"))


def push_to_hub(run: str | Path, repo_id: str, *, license: str | None = None, private: bool = False) -> str:
    """Send a run to the Hugging Face Hub, from where `hf:owner/name` loads it; the address of its page.

    Sent are config.json, which tells the command that started the training; model.safetensors; shown.npz, which shows the last frames and
    the joints of the demonstrations; and the model card. Do not send what nobody should see.

    Args:
        run: a run folder, or a bundled name.
        repo_id: `owner/name`; a repository that is not there is made.
        license: under which the weights are given, by the Hub's word for it, as `mit`; by default the card says none.
        private: whether a new repository is to be seen by its owner alone.

    Raises:
        ValueError: there is no such run, it has no checkpoint yet, the name is none, or nobody is logged in who may write there.
        ConnectionError: the Hub cannot be reached.
    """
    folder = find_run(run)
    if not (folder / hub.CARD).exists():  # it was trained by `train`, or not to the end
        write_card(folder)
    return hub.upload(folder, repo_id, license=license, private=private)


def write_card(folder: Path) -> None:
    """Write README.md, the model card: what the model is, what it learned from, how it was made, what it is not for."""
    config, lines = read_config(folder), read_log(folder)
    train, provenance = part_of(config, "train"), part_of(config, "provenance")
    last = lines[-1]
    demonstrations = number_of(config.get("num_demonstrations", config.get("num_sequences", 0)), "demonstration")
    minutes = sum(line["seconds"] for line in lines) / 60
    card = f"""---
library_name: preimage
pipeline_tag: robotics
tags: [robotics, predictive-coding, imitation-learning]
---
# {folder.name}

A P-DVMRNN (Choi, Matsumoto, Jung, Tani 2018) of size `{config.get("size")}`, trained on {demonstrations}
of task `{config.get("task")}` (data `{part_of(config, "data").get("fingerprint")}`).

| | |
|---|---|
| made by | `{provenance.get("command")}` |
| updates | {last["update"]} of {train.get("updates")}, {minutes:.0f} minutes on {provenance.get("machine")} |
| error at the end | vision {last["visual"]:.2f}, joints {last["proprioceptive"]:.4f} |
| commit, day | {provenance.get("commit")}, {provenance.get("date")} |
| versions | {", ".join(f"{name} {number}" for name, number in part_of(provenance, "versions").items())} |

`config.json` holds all settings and seeds, `log.jsonl` of the run folder the errors update by update. Plan with it by
`preimage plan RUN --goal IMAGE --out PLAN`. It knows one arm, one camera and one kind of task: those it was shown.
"""
    with atomic_write(folder / "README.md") as path:
        path.write_text(card, encoding="utf-8", errors="backslashreplace")
