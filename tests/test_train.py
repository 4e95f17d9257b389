"""Laws of training: it lowers the error, is repeatable, resumes as if never stopped, and stops at the first non-finite number."""

import json
import os
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from preimage import presets
from preimage.data.sequences import pad, sensors_of
from preimage.ideas.later_starts import LaterStarts
from preimage.ideas.mixup import Mixup
from preimage.method.batches import batch_of, plain_batch
from preimage.method.config import TrainConfig
from preimage.method.initialisation import spread_intentions, start_from_demonstrations
from preimage.method.learner import Learner, NonFinite, Progress, optimiser_of, share_of_rate, validate_finite
from preimage.method.seam import Augmentation, Batch
from preimage.method.train import train
from preimage.network.config import ModelConfig
from preimage.network.intention import FreeTable, LatentTable
from preimage.network.pdvmrnn import PDVMRNN
from preimage.presets import TrainOptions
from preimage.records import Demonstration
from preimage.storage.networks import load_model

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


NETWORKS = {
    "latent": ModelConfig.tiny(),
    "free": ModelConfig.tiny().as_paper(),
    "keypoints": replace(ModelConfig.tiny(), keypoints=3),
}
"""Each learns, and is loaded again as it was."""


def falls(told: list[Progress]) -> bool:
    first, last = (np.mean([one.visual / 40 + one.proprioceptive for one in part]) for part in (told[:5], told[-5:]))
    return bool(last < 0.75 * first)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("network", NETWORKS)
def test_the_error_falls_and_the_network_is_loaded_as_it_was(network: str, tmp_path: Path) -> None:
    told: list[Progress] = []
    config = replace(CONFIG, updates=40, learning_rate=2e-2)
    model = train(demonstrations(), NETWORKS[network], config=config, folder=tmp_path / "run", progress=told.append)
    assert falls(told)
    again = load_model(tmp_path / "run")
    assert again.config == model.config
    assert torch.equal(weights(again), weights(model))


@pytest.mark.parametrize("network", NETWORKS)
def test_every_weight_gets_a_gradient_in_an_update(network: str) -> None:
    model = train(demonstrations(), NETWORKS[network], config=replace(CONFIG, updates=1))
    again = train(demonstrations(), NETWORKS[network], config=replace(CONFIG, updates=4))
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
    drawn: list[Batch] = []

    def broken_at_3(batch: Batch, *_: object) -> Batch:
        drawn.append(batch)
        joints = batch.sequences.joints.clone()
        joints[:, 1:] *= torch.nan if len(drawn) == 3 else 1  # what begins is sensed, and would spoil what is imagined
        return replace(batch, sequences=replace(batch.sequences, joints=joints))

    with pytest.raises(NonFinite, match="the proprioceptive error is not finite at update 3: a lower learning rate"):
        train(demonstrations(), ModelConfig.tiny(), config=CONFIG, folder=tmp_path / "run", augmentations=[broken_at_3])
    saved = json.loads((tmp_path / "run" / "non_finite.json").read_text())
    assert saved == {"update": 3, "tensor": "the proprioceptive error"}
    assert all(value.isfinite().all() for value in load_model(tmp_path / "run").state_dict().values())


def test_a_full_folder_is_not_written_over(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(ValueError, match="is not empty"):
        train(demonstrations(), ModelConfig.tiny(), config=CONFIG, folder=tmp_path)
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_resuming_without_a_folder_is_refused() -> None:
    """Once it began anew and said nothing."""
    with pytest.raises(ValueError, match="resume goes on with the run in a folder, and no folder is given"):
        train(demonstrations(), ModelConfig.tiny(), config=CONFIG, resume=True)
    with pytest.raises(ValueError, match="no folder is given"):
        presets.train(demonstrations(), ModelConfig.tiny(), resume=True)


def test_a_recording_slower_than_the_model_keeps_its_rate() -> None:
    model = train(demonstrations(rate_hz=2.5), ModelConfig.tiny(), config=replace(CONFIG, updates=1))
    assert model.config.rate_hz == 2.5


@pytest.mark.usefixtures("unchecked")
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


# What an update draws


@pytest.mark.parametrize(("batch_size", "count"), [(2, 6), (4, 6), (3, 7), (9, 5)])
def test_every_sequence_is_drawn_once_an_epoch(batch_size: int, count: int) -> None:
    config = replace(CONFIG, batch_size=batch_size)
    size, epochs = min(batch_size, count), 4
    drawn = torch.cat([batch_of(update, count, config) for update in range(epochs * count)])
    assert len(drawn) == epochs * count * size
    for epoch in drawn.view(-1, count):
        assert sorted(epoch.tolist()) == list(range(count))
    assert len({tuple(epoch.tolist()) for epoch in drawn.view(-1, count)}) > 1, "in another order each time"


def test_the_seed_decides_what_is_drawn() -> None:
    def drawn(seed: int) -> list[int]:
        return torch.cat([batch_of(update, 10, replace(CONFIG, seed=seed)) for update in range(10)]).tolist()

    assert drawn(1) == drawn(1)
    assert drawn(1) != drawn(2)


def test_the_learning_rate_rises_and_falls_as_by_hand() -> None:
    config = TrainConfig(updates=1000, warmup_updates=10, final_share=0.1)
    shares = [share_of_rate(update, config) for update in range(1001)]
    assert shares[0] == pytest.approx(0.1)
    assert shares[4] == pytest.approx(0.5, rel=1e-3)
    assert shares[500] == pytest.approx(0.1 + 0.9 / 2)
    assert shares[1000] == pytest.approx(0.1)
    assert max(shares) == shares[9] == pytest.approx(1, rel=1e-3)
    assert (np.diff(shares[:10]) > 0).all()
    assert (np.diff(shares[9:]) < 0).all()


def test_weights_and_intentions_move_at_rates_of_their_own() -> None:
    slow = replace(CONFIG, updates=1, learning_rate=1e-12, intention_learning_rate=1e-12)
    faster = replace(slow, intention_learning_rate=1e-2)
    still, moved = (train(demonstrations(), ModelConfig.tiny(), config=each) for each in (slow, faster))
    change = {name: not torch.equal(value, moved.state_dict()[name]) for name, value in still.state_dict().items()}
    assert {name for name, changed in change.items() if changed} == {name for name in change if name.startswith("intention_table.")}


# Where it begins


def places(table: FreeTable | LatentTable) -> torch.Tensor:
    return table.rows.detach() if isinstance(table, FreeTable) else table.mean.detach()


@pytest.mark.parametrize("intention", ["latent", "free"])
def test_alike_sequences_become_neighbours(intention: str) -> None:
    shapes, generator = {"top": (4, 2, 2)}, torch.Generator().manual_seed(0)
    if intention == "free":
        table = FreeTable(shapes, num_sequences=8, noise=0.0, generator=generator)
    else:
        table = LatentTable(shapes, num_sequences=8, dimensions=4, generator=generator)
    hidden = torch.tensor([0.0, 7.0, 2.0, 5.0, 1.0, 6.0, 3.0, 4.0])
    features = torch.stack([hidden, (hidden / 3).sin(), (hidden / 3).cos()], 1)
    spread_intentions(table, features)
    apart, alike = torch.cdist(places(table), places(table)), (hidden[:, None] - hidden).abs()
    assert apart[alike == 1].mean() < apart[alike == 2].mean() < apart[alike == 4].mean() < apart[alike == 7].mean()
    assert places(table).unique(dim=0).shape[0] == 8


def test_sequences_that_are_all_the_same_begin_with_finite_intentions() -> None:
    table = LatentTable({"top": (4, 2, 2)}, num_sequences=3, dimensions=2, generator=torch.Generator())
    spread_intentions(table, torch.ones(3, 5))
    assert places(table).isfinite().all()


def test_an_untrained_network_predicts_what_is_seen_and_felt_on_average() -> None:
    sequences = pad(demonstrations(), rate_hz=2.5)
    model = train(demonstrations(), ModelConfig.tiny(), config=replace(CONFIG, updates=1))
    fresh = PDVMRNN(model.config, model.sensors, 4)
    start_from_demonstrations(fresh, sequences)
    assert torch.tanh(fresh.pixel_bias).mean().item() == pytest.approx((sequences.frames.float() / 127.5 - 1).mean().item(), abs=0.05)
    felt = model.coding.encode(sequences.joints).mean((0, 1))
    torch.testing.assert_close(fresh.code_bias.softmax(-1), felt, atol=0.01, rtol=0)
    torch.testing.assert_close(fresh.home_joints, sequences.joints[:, 0].mean(0))
    assert fresh.longest == sequences.frames.shape[1]


# What the ideas make of it


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_a_share_of_the_sequences_begins_at_any_of_its_steps(share: float) -> None:
    begun = LaterStarts(share).first_steps(torch.full((4000,), 5), torch.Generator().manual_seed(0))
    assert begun.bincount(minlength=5) / 4000 == pytest.approx([1 - 0.8 * share, *4 * [0.2 * share]], abs=0.03)


def test_a_later_start_is_the_rest_of_the_same_demonstration() -> None:
    sequences = pad(demonstrations(), rate_hz=2.5, rest_steps=2)
    plain = plain_batch(torch.tensor([2, 0, 1, 3]), sequences)
    later = LaterStarts(1.0)(plain, sequences, torch.Generator().manual_seed(1))
    assert later.rows.equal(plain.rows)
    steps = plain.sequences.lengths - later.sequences.lengths
    assert (steps >= 0).all()
    assert steps.any()
    for row, step in enumerate(steps.tolist()):
        expected = plain.sequences.joints[row, step:]
        assert later.sequences.joints[row, : len(expected)].equal(expected)
        assert (later.sequences.joints[row, len(expected) :] == expected[-1]).all()


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    "options",
    [TrainOptions(later_starts=0.5), TrainOptions(mixup=0.5), TrainOptions(mixup=0.6, mixup_arity=4, later_starts=0.5)],
    ids=["later starts", "mixup", "both"],
)
def test_a_network_learns_from_what_the_ideas_make_of_its_batches(options: TrainOptions, tmp_path: Path) -> None:
    told: list[Progress] = []
    settings = {"updates": 30, "batch_size": 4, "rest_steps": 2, "learning_rate": 3e-2, "precision": "float32"}
    options = replace(options, **settings)
    model = presets.train(demonstrations(), ModelConfig.tiny(), config=options, folder=tmp_path / "run", progress=told.append)
    plain = train(demonstrations(), ModelConfig.tiny(), config=TrainConfig(**settings))
    assert falls(told)
    assert not torch.equal(weights(model), weights(plain))
    assert {"later_starts": options.later_starts, "mixup": options.mixup}.items() <= json.loads(
        (tmp_path / "run" / "config.json").read_text()
    )["train"].items()


def test_without_ideas_the_presets_train_as_the_paper_does() -> None:
    by_presets = presets.train(demonstrations(), ModelConfig.tiny(), config=TrainOptions(updates=3, batch_size=2, precision="float32"))
    by_paper = train(demonstrations(), ModelConfig.tiny(), config=TrainConfig(updates=3, batch_size=2, precision="float32"))
    assert torch.equal(weights(by_presets), weights(by_paper))
    assert TrainOptions().augmentations() == []


def test_mixup_comes_before_later_starts() -> None:
    """So that a later start is that of the sum; the other way round each part would begin elsewhere."""
    first, second = TrainOptions(mixup=0.5, later_starts=0.5).augmentations()
    assert (type(first), type(second)) == (Mixup, LaterStarts)


def test_errors_are_told_of_plain_demonstrations_alone() -> None:
    """A sum that cannot be generated, all pixels white through any blur, changes no error that is told at the first update."""

    def hopeless(batch: Batch, *_: object) -> Batch:
        frames = batch.sequences.frames.clone()
        frames[2:] = 255
        blurred = torch.arange(len(batch.rows)) >= 2
        return replace(batch, sequences=replace(batch.sequences, frames=frames), blurred=blurred, blur=torch.nn.AvgPool3d((1, 2, 2)))

    def told(augmentations: list[Augmentation]) -> Progress:
        seen: list[Progress] = []
        config = replace(CONFIG, updates=1, batch_size=4)
        train(demonstrations(), ModelConfig.tiny(), config=config, augmentations=augmentations, progress=seen.append)
        return seen[0]

    def first_two(batch: Batch, *_: object) -> Batch:
        return batch[torch.tensor([0, 1, 0, 1])]

    assert told([hopeless]).visual == pytest.approx(told([first_two]).visual, rel=0.05)


def test_a_gradient_of_the_intentions_that_is_not_finite_stops_the_training_before_it_reaches_them() -> None:
    model = PDVMRNN(ModelConfig.tiny(), sensors_of(demonstrations()), num_sequences=2)
    rows = next(model.intention_table.parameters())
    rows.grad = torch.full_like(rows, torch.nan)
    learner = Learner(model, optimiser_of(model, CONFIG))
    with pytest.raises(NonFinite, match=r"the gradient of intention_table\.mean is not finite at update 1"):
        validate_finite(learner, {"the visual error": torch.zeros(2)}, torch.tensor(1.0), None)
