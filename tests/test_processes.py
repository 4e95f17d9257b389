"""Laws of training in several processes: two give the weights of one, stop together, and hand a checkpoint on to one and back."""

import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from preimage.compute.processes import ProcessGroup, ProcessLost, join_processes
from preimage.data.sequences import sensors_of
from preimage.evaluation.evaluate import evaluate
from preimage.method.learner import Progress
from preimage.method.train import train
from preimage.network.config import ModelConfig
from preimage.network.pdvmrnn import PDVMRNN
from preimage.presets import Planner, PlanOptions
from preimage.records import Shown
from preimage.robot import TASKS, Arm, record
from test_train import CONFIG, demonstrations, weights

CASES = {"latent": ModelConfig.tiny(), "free": ModelConfig.tiny().as_paper()}


def learned(model_config: ModelConfig, group: ProcessGroup = ProcessGroup(), **more: Any) -> torch.Tensor:  # noqa: B008, frozen
    """What six updates of three sequences make of the network: shares of two processes are uneven."""
    exact = replace(CONFIG, batch_size=3, precision="float64")
    return weights(train(demonstrations(), model_config, config=exact, group=group, **more))


def interrupt_at_3(progress: Progress) -> None:
    if progress.update == 3:
        os.kill(os.getpid(), signal.SIGINT)


def stopped(model_config: ModelConfig, group: ProcessGroup, folder: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        learned(model_config, group, folder=folder, progress=interrupt_at_3)


def planned(group: ProcessGroup = ProcessGroup()) -> list[float]:  # noqa: B008, frozen
    """The errors of the plans to three goals, of which two processes have shares of two and one."""
    task = TASKS["reach"]
    seen = record(Arm(), task, count=1, seed=0)
    model = PDVMRNN(ModelConfig.tiny(), sensors_of(seen)).requires_grad_(False)
    shown = [Shown(one.last.frame, one.joints, one.rate_hz) for one in seen]
    planner = Planner(model, None, PlanOptions(iterations=1, horizon=3))
    return [one.plan.error for one in evaluate(planner, Arm(), task, goals=3, seed=1, shown=shown, group=group)]


def work(rank: int, folder: Path) -> None:
    """One of two processes; what came of it is saved under its rank."""
    torch.set_default_dtype(torch.float64)
    torch.set_num_threads(1)
    torch.distributed.init_process_group("gloo", init_method=f"file://{folder}/meet", rank=rank, world_size=2)
    group, seen = ProcessGroup(rank, 2), {}
    for name, model_config in CASES.items():
        seen[f"{name} together"] = learned(model_config, group, folder=folder / name)
    seen["planned together"] = planned(group)
    case = CASES["latent"]
    stopped(case, group, folder / "two-then-one")
    if group.first:
        stopped(case, ProcessGroup(), folder / "one-then-two")
        seen["planned alone"] = planned()
        seen["two then one"] = learned(case, folder=folder / "two-then-one", resume=True)
        seen |= {f"{name} alone": learned(model_config) for name, model_config in CASES.items()}
    seen["one then two"] = learned(case, group, folder=folder / "one-then-two", resume=True)
    if group.first:
        with pytest.raises(ProcessLost, match="another process of this training has stopped"):
            learned(case, group)
        seen["left alone"] = True
    torch.save(seen, folder / f"{rank}.pt")
    os._exit(0)  # without the way out of Python: threads of a broken connection may abort a process there


@pytest.fixture(scope="module")
def seen(tmp_path_factory) -> tuple[dict[str, Any], dict[str, Any]]:
    """What each of two processes got. They are new ones, without the checks of shapes that would refuse float64."""
    folder = tmp_path_factory.mktemp("two")
    torch.multiprocessing.spawn(work, (folder,), nprocs=2)
    first, second = (torch.load(folder / f"{rank}.pt") for rank in (0, 1))
    assert len((folder / "latent" / "log.jsonl").read_text().splitlines()) == 6
    return first, second


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_two_processes_give_the_weights_of_one(seen, case):
    first, second = seen
    torch.testing.assert_close(first[f"{case} together"], first[f"{case} alone"], rtol=0, atol=1e-10)
    assert torch.equal(first[f"{case} together"], second[f"{case} together"])


@pytest.mark.slow
@pytest.mark.parametrize("way", ["two then one", "one then two"])
def test_a_checkpoint_moves_between_one_process_and_two(seen, way):
    torch.testing.assert_close(seen[0][way], seen[0]["latent alone"], rtol=0, atol=1e-10)


@pytest.mark.slow
def test_goals_are_shared_and_all_are_told_of_all(seen):
    first, second = seen
    assert len(first["planned alone"]) == 3
    assert first["planned together"] == second["planned together"] == first["planned alone"]


@pytest.mark.slow
def test_a_process_that_is_left_alone_says_so(seen):
    assert seen[0]["left alone"]


@pytest.mark.parametrize(("count", "size"), [(10, 1), (10, 3), (2, 2)])
def test_the_shares_are_all_sequences_each_once(count, size):
    shares = [ProcessGroup(rank, size).share(count) for rank in range(size)]
    assert sorted(torch.cat(shares).tolist()) == list(range(count))
    assert max(map(len, shares)) - min(map(len, shares)) <= 1


def test_more_processes_than_sequences_are_refused():
    with pytest.raises(ValueError, match="5 processes cannot share an update of 4 sequences"):
        train(demonstrations(4), ModelConfig.tiny(), config=replace(CONFIG, batch_size=9), group=ProcessGroup(0, 5))


@pytest.mark.parametrize("devices", [0, -1])
def test_less_than_one_process_is_refused(devices):
    with pytest.raises(ValueError, match="give 1 or more"):
        join_processes(devices=devices, num_nodes=1)


def test_one_process_is_alone_without_any_library(monkeypatch):
    monkeypatch.setitem(sys.modules, "lightning_fabric", None)
    assert join_processes(devices=1, num_nodes=1, device="cpu") == ProcessGroup()
    with pytest.raises(ValueError, match=r"pip install 'preimage\[many\]'"):
        join_processes(devices=2, num_nodes=1)


@pytest.mark.slow
def test_devices_on_the_command_line(data, tmp_path):
    pytest.importorskip("lightning_fabric")
    script = tmp_path / "words.py"
    script.write_text("from preimage.cli import main\nmain()\n")

    def words(*more: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, script, "train", data, "--size", "tiny", "--updates", "4", "--batch-size", "3", *more]
        return subprocess.run(command, capture_output=True, text=True, timeout=120, env=os.environ | {"OMP_NUM_THREADS": "1"})

    done = words("--out", str(tmp_path / "run"), "--devices", "2")
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("the run is in") == 1
    assert len((tmp_path / "run" / "log.jsonl").read_text().splitlines()) == 4
    refused = words("--out", str(tmp_path / "run"), "--devices", "2")
    assert refused.returncode == 2
    assert refused.stderr.count("preimage: ") == 1
    assert "is not empty" in refused.stderr
