"""A studio without a browser: what its tests ask it, and what it answers."""

import base64
import io
import json
import time

import numpy as np
from PIL import Image
from starlette.testclient import TestClient

from preimage.studio.api import Studio
from preimage.studio.opened import OpenedRun
from preimage.studio.recordings import Recordings
from preimage.studio.server import application
from preimage.studio.trainings import Trainings

HERE = "http://localhost:8230"
MIDDLE = {"seen": [0.5, 0.6], "seed": 0}


def opened(run, data, work) -> Studio:
    run = OpenedRun(str(run))
    recordings = Recordings(data, run.view)
    return Studio(run, recordings, Trainings([run.folder.parent], recordings, into=work / "runs"), work=work)


def client(studio: Studio, **more) -> TestClient:
    return TestClient(application(studio, **more), base_url=HERE, raise_server_exceptions=False)


def sentence(answer) -> str:
    """What a refusal says, once it has the form of RFC 9457."""
    assert answer.headers["content-type"] == "application/problem+json"
    problem = answer.json()
    assert (problem["status"], problem["type"]) == (answer.status_code, "about:blank")
    assert problem["title"]
    assert "\n" not in problem["detail"]
    return problem["detail"]


def events_of(page, job: str, **more) -> list[dict]:
    told = page.get(f"/api/jobs/{job}/events", **more).text
    return [json.loads(line.removeprefix("data: ")) for line in told.splitlines() if line.startswith("data: ")]


def planned(page, goal: dict, preset: str = "paper") -> str:
    answer = page.post("/api/plans", json={"goal": goal["id"], "preset": preset})
    assert answer.status_code == 202, answer.text
    return answer.json()["job"]


def picture(size=(64, 64), form="PNG", **more) -> bytes:
    file = io.BytesIO()
    Image.fromarray(np.random.default_rng(0).integers(0, 255, size, np.uint8)).save(file, form, **more)
    return file.getvalue()


def until(true, seconds: float = 20.0) -> None:
    """Wait for it."""
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, "it never happened"
        time.sleep(0.005)


def forever(job):
    while True:
        job.go_on()
        time.sleep(0.001)


def decoded(text: str) -> np.ndarray:

    return np.asarray(Image.open(io.BytesIO(base64.b64decode(text))))
