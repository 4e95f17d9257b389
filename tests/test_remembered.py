"""What lies beside the weights of a run: the memory is that of the last checkpoint, and a calibration goes with the weights it is of."""

import os
import signal
from pathlib import Path

import pytest

from preimage import presets
from preimage.method.learner import Progress
from preimage.network.config import ModelConfig
from preimage.presets import TrainOptions, load_memory, remember
from preimage.storage.networks import load_model
from preimage.storage.run_files import CALIBRATION, WEIGHTS
from test_train import demonstrations


def test_the_memory_is_kept_beside_the_weights(tmp_path: Path) -> None:
    model = presets.train(demonstrations(), ModelConfig.tiny(), config=TrainOptions(updates=1), folder=tmp_path / "run")
    kept, made = load_memory(tmp_path / "run").tensors(), remember(demonstrations(), model).tensors()
    assert kept.keys() == made.keys()
    assert all(value.equal(made[name]) for name, value in kept.items())


def test_an_interrupted_training_leaves_its_memory(tmp_path: Path) -> None:
    def stop(progress: Progress) -> None:
        os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        presets.train(demonstrations(), ModelConfig.tiny(), config=TrainOptions(updates=9), folder=tmp_path / "run", progress=stop)
    assert load_memory(tmp_path / "run").num_events == 0
    assert len(load_memory(tmp_path / "run").final_joints) == 4


def test_a_training_interrupted_before_anything_was_saved_says_that_it_was_interrupted(tmp_path: Path) -> None:
    def raise_it(_: Progress) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        presets.train(demonstrations(), ModelConfig.tiny(), config=TrainOptions(updates=9), folder=tmp_path / "run", progress=raise_it)
    assert not (tmp_path / "run" / WEIGHTS).exists()


def test_the_memory_is_that_of_the_last_checkpoint(tmp_path: Path) -> None:
    """Where a training is killed, what was saved by then can be planned with."""

    def killed_at_5(progress: Progress) -> None:
        if progress.update == 5:
            raise SystemExit

    config = TrainOptions(updates=9, checkpoint_every=4)
    with pytest.raises(SystemExit):
        presets.train(demonstrations(), ModelConfig.tiny(), config=config, folder=tmp_path / "run", progress=killed_at_5)
    kept, made = load_memory(tmp_path / "run").tensors(), remember(demonstrations(), load_model(tmp_path / "run")).tensors()
    assert all(kept[name].equal(made[name]) for name in made)


def test_a_calibration_goes_with_the_weights_it_is_of(tmp_path: Path) -> None:
    run = tmp_path / "run"
    presets.train(demonstrations(), ModelConfig.tiny(), config=TrainOptions(updates=1), folder=run)
    (run / CALIBRATION).touch()
    presets.train(demonstrations(), ModelConfig.tiny(), config=TrainOptions(updates=1), folder=run, resume=True)
    assert (run / CALIBRATION).exists()
    presets.train(demonstrations(), ModelConfig.tiny(), config=TrainOptions(updates=2), folder=run, resume=True)
    assert not (run / CALIBRATION).exists()
