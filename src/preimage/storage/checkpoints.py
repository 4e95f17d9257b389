"""The run folder of a training that is going on: opened once, by one process, and saved now and then.

A training that is killed goes on from its last checkpoint, or, where it was killed before the first one was complete, from the beginning.
A checkpoint is what the training goes on from (resume.pt) and, written before it, the weights to plan with (model.safetensors).
"""

import contextlib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import torch

from preimage.network.pdvmrnn import PDVMRNN
from preimage.records import Demonstration
from preimage.storage.atomic_write import atomic_write, remove, write_json
from preimage.storage.checksums import is_damaged_zip, saved_by_torch, with_checksum_in_zip
from preimage.storage.hub import CARD
from preimage.storage.locks import LOCK, locked
from preimage.storage.networks import write_weights
from preimage.storage.output_folders import LEFT_BY_OTHERS
from preimage.storage.run_files import CALIBRATION, HELD_OUT, LOG, WEIGHTS
from preimage.storage.runs import NETWORK_KEYS, part_of, read_config, read_log, write_config, write_shown

CHECKPOINT = "resume.pt"
UNFINISHED_BY_ANYBODY = re.compile(r"\..+\.part")


class Resumable(Protocol):
    """What a training changes from update to update."""

    model: PDVMRNN
    update: int

    def state(self) -> dict[str, Any]:
        """All of it, for a checkpoint."""
        ...

    def load(self, state: dict[str, Any]) -> None:
        """All of it is as it was at a checkpoint."""
        ...


@contextmanager
def open_run(
    folder: Path,
    learner: Resumable,
    demonstrations: Sequence[Demonstration],
    *,
    settings: Mapping[str, Any],
    about: Mapping[str, Any],
    resume: bool,
) -> Iterator[Path]:
    """Lends the folder to write to, a new one or one to resume, with the learner as it was at the last checkpoint.

    Args:
        settings: of the training, with the number of `updates` that it goes to.
        about: what else config.json is to say of a new run; a run that goes on keeps what it said.
        resume: go on with the run that is there, from its beginning where it has no checkpoint yet.

    Raises:
        ValueError: the folder holds something else, or, to resume, no run; another process is writing it; its checkpoint is damaged, is
            of another network, or has more updates than are asked for.
        OSError: the disk is full or read-only.
    """
    goes_on(folder, resume=resume)
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder):
        validate_run_folder(folder, resume=resume)  # again: it may have changed until it was ours
        for path in folder.iterdir():
            if UNFINISHED_BY_ANYBODY.fullmatch(path.name):
                remove(path)
        if (folder / CHECKPOINT).is_file():
            load_checkpoint(folder / CHECKPOINT, learner)
            if learner.update > settings["updates"]:
                raise ValueError(f"{folder} has {learner.update} updates already: give --updates {learner.update} or more")
        begin_or_go_on(folder, learner, demonstrations, settings, about)
        yield folder


def validate_run_folder(folder: Path, *, resume: bool) -> None:
    """Raises ValueError where a training can neither begin in a folder nor go on there."""
    if is_blank(folder):
        return
    if not folder.is_dir():
        raise ValueError(f"{folder} is there already and is no folder: give another place")
    begun, saved = ((folder / name).is_file() for name in ("config.json", CHECKPOINT))
    if not resume:
        goes_on = "--resume to go on with the run in it" if saved or not begun else "--resume to begin again with the run in it"
        raise ValueError(f"{folder} is not empty: give a new folder, or {goes_on}")
    if not begun:
        raise ValueError(f"{folder} is no run folder: it has no config.json; train without --resume, into a new folder")
    if not saved and (folder / WEIGHTS).exists() and not stopped_in_first_checkpoint(folder):
        raise ValueError(f"{folder} holds a trained model and no {CHECKPOINT} to go on from: restore it, or train into a new folder")


def goes_on(folder: Path, *, resume: bool) -> bool:
    """Whether a training in a folder goes on with settings that are there, before anything is made ready for it.

    Raises:
        ValueError: a training can neither begin in the folder nor go on there.
    """
    if resume and not folder.is_dir():
        raise ValueError(f"{folder} is not there, so there is nothing to resume: train without --resume")
    validate_run_folder(folder, resume=resume)
    return resume and (folder / "config.json").is_file()


def stopped_in_first_checkpoint(folder: Path) -> bool:
    """Whether the weights of a run without a checkpoint are those of a first one that was not completed."""
    every = part_of(read_config(folder), "train").get("checkpoint_every", 0)
    begun = not (folder / CARD).exists() and (folder / LOG).is_file() and isinstance(every, int)
    return begun and read_log(folder)[-1]["update"] <= every


def is_blank(folder: Path) -> bool:
    """Whether a folder is not there, or holds nothing but what a training leaves that was killed before it wrote its settings."""
    if not folder.exists() and not folder.is_symlink():
        return True
    names = (path.name for path in folder.iterdir()) if folder.is_dir() else ("a file",)
    return all(name in {LOCK, *LEFT_BY_OTHERS} or UNFINISHED_BY_ANYBODY.fullmatch(name) for name in names)


def load_checkpoint(path: Path, learner: Resumable) -> None:
    """Bring the learner to a checkpoint.

    Raises:
        ValueError: it is damaged, or of another network.
    """
    if is_damaged_zip(path.read_bytes()):
        raise ValueError(f"{path} is damaged, its checksum is another: restore it, or train into a new folder")
    try:
        learner.load(torch.load(path, map_location="cpu", weights_only=True))
    except Exception as error:  # torch raises a dozen types where a file is not what is expected
        raise ValueError(f"{path} is of another network than this training's: give the same data and sizes") from error


def begin_or_go_on(
    folder: Path,
    learner: Resumable,
    demonstrations: Sequence[Demonstration],
    settings: Mapping[str, Any],
    about: Mapping[str, Any],
) -> None:
    """All files of the run are as they have to be before the next update."""
    former = read_config(folder) if (folder / "config.json").is_file() else {}
    if learner.update == 0 or former.get("train") != settings:
        kept = {key: value for key, value in former.items() if key not in NETWORK_KEYS}
        write_config(folder, learner.model, {**about, **kept, "train": dict(settings)})
    if learner.update == 0:
        write_shown(folder, demonstrations)
    else:
        write_weights(folder, learner.model)  # a process killed while it saved may leave those of the checkpoint it did not complete
    for name in (LOG, HELD_OUT):
        forget_after(folder / name, learner.update)


def forget_after(log: Path, update: int) -> None:
    """Forget the log lines of updates that were not saved, and lines cut short."""
    if not log.exists():
        return
    if not log.is_file():
        raise ValueError(f"{log} is not a regular file: put the log itself there, or take it away")
    kept = []
    for line in log.read_text(encoding="utf-8", errors="replace").splitlines(keepends=True):
        with contextlib.suppress(ValueError, KeyError, TypeError):
            if json.loads(line)["update"] <= update:
                kept.append(line)
    with atomic_write(log) as path:
        path.write_text("".join(kept), encoding="utf-8")


def append_to_log(run: Path, line: Mapping[str, Any], *, name: str = LOG) -> None:
    """Add a line to the log of a run, or to another one of its files.

    Raises:
        OSError: the disk is full or read-only.
    """
    try:
        with (run / name).open("a", encoding="utf-8") as log:
            log.write(json.dumps(line) + "\n")
    except OSError as error:
        raise OSError(f"{run / name} could not be written ({error.strerror}); what was saved before is kept") from error


def save_checkpoint(run: Path, learner: Resumable) -> None:
    """Save the weights, then what the training goes on from, which promises that they are there.

    A calibration that is there is of the weights before, and is removed first.

    Raises:
        OSError: the disk is full or read-only; the former ones are kept.
    """
    (run / CALIBRATION).unlink(missing_ok=True)
    write_weights(run, learner.model)
    with atomic_write(run / CHECKPOINT) as path:
        path.write_bytes(with_checksum_in_zip(saved_by_torch(learner.state())))


def write_non_finite(run: Path, update: int, tensor: str) -> None:
    """Say in the run folder which tensor was not finite at which update."""
    write_json(run / "non_finite.json", {"update": update, "tensor": tensor})
