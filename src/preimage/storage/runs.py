"""A run folder: everything a trained model is, on disk.

    config.json          sizes, sensors, training configuration, seed, data, commit, versions
    model.safetensors    weights and intention table
    resume.pt            weights, optimiser and update number, to continue a training
    log.jsonl            one line an update
    shown.npz            what is kept of the demonstrations: joints and last frames, for the baseline that replays one of them
    README.md            the model card

Files are written beside their place and then moved into it, so that a killed process or a full disk leaves the former file whole.
"""

import json
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from safetensors.torch import save as to_bytes

from preimage.data.view import View, seen_by
from preimage.network.config import ModelConfig, Sensors
from preimage.network.pdvmrnn import PDVMRNN
from preimage.records import Body, Demonstration, Shown, number_of
from preimage.storage import hub
from preimage.storage.atomic_write import whole_file, write_json

Record = TypeVar("Record")

BUNDLED = ("reach", "two-points", "move-object")
"""Names that stand for the models that come with the program."""


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


def write_config(folder: Path, model: PDVMRNN, about: Mapping[str, Any]) -> None:
    """Write config.json: what builds the network again, and what is to be known about the run."""
    num_sequences = len(model.intention_table)
    config = {"model": asdict(model.config), "sensors": asdict(model.sensors), "num_sequences": num_sequences, **about}
    write_json(folder / "config.json", config)


def write_weights(folder: Path, model: PDVMRNN, dtype: torch.dtype = torch.float32) -> None:
    """Write model.safetensors: weights and intention table, in `dtype` (half precision halves the file); all else as it is."""
    learned = dict(model.named_parameters())
    tensors = {name: (value.to(dtype) if name in learned else value).contiguous() for name, value in model.state_dict().items()}
    with whole_file(folder / "model.safetensors") as path:
        path.write_bytes(to_bytes(tensors))


def write_shown(folder: Path, demonstrations: Sequence[Demonstration]) -> None:
    """Write shown.npz: joints, lengths, rates and last frames of the demonstrations."""
    arrays = {
        "last_frames": np.stack([demonstration.frames[-1] for demonstration in demonstrations]),
        "joints": np.concatenate([demonstration.joints for demonstration in demonstrations]).astype(np.float32),
        "lengths": np.array([len(demonstration) for demonstration in demonstrations]),
        "rates_hz": np.array([demonstration.rate_hz for demonstration in demonstrations]),
    }

    with whole_file(folder / "shown.npz") as path, path.open("wb") as file:
        np.savez_compressed(file, **arrays)


def read_shown(folder: Path) -> list[Shown]:
    """What the run keeps of its demonstrations.

    Raises:
        ValueError: it is missing or broken.
    """
    path = folder / "shown.npz"
    try:
        with path.open("rb") as file, np.load(file) as arrays:
            ways = np.split(arrays["joints"].astype(np.float64), np.cumsum(arrays["lengths"])[:-1])
            parts = zip(arrays["last_frames"], ways, arrays["rates_hz"].tolist(), strict=True)
            return [Shown(*part) for part in parts]
    except (OSError, KeyError, ValueError, TypeError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise ValueError(f"{path} cannot be read ({error}): restore it or train again") from error


def read_config(folder: Path) -> dict[str, Any]:
    """The config.json of a run.

    Raises:
        ValueError: it is missing or no JSON.
    """
    path = find_run(folder) / "config.json"
    try:
        config = json.loads(path.read_text())
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is not JSON ({error}): train again or restore the file") from error
    if not isinstance(config, dict):
        raise ValueError(f"{path} holds a {type(config).__name__}, not the settings of a run: train again or restore the file")
    return config


def made_from(folder: Path) -> dict[str, Any]:
    """Size of a run's network, number of its demonstrations, seed, seconds and machine of its training, as results tell them.

    What its config.json, or its log, does not tell is None, or, of the seconds, not there.
    """
    config = read_config(folder)
    made = {name: config.get(name) for name in ("size", "num_demonstrations")}
    made |= {"training_seed": config.get("train", {}).get("seed"), "trained_on": config.get("provenance", {}).get("machine")}
    return made | ({"training_seconds": training_seconds(folder)} if (folder / "log.jsonl").is_file() else {})


def training_seconds(folder: Path) -> float:
    """Seconds of all updates of a run."""
    return round(sum(json.loads(line)["seconds"] for line in (folder / "log.jsonl").read_text().splitlines()), 1)


def read_settings(record: type[Record], folder: Path, key: str) -> Record:
    """The settings that config.json holds under a key.

    Raises:
        ValueError: it holds none, or those of another version.
    """
    config = read_config(folder)
    try:
        return tuples(record, config[key])
    except (KeyError, TypeError, AttributeError) as error:
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
        ValueError: there is no such run, or its config.json is broken.
    """
    return kept_by(name, Body, "body", lambda sensors: Body(sensors.joint_names))


def kept_by(name: str | Path, record: type[Record], key: str, told_by: Callable[[Sensors], Record]) -> Record:
    """What a run keeps under a key; of one that was not trained by `preimage train`, or before it kept this, what its sensors tell."""
    folder = find_run(name)
    if key in read_config(folder):
        return read_settings(record, folder, key)
    return told_by(read_settings(Sensors, folder, "sensors"))


def load_model(name: str | Path) -> PDVMRNN:
    """The trained model of a run, in float32, ready to plan.

    Args:
        name: a run folder, a bundled name, or `hf:owner/name` of the Hugging Face Hub.

    Raises:
        ValueError: there is no such run, or its files are broken or do not fit together.
    """
    folder = find_run(name)
    config = read_config(folder)
    try:
        model = PDVMRNN(tuples(ModelConfig, config["model"]), tuples(Sensors, config["sensors"]), config["num_sequences"])
        tensors = load_file(folder / "model.safetensors")
        model.load_state_dict({name: value.float() for name, value in tensors.items()})
    except FileNotFoundError as error:
        raise ValueError(f"{folder} has no model.safetensors yet: the training stopped before its first checkpoint") from error
    except (KeyError, TypeError, AttributeError, SafetensorError, RuntimeError) as error:
        reason = " ".join(str(error).split()[:40])
        raise ValueError(f"{folder} cannot be loaded ({reason}): its files are broken or from another version; train again") from error
    return model.requires_grad_(False).eval()


def from_pretrained(name_or_folder: str | Path, *, revision: str | None = None) -> PDVMRNN:
    """The trained model of a run, as `load_model` gives it, under the name that other libraries have for this.

    Args:
        name_or_folder: a run folder, a bundled name, or `hf:owner/name` of the Hugging Face Hub; no other name leads to the network.
        revision: branch, tag or commit of a run on the Hub; by default the newest.

    Raises:
        ValueError: there is no such run, its files are broken or do not fit together, or it has a revision and is not on the Hub.
        ConnectionError: it is on the Hub, was never fetched, and the Hub cannot be reached.
    """
    if revision is not None:
        if not hub.is_meant(name_or_folder):
            raise ValueError(f"revision is {revision}, and {name_or_folder} is not on the Hugging Face Hub: give {hub.PREFIX}OWNER/NAME")
        name_or_folder = f"{name_or_folder}@{revision}"
    return load_model(name_or_folder)


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


def tuples(record: type[Record], fields: Mapping[str, Any]) -> Record:
    """Build a dataclass from JSON, where its tuples have become lists."""
    return record(**{name: tuple(value) if isinstance(value, list) else value for name, value in fields.items()})


def write_card(folder: Path) -> None:
    """Write README.md, the model card: what the model is, what it learned from, how it was made, what it is not for."""
    config = read_config(folder)
    if not (folder / "log.jsonl").is_file():
        raise ValueError(f"{folder} has no log.jsonl, of which the model card tells: restore it or train again")
    train, provenance = config["train"], config.get("provenance", {})
    lines = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    last = lines[-1]
    demonstrations = number_of(config.get("num_demonstrations", config["num_sequences"]), "demonstration")
    minutes = sum(line["seconds"] for line in lines) / 60
    card = f"""---
library_name: preimage
pipeline_tag: robotics
tags: [robotics, predictive-coding, imitation-learning]
---
# {folder.name}

A P-DVMRNN (Choi, Matsumoto, Jung, Tani 2018) of size `{config.get("size")}`, trained on {demonstrations}
of task `{config.get("task")}` (data `{config.get("data", {}).get("fingerprint")}`).

| | |
|---|---|
| made by | `{provenance.get("command")}` |
| updates | {last["update"]} of {train["updates"]}, {minutes:.0f} minutes on {provenance.get("machine")} |
| error at the end | vision {last["visual"]:.2f}, joints {last["proprioceptive"]:.4f} |
| commit, day | {provenance.get("commit")}, {provenance.get("date")} |
| versions | {", ".join(f"{name} {number}" for name, number in provenance.get("versions", {}).items())} |

`config.json` holds all settings and seeds, `log.jsonl` of the run folder the errors update by update. Plan with it by
`preimage plan RUN --goal IMAGE --out PLAN`. It knows one arm, one camera and one kind of task: those it was shown.
"""
    with whole_file(folder / "README.md") as path:
        path.write_text(card)
