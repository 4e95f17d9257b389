"""The networks of runs: weights and other tensors in files with checksums, and the trained model of a run."""

from collections.abc import Mapping
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load

from preimage.network.config import ModelConfig, Sensors
from preimage.network.pdvmrnn import PDVMRNN
from preimage.storage import hub
from preimage.storage.atomic_write import atomic_write
from preimage.storage.checksums import is_damaged_safetensors, safetensors_with_checksum
from preimage.storage.run_files import WEIGHTS
from preimage.storage.runs import find_run, read_config, read_settings
from preimage.storage.validation import tensors_unlike, validate_size, what_else_it_is


def write_weights(folder: Path, model: PDVMRNN, dtype: torch.dtype = torch.float32) -> None:
    """Write model.safetensors: weights and intention table, in `dtype` (half precision halves the file); all else as it is."""
    learned = dict(model.named_parameters())
    tensors = {name: (value.to(dtype) if name in learned else value).contiguous() for name, value in model.state_dict().items()}
    with atomic_write(folder / WEIGHTS) as path:
        path.write_bytes(safetensors_with_checksum(tensors))


def write_tensors(path: Path, tensors: Mapping[str, torch.Tensor]) -> None:
    """Write tensors by name, with a checksum."""
    with atomic_write(path) as draft:
        draft.write_bytes(safetensors_with_checksum({name: value.cpu().contiguous() for name, value in tensors.items()}))


def read_tensors(path: Path) -> dict[str, torch.Tensor]:
    """The tensors of a file, by name.

    Raises:
        ValueError: it is missing, broken, or holds a number that is not finite.
    """
    if not path.is_file():
        raise ValueError(f"{path.parent} has no {path.name}: finish its training with --resume, or plan as paper or regression")
    content = path.read_bytes()
    try:
        tensors = {} if is_damaged_safetensors(content) else load(content)
    except SafetensorError:
        tensors = {}
    if not tensors or not all(bool(value.isfinite().all()) for value in tensors.values()):
        raise ValueError(f"{path} is damaged: restore it or train again")
    return tensors


def load_model(name: str | Path) -> PDVMRNN:
    """The trained model of a run, in float32, ready to plan.

    Args:
        name: a run folder, a bundled name, or `hf:owner/name` of the Hugging Face Hub.

    Raises:
        ValueError: there is no such run, or its files are broken or do not fit together.
    """
    folder = find_run(name)
    if not (folder / WEIGHTS).is_file():
        raise ValueError(f"{folder} has no {WEIGHTS} yet: the training stopped before its first checkpoint")
    content = (folder / WEIGHTS).read_bytes()
    if foreign := what_else_it_is(content):
        raise ValueError(f"{folder / WEIGHTS} is {foreign}, and none of `preimage train`: put the run's own there, or train again")
    if is_damaged_safetensors(content):
        raise ValueError(f"{folder / WEIGHTS} is damaged, its checksum is another: restore it or train again")
    try:
        model_config, sensors = read_settings(ModelConfig, folder, "model"), read_settings(Sensors, folder, "sensors")
        num_sequences = read_config(folder).get("num_sequences")
        if not isinstance(num_sequences, int) or isinstance(num_sequences, bool):
            raise ValueError(f"num_sequences is {num_sequences!r}")
        validate_size(model_config, sensors, num_sequences, num_bytes=len(content))
        model = PDVMRNN(model_config, sensors, num_sequences)
        tensors = load(content)
    except (ValueError, SafetensorError) as error:
        reason = str(error) if isinstance(error, ValueError) else f"{WEIGHTS} is no safetensors file"
        raise ValueError(f"{folder} cannot be loaded ({reason}): its files are broken or from another version; train again") from error
    if unlike := tensors_unlike(model, tensors):
        raise ValueError(f"{folder} cannot be loaded ({unlike}): its files are broken or from another version; train again")
    model.load_state_dict({name: value.float() for name, value in tensors.items()})
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
