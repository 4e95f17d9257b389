"""A run folder has one writer, notices damage, and goes on wherever its training was killed."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from preimage.method.train import TrainConfig, train
from preimage.network.config import ModelConfig
from preimage.storage.checkpoints import CHECKPOINT, append_to_log, forget_after
from preimage.storage.checksums import is_damaged_safetensors, is_damaged_zip
from preimage.storage.locks import LOCK, locked
from preimage.storage.networks import load_model
from preimage.storage.run_files import WEIGHTS
from preimage.storage.runs import read_log, read_shown
from test_output_folders import tree
from test_train import demonstrations, weights

CONFIG = TrainConfig(updates=6, batch_size=2, rest_steps=2, checkpoint_every=2, precision="float32")


class Killed(Exception):
    pass


def train_to(folder: Path, *, die_at: int | None = None, config: TrainConfig = CONFIG, resume: bool = False) -> torch.nn.Module:
    def watch(progress) -> None:
        if progress.update == die_at:
            raise Killed

    return train(demonstrations(), ModelConfig.tiny(), config=config, folder=folder, resume=resume, progress=watch)


@pytest.fixture(scope="module")
def never_stopped(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "whole"
    train_to(folder)
    return folder


def copied(run: Path, place: Path) -> Path:
    place.mkdir()
    for path in run.iterdir():
        (place / path.name).write_bytes(path.read_bytes())
    return place


# One writer

HOLD = """
import sys, time
from pathlib import Path
from preimage.storage.locks import locked
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def holder(tmp_path):
    process = subprocess.Popen([sys.executable, "-c", HOLD, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    process.stdout.readline()
    yield process
    process.kill()
    process.wait()
    process.stdout.close()


def test_a_second_writer_is_refused_and_the_first_is_named(tmp_path, holder):
    for _ in range(2):
        with (
            pytest.raises(ValueError, match=rf"is being written by process {holder.pid} on .* since .*: wait until it ends"),
            locked(tmp_path),
        ):
            pass
    before = tree(tmp_path)
    with pytest.raises(ValueError, match=f"is being written by process {holder.pid}"):
        train_to(tmp_path)
    assert tree(tmp_path) == before


def test_the_lock_of_a_killed_process_is_taken_over(tmp_path, holder):
    holder.kill()
    holder.wait()
    assert (tmp_path / LOCK).exists()
    with locked(tmp_path):
        assert json.loads((tmp_path / LOCK).read_text())["pid"] == os.getpid()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("content", ["", "{", "[]", '{"pid": 1}', "\x00" * 10])
def test_a_lock_file_that_nobody_holds_is_none(tmp_path, content):
    (tmp_path / LOCK).write_text(content)
    with locked(tmp_path):
        pass
    assert not list(tmp_path.iterdir())


def test_a_process_does_not_lock_a_folder_twice(tmp_path):
    with locked(tmp_path):
        with pytest.raises(ValueError, match=f"process {os.getpid()}"), locked(tmp_path):
            pass
        assert (tmp_path / LOCK).exists()


# Going on


@pytest.mark.parametrize("die_at", [1, 2, 3, 5])
def test_a_training_that_was_killed_goes_on_from_its_checkpoint_or_its_beginning(tmp_path, never_stopped, die_at):
    with pytest.raises(Killed):
        train_to(tmp_path / "run", die_at=die_at)
    resumed = train_to(tmp_path / "run", resume=True)
    assert torch.equal(weights(resumed), weights(load_model(never_stopped)))
    assert [line["update"] for line in read_log(tmp_path / "run")] == [1, 2, 3, 4, 5, 6]
    assert {path.name for path in (tmp_path / "run").iterdir()} == {path.name for path in never_stopped.iterdir()}


@pytest.mark.parametrize("left", [[], [LOCK], [LOCK, ".config.json.99999999@elsewhere.part"]])
@pytest.mark.parametrize("resume", [True, False])
def test_a_training_that_was_killed_before_it_wrote_its_settings_begins(tmp_path, never_stopped, left, resume):
    for name in left:
        (tmp_path / name).write_text("{")
    assert torch.equal(weights(train_to(tmp_path, resume=resume)), weights(load_model(never_stopped)))
    assert {path.name for path in tmp_path.iterdir()} == {path.name for path in never_stopped.iterdir()}


def test_a_training_killed_within_its_first_checkpoint_begins_again(tmp_path, never_stopped):
    with pytest.raises(Killed):
        train_to(tmp_path / "run", die_at=3)
    (tmp_path / "run" / CHECKPOINT).unlink()  # its weights were written, itself not
    text = (tmp_path / "run/log.jsonl").read_text()
    (tmp_path / "run/log.jsonl").write_text("".join(text.splitlines(keepends=True)[:2]) + '{"update": 3, "vis')
    assert torch.equal(weights(train_to(tmp_path / "run", resume=True)), weights(load_model(never_stopped)))


def test_a_trained_model_without_a_checkpoint_is_not_begun_again(tmp_path, never_stopped):
    run = copied(never_stopped, tmp_path / "run")
    (run / CHECKPOINT).unlink()
    before = tree(run)
    with pytest.raises(ValueError, match=r"holds a trained model and no resume.pt to go on from"):
        train_to(run, resume=True)
    assert tree(run) == before


def test_weights_that_are_older_than_the_checkpoint_are_brought_up_to_date(tmp_path, never_stopped):
    with pytest.raises(Killed):
        train_to(tmp_path / "run", die_at=3)
    run = copied(never_stopped, tmp_path / "whole")
    (run / WEIGHTS).write_bytes((tmp_path / "run" / WEIGHTS).read_bytes())
    train_to(run, resume=True)
    assert (run / WEIGHTS).read_bytes() == (never_stopped / WEIGHTS).read_bytes()


def test_a_training_goes_on_to_more_updates_and_says_so(tmp_path, never_stopped):
    run = copied(never_stopped, tmp_path / "run")
    train_to(run, resume=True, config=replace(CONFIG, updates=8))
    assert json.loads((run / "config.json").read_text())["train"]["updates"] == 8
    assert [line["update"] for line in read_log(run)] == list(range(1, 9))
    with pytest.raises(ValueError, match="has 8 updates already: give --updates 8 or more"):
        train_to(run, resume=True)


@pytest.mark.parametrize("resume", [True, False])
def test_what_is_no_run_is_left_alone(tmp_path, resume):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(ValueError, match=r"is no run folder: it has no config.json|is not empty: give a new folder"):
        train_to(tmp_path, resume=resume)
    assert tree(tmp_path) == {"notes.txt": b"mine"}


# Damage


@pytest.mark.parametrize(("name", "is_damaged"), [(CHECKPOINT, is_damaged_zip), (WEIGHTS, is_damaged_safetensors)])
def test_every_bit_that_flips_is_noticed(never_stopped, name, is_damaged):
    content = (never_stopped / name).read_bytes()
    assert not is_damaged(content)
    rng = np.random.default_rng(0)
    places = [*range(80), *range(len(content) - 200, len(content)), *rng.integers(len(content), size=400)]
    for place in places:
        flipped = bytearray(content)
        flipped[place] ^= 1 << int(rng.integers(8))
        assert is_damaged(bytes(flipped)), place
    for end in (100, len(content) // 2, len(content) - 1):
        assert is_damaged(content[:end])
    assert is_damaged(content + b"\0")


def test_damage_is_told_in_a_sentence_and_nothing_is_written(tmp_path, never_stopped):
    run = copied(never_stopped, tmp_path / "run")
    for name in (CHECKPOINT, WEIGHTS):
        content = bytearray((run / name).read_bytes())
        content[len(content) // 2] ^= 4
        (run / name).write_bytes(content)
    before = tree(run)
    with pytest.raises(ValueError, match=r"resume.pt is damaged, its checksum is another: restore it, or train into a new folder"):
        train_to(run, resume=True)
    with pytest.raises(ValueError, match=r"model.safetensors is damaged, its checksum is another: restore it or train again"):
        load_model(run)
    assert tree(run) == before


def test_checkpoints_are_still_files_of_torch(never_stopped):
    assert torch.load(never_stopped / CHECKPOINT, weights_only=True)["update"] == 6


def test_a_checkpoint_from_before_there_were_checksums_is_gone_on_from(tmp_path, never_stopped):
    run = copied(never_stopped, tmp_path / "run")
    torch.save(torch.load(run / CHECKPOINT, weights_only=True), run / CHECKPOINT)
    assert torch.equal(weights(train_to(run, resume=True)), weights(load_model(never_stopped)))


def change_config(run: Path, **changes) -> None:
    config = json.loads((run / "config.json").read_text())
    for path, value in changes.items():
        *parents, name = path.split("__")
        place = config
        for parent in parents:
            place = place[parent]
        place[name] = value
    (run / "config.json").write_text(json.dumps(config))


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    "changes",
    [
        {"sensors__joint_lower": [float("nan"), 0.0]},
        {"sensors__joint_upper": [float("inf"), 1.0]},
        {"sensors__joint_upper": [10**400, 1.0]},
        {"sensors__joint_upper": [-5.0, -5.0]},
        {"sensors__joint_names": ["a"]},
        {"sensors__joint_names": ["a", "a"]},
        {"sensors__joint_names": "ab"},
        {"sensors__height": 16.5},
        {"sensors__height": 10**9},
        {"sensors__height": -16},
        {"model__motor_units": [10**9, 8]},
        {"model__motor_units": ["12", 8]},
        {"model__vision_channels": []},
        {"model__rate_hz": 1e300},
        {"model__rate_hz": 0},
        {"model__intention_layers": ["cellar"]},
        {"model__intention_dimensions": 10**12},
        {"num_sequences": 10**12},
        {"num_sequences": -1},
        {"num_sequences": None},
        {"num_sequences": True},
    ],
    ids=str,
)
def test_settings_that_cannot_be_are_told(tmp_path, never_stopped, changes):
    run = copied(never_stopped, tmp_path / "run")
    change_config(run, **changes)
    with pytest.raises(ValueError, match=r"train again") as told:
        load_model(run)
    assert "\n" not in str(told.value)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    "change",
    [
        {"joints": np.full((20, 2), np.nan, np.float32)},
        {"joints": np.zeros((20, 3), np.float32)},
        {"joints": np.zeros(20, np.float32)},
        {"lengths": np.array([5, 5, 5, 6])},
        {"lengths": np.array([20, 0, 0, 0])},
        {"lengths": np.array([5.0, 5, 5, 5])},
        {"rates_hz": np.array([5, 5, 5, np.inf])},
        {"rates_hz": np.array([5, 5, 5, 1e-4])},
        {"rates_hz": np.array(5.0)},
        {"last_frames": np.zeros((4, 16, 16, 1))},
        {"last_frames": np.zeros((4, 8, 16, 1), np.uint8)},
        {"last_frames": np.array(["a"])},
    ],
    ids=str,
)
def test_demonstrations_that_cannot_be_are_told(tmp_path, never_stopped, change):
    run = copied(never_stopped, tmp_path / "run")
    with np.load(run / "shown.npz") as arrays:
        parts = dict(arrays)
    np.savez(run / "shown.npz", **parts | change)
    with pytest.raises(ValueError, match=r"shown.npz cannot be read \(.*\): restore it or train again"):
        read_shown(run)


def test_joints_in_half_precision_are_read(tmp_path, never_stopped):
    run = copied(never_stopped, tmp_path / "run")
    with np.load(run / "shown.npz") as arrays:
        parts = dict(arrays)
    np.savez(run / "shown.npz", **parts | {"joints": parts["joints"].astype(np.float16)})
    np.testing.assert_allclose(read_shown(run)[0].joints, read_shown(never_stopped)[0].joints, atol=1e-2)


def test_weights_that_are_not_finite_are_told(tmp_path, never_stopped, monkeypatch):
    from safetensors.torch import load_file, save_file

    run = copied(never_stopped, tmp_path / "run")
    tensors = load_file(run / WEIGHTS)
    name = next(name for name, value in tensors.items() if value.is_floating_point())
    tensors[name].flatten()[0] = torch.nan
    save_file(tensors, run / WEIGHTS)  # without a checksum
    with pytest.raises(ValueError, match=f"{name} holds numbers that are not finite"):
        load_model(run)


# Full and read-only disks


def test_a_full_disk_under_the_log_is_told(tmp_path, monkeypatch):
    def full(*_arguments, **_words):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "open", full)
    with pytest.raises(OSError, match=r"log.jsonl could not be written \(No space left on device\); what was saved before is kept"):
        append_to_log(tmp_path, {"update": 1})


def test_a_read_only_disk_is_told(tmp_path, monkeypatch):
    def refuse(*_arguments, **_words):
        raise OSError(30, "Read-only file system", str(tmp_path / "run"))

    monkeypatch.setattr(os, "mkdir", refuse)
    with pytest.raises(OSError, match="Read-only file system"):
        train_to(tmp_path / "run")


def test_a_log_that_never_ends_is_not_read(tmp_path):
    (tmp_path / "log.jsonl").symlink_to("/dev/zero")
    with pytest.raises(ValueError, match="is not a regular file"):
        forget_after(tmp_path / "log.jsonl", 3)
