"""Laws of training: it lowers the error, is repeatable, resumes as if never stopped, and stops at the first non-finite number."""

import json
import os
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from preimage.method.batch_error import BatchError

from preimage.data.sequences import pad
from preimage.method.train import NonFinite, Progress, TrainConfig, begin_steps, train
from preimage.network.config import ModelConfig
from preimage.records import Demonstration
from preimage.storage.runs import load_model

CONFIG = TrainConfig(updates=6, batch_size=2, rest_steps=2, checkpoint_every=2, precision="float32")


def demonstrations(count: int = 4, rate_hz: float = 5.0) -> list[Demonstration]:
    """A bright bar that moves with the first joint."""
    shown = []
    for number in range(count):
        joints = np.linspace(0, (number + 1) / count, 5)[:, None] * np.array([1.0, -0.5])
        frames = np.zeros((5, 16, 16, 1), np.uint8)
        for step, angle in enumerate(joints[:, 0]):
            frames[step, :, int(angle * 12) : int(angle * 12) + 3] = 200
        shown.append(Demonstration(frames, joints, rate_hz, ("a", "b")))
    return shown


def weights(model: torch.nn.Module) -> torch.Tensor:
    return torch.cat([value.flatten() for value in model.state_dict().values()])


@pytest.mark.parametrize("dimensions", [4, None])
def test_the_error_falls(dimensions: int | None) -> None:
    told: list[Progress] = []
    config = replace(CONFIG, updates=60, learning_rate=1e-2)
    train(demonstrations(), replace(ModelConfig.tiny(), intention_dimensions=dimensions), config=config, progress=told.append)
    first, last = (np.mean([one.visual / 40 + one.proprioceptive for one in part]) for part in (told[:5], told[-5:]))
    assert last < 0.75 * first


def test_every_weight_gets_a_gradient_in_an_update() -> None:
    model = train(demonstrations(), ModelConfig.tiny(), config=replace(CONFIG, updates=1))
    again = train(demonstrations(), ModelConfig.tiny(), config=replace(CONFIG, updates=4))
    before, after = dict(model.named_parameters()), dict(again.named_parameters())
    still = [name for name, value in before.items() if torch.equal(value, after[name])]
    assert not still


def test_resumed_equals_never_stopped_bit_for_bit(tmp_path: Path) -> None:
    never_stopped = train(demonstrations(), ModelConfig.tiny(), config=CONFIG)

    def stop_at_3(progress: Progress) -> None:
        if progress.update == 3:
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        train(demonstrations(), ModelConfig.tiny(), config=CONFIG, folder=tmp_path / "run", progress=stop_at_3)
    resumed = train(demonstrations(), ModelConfig.tiny(), config=CONFIG, folder=tmp_path / "run", resume=True)
    assert torch.equal(weights(resumed), weights(never_stopped))
    assert torch.equal(weights(load_model(tmp_path / "run")), weights(never_stopped))
    lines = [json.loads(line) for line in (tmp_path / "run" / "log.jsonl").read_text().splitlines()]
    assert [line["update"] for line in lines] == [1, 2, 3, 4, 5, 6]
    assert {"visual", "proprioceptive", "seconds"} <= lines[0].keys()


def test_a_killed_process_loses_no_more_than_since_the_checkpoint(tmp_path: Path) -> None:
    class Killed(Exception):
        pass

    def die_at_3(progress: Progress) -> None:
        if progress.update == 3:
            raise Killed

    with pytest.raises(Killed):
        train(demonstrations(), ModelConfig.tiny(), config=CONFIG, folder=tmp_path / "run", progress=die_at_3)
    resumed = train(demonstrations(), ModelConfig.tiny(), config=CONFIG, folder=tmp_path / "run", resume=True)
    assert torch.equal(weights(resumed), weights(train(demonstrations(), ModelConfig.tiny(), config=CONFIG)))
    assert len((tmp_path / "run" / "log.jsonl").read_text().splitlines()) == 6


def test_a_number_that_is_not_finite_stops_the_run_and_is_named(tmp_path: Path) -> None:
    config = replace(CONFIG, learning_rate=1e20, warmup_updates=1)
    with pytest.raises(NonFinite, match=r"is not finite at update \d"):
        train(demonstrations(), ModelConfig.tiny(), config=config, folder=tmp_path / "run")
    saved = json.loads((tmp_path / "run" / "non_finite.json").read_text())
    assert saved["tensor"]


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_a_share_of_the_sequences_begins_at_any_of_its_steps(share: float) -> None:
    lengths = torch.full((4000,), 5)
    begun = begin_steps(lengths, replace(CONFIG, later_starts=share), torch.Generator().manual_seed(0))
    assert begun.bincount(minlength=5) / 4000 == pytest.approx([1 - 0.8 * share, *4 * [0.2 * share]], abs=0.03)


def test_a_full_folder_is_not_written_over(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(ValueError, match="is not empty"):
        train(demonstrations(), ModelConfig.tiny(), config=CONFIG, folder=tmp_path)
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_a_recording_slower_than_the_model_keeps_its_rate() -> None:
    model = train(demonstrations(rate_hz=2.5), ModelConfig.tiny(), config=replace(CONFIG, updates=1))
    assert model.config.rate_hz == 2.5


def test_bfloat16_trains_near_float32() -> None:
    began, ended, trained = [], [], []
    config = replace(CONFIG, updates=60, learning_rate=1e-2)
    for precision in ("float32", "bfloat16"):
        told: list[Progress] = []
        trained.append(train(demonstrations(), ModelConfig.tiny(), config=replace(config, precision=precision), progress=told.append))
        errors = [one.visual / 40 + one.proprioceptive for one in told]
        began.append(errors[0])
        ended.append(np.mean(errors[-5:]))
    assert not torch.equal(weights(trained[0]), weights(trained[1]))
    assert began[1] == pytest.approx(began[0], rel=1e-3)
    assert ended[1] == pytest.approx(ended[0], abs=0.01 * (began[0] - ended[0]))


def test_noise_on_the_first_frame_changes_what_is_imagined_and_learned() -> None:
    model = train(demonstrations(), ModelConfig.tiny(), config=replace(CONFIG, updates=1))
    sequences = pad(demonstrations(), rate_hz=model.config.rate_hz)
    intention, drawn = model.intention_table.prior_mean(4).flatten(), torch.Generator().manual_seed(0)
    error = BatchError(model, share=0.0, dtype=torch.float32, blends=False)
    given = sequences.frames, sequences.joints, sequences.mask
    noise, plain = 0.3 * torch.randn(4, 1, 16, 16, generator=drawn), torch.zeros(4, dtype=torch.bool)
    with_noise, without = (error(intention, *given, each, plain)[0] for each in (noise, 0 * noise))
    assert not torch.equal(with_noise, without)
    noisy, plainly = (train(demonstrations(), ModelConfig.tiny(), config=replace(CONFIG, start_noise=each)) for each in (0.3, 0.0))
    assert not torch.equal(weights(noisy), weights(plainly))
