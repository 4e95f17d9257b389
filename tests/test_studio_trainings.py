"""Laws of trainings on the page: children of the server, asked to stop once, which keep what they did; one at a time."""

import json
import os
import sys
import time

import pytest

pytest.importorskip("fastapi", reason="the extra studio is not installed: pip install -e '.[studio]'")

from preimage.data.view import View
from preimage.storage.locks import locked, writer
from preimage.storage.runs import read_log
from preimage.studio.api import Studio
from preimage.studio.opened import OpenedRun
from preimage.studio.problems import Refusal
from preimage.studio.recordings import Recordings
from preimage.studio.trainer import Trainer
from preimage.studio.trainings import Trainings
from studios import client, decoded, sentence, until

NEVER_ENDING = """
import signal, sys, time
count = []
signal.signal(signal.SIGTERM, lambda *_: count.append(1))
print("ready", file=sys.stderr, flush=True)
while not count: time.sleep(0.01)
time.sleep(0.2)
sys.exit(len(count))
"""
"""A child that says how many signals it got."""
REFUSING = "import sys; print('told on the way', file=sys.stderr); sys.exit('preimage: these recordings teach nothing')"
SETTINGS = {"size": "tiny", "preset": "full", "updates": 5}


def of(script: str) -> Trainer:
    return Trainer((sys.executable, "-c", script))


def ready(trainer: Trainer, out) -> None:
    """Wait until a child listens to signals."""
    said = trainer._children[out].said
    until(lambda: os.fstat(said.fileno()).st_size > 0)


def test_a_training_is_asked_to_stop_once_however_often_the_page_asks(tmp_path):
    trainer = of(NEVER_ENDING)
    out = trainer.begin(tmp_path, tmp_path, "run", **SETTINGS)
    ready(trainer, out)
    assert trainer.state(out) == ("running", None)
    trainer.stop(out)
    trainer.stop(out)
    trainer.close()
    assert trainer._children[out].process.returncode == 1
    assert trainer.state(out) == ("stopped", None)


def test_one_is_trained_at_a_time(tmp_path):
    trainer = of(NEVER_ENDING)
    out = trainer.begin(tmp_path, tmp_path, "run", **SETTINGS)
    ready(trainer, out)
    with pytest.raises(Refusal, match="run is being trained: wait until it ends, or stop it"):
        trainer.begin(tmp_path, tmp_path, "other", **SETTINGS)
    trainer.close()


def test_the_end_of_the_server_waits_for_what_a_training_keeps(tmp_path):
    trainer = of(NEVER_ENDING)
    out = trainer.begin(tmp_path, tmp_path, "run", **SETTINGS)
    ready(trainer, out)
    began = time.monotonic()
    trainer.close()
    assert time.monotonic() - began > 0.15
    assert not trainer._children[out].is_running


def test_why_a_training_failed_is_its_own_last_sentence(tmp_path):
    trainer = of(REFUSING)
    out = trainer.begin(tmp_path, tmp_path, "run", **SETTINGS)
    until(lambda: trainer.state(out)[0] != "running")
    assert trainer.state(out) == ("failed", "these recordings teach nothing")
    trainer.close()


@pytest.mark.parametrize("name", ["../run", "a/b", "", ".hidden", "a" * 65, "a b", "-rf", "run\n"])
def test_a_name_leads_nowhere_else(tmp_path, name):
    with pytest.raises(Refusal):
        of(REFUSING).begin(tmp_path, tmp_path / "runs", name, **SETTINGS)
    assert not list(tmp_path.iterdir())


def test_what_is_there_is_not_written_over(tmp_path):
    (tmp_path / "run").mkdir()
    with pytest.raises(Refusal, match="already"):
        of(REFUSING).begin(tmp_path, tmp_path, "run", **SETTINGS)


def test_who_writes_a_run_is_told_and_the_run_left_to_them(tmp_path):
    trainer = of(REFUSING)
    assert writer(tmp_path) is None
    with locked(tmp_path):
        state, words = trainer.state(tmp_path)
        assert (state, f"process {os.getpid()}" in words) == ("written", True)
        with pytest.raises(Refusal, match="is being written by process"):
            trainer.resume(tmp_path, tmp_path)
    (tmp_path / ".lock").write_text(json.dumps({"pid": 2**22 + 1, "host": os.uname().nodename, "since": "then"}))
    assert writer(tmp_path) is None  # that process was killed
    with pytest.raises(Refusal, match="stop it where it was started"):
        trainer.stop(tmp_path)


def test_what_was_stopped_before_anything_was_kept_says_so_and_can_be_begun_again(data, tmp_path):
    trainings = Trainings([tmp_path / "runs"], Recordings([data], View()), into=tmp_path)
    trainings.trainer = of(NEVER_ENDING)
    for _ in range(2):
        trainings.begin("three", "mine", **SETTINGS)
        ready(trainings.trainer, tmp_path / "runs" / "mine")
        with pytest.raises(Refusal, match="already"):
            trainings.begin("three", "mine", **SETTINGS)
        trainings.stop("mine")
        until(lambda: trainings.described("mine")["state"] == "stopped")
        told = trainings.described("mine")
        assert "begin it again" in told["words"]
        assert not told["resumable"]
    trainings.trainer.close()


# ---- the page


@pytest.fixture
def training(run_folder, data, tmp_path):
    """The studio of a folder for runs in which there is none yet."""
    run = OpenedRun(str(run_folder))
    recordings = Recordings([data], run.view)
    studio = Studio(run, recordings, Trainings([tmp_path / "runs"], recordings, into=tmp_path), work=tmp_path)
    with client(studio) as page:  # left, the server ends, and with it its children
        yield page


def test_what_cannot_be_begun_is_refused_in_a_sentence(training):
    for wanted, why in (
        ({"data": "elsewhere", "name": "a"}, "no data set"),
        ({"data": "three", "name": "../a"}, "choose another name"),
        ({"data": "three", "name": "a", "size": "huge"}, "size"),
        ({"data": "three", "name": "a", "updates": 0}, "updates"),
    ):
        assert why in sentence(training.post("/api/runs", json=wanted))
    for path in ("/api/runs/none/stop", "/api/runs/none/resume"):
        assert "no run" in sentence(training.post(path))
    assert training.get("/api/runs").json() == []


def test_errors_of_held_out_episodes_are_told_beside_those_of_the_training(training, tmp_path):
    run = tmp_path / "runs" / "mine"
    run.mkdir(parents=True)
    (run / "config.json").write_text("{}")
    line = {"visual": 2.0, "proprioceptive": 0.5, "seconds": 0.1}
    for name, updates in (("log.jsonl", (1, 2, 3, 4)), ("held_out.jsonl", (2, 4))):
        (run / name).write_text("".join(json.dumps({"update": update} | line) + "\n" for update in updates))
    (told,) = training.get("/api/runs").json()
    assert (told["update"], told["held_out"]["update"], told["held_out"]["visual"]) == ([1, 2, 3, 4], [2, 4], [2.0, 2.0])
    (run / "held_out.jsonl").unlink()
    assert training.get("/api/runs").json()[0]["held_out"]["update"] == []


@pytest.mark.slow
def test_a_training_is_begun_watched_stopped_and_resumed(training, tmp_path):
    def run() -> dict:
        return training.get("/api/runs").json()[0]

    wanted = {"data": "three", "name": "mine", "size": "tiny", "updates": 100_000}
    assert training.post("/api/runs", json=wanted).status_code == 202
    until(lambda: run()["weights"], seconds=240)  # the first checkpoint
    first = training.get("/api/runs/mine/film").json()
    assert decoded(first["film"]).shape[1] == first["width"] == 64
    assert decoded(first["recorded"]).shape[1] == 64
    assert run()["left_s"] > 0
    assert "is being trained" in sentence(training.post("/api/runs", json=wanted | {"name": "other"}))
    training.post("/api/runs/mine/stop")
    until(lambda: run()["state"] == "stopped", seconds=240)
    done = run()["done"]
    assert training.get("/api/runs/mine/film").json()["weights"] == run()["weights"] != first["weights"]
    assert run()["resumable"]
    assert training.post("/api/runs/mine/resume").status_code == 202
    until(lambda: run()["done"] > done, seconds=240)
    training.post("/api/runs/mine/stop")
    until(lambda: run()["state"] == "stopped", seconds=240)
    updates = [line["update"] for line in read_log(tmp_path / "runs" / "mine")]
    assert updates == list(range(1, len(updates) + 1))  # none was lost, and none was made twice
