"""What a training says of episodes that were held out: brief, beside it, and without a trace in the weights."""

import json

import numpy as np
import pytest
import torch
from PIL import Image

from preimage.ideas.held_out_error import MOST_EPISODES, held_out_error
from preimage.network.config import ModelConfig
from preimage.presets import TrainOptions, train
from preimage.report.figures import learning_curve
from preimage.storage.run_files import HELD_OUT
from test_train import demonstrations, weights

CONFIG = TrainOptions(updates=4, batch_size=2, rest_steps=2, checkpoint_every=2, precision="float32")


@pytest.mark.parametrize("network", [ModelConfig.tiny(), ModelConfig.tiny().as_paper()], ids=["latent", "free"])
def test_every_checkpoint_tells_of_it_and_nothing_is_learned_from_it(tmp_path, network):
    *shown, unseen = demonstrations()
    alone = train(shown, network, config=CONFIG, folder=tmp_path / "alone")
    beside = train(shown, network, config=CONFIG, folder=tmp_path / "beside", held_out=[unseen])
    assert torch.equal(weights(beside), weights(alone))
    lines = [json.loads(line) for line in (tmp_path / "beside" / HELD_OUT).read_text().splitlines()]
    assert [line["update"] for line in lines] == [2, 4]
    error = held_out_error(beside, [unseen], precision="float32")
    assert {name: lines[-1][name] for name in error} == error
    assert not (tmp_path / "alone" / HELD_OUT).exists()


def test_it_is_the_mean_of_the_first_episodes():
    *shown, unseen = demonstrations()
    model = train(shown, ModelConfig.tiny(), config=CONFIG)
    both = [held_out_error(model, [one], precision="float32")["visual"] for one in (unseen, shown[0])]
    assert held_out_error(model, [unseen, shown[0]], precision="float32")["visual"] == pytest.approx(np.mean(both))
    many = [unseen] * MOST_EPISODES
    assert held_out_error(model, [*many, shown[0]], precision="float32") == held_out_error(model, many, precision="float32")


def test_the_learning_curve_shows_it(tmp_path):
    for name, updates in (("log.jsonl", range(1, 9)), (HELD_OUT, (4, 8))):
        lines = [json.dumps({"update": u, "visual": 500 / u, "proprioceptive": 4 / u}) for u in updates]
        (tmp_path / name).write_text("\n".join(lines))
    alone, both = tmp_path / "alone.png", tmp_path / "both.png"
    learning_curve(tmp_path / "log.jsonl", alone)
    learning_curve(tmp_path / "log.jsonl", both, held_out=tmp_path / HELD_OUT)
    assert not np.array_equal(np.asarray(Image.open(alone)), np.asarray(Image.open(both)))
