"""The studio's server: who may speak with it, what it answers, and what is told again after a reload."""

import io
import re
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import preimage
from preimage.data.sources import find_percept
from preimage.records import Demonstration
from preimage.report.result_files import is_evaluation, read_result
from preimage.storage.runs import read_config

pytest.importorskip("fastapi", reason="the extra studio is not installed: pip install -e '.[studio]'")
from starlette.testclient import TestClient

from preimage.studio import closed
from preimage.studio.api import Studio
from studios import MIDDLE, client, decoded, events_of, opened, picture, planned, sentence

RESULTS = Path(__file__).parents[1] / "results"
DESIGN = Path(preimage.__file__).parent / "report" / "design.css"
STATIC = Path(preimage.__file__).parent / "studio" / "static"


@pytest.fixture(scope="module")
def own_page(tmp_path_factory) -> TestClient:
    """Of a run trained on recordings of another robot, which nothing simulates."""
    place = tmp_path_factory.mktemp("own")
    rng = np.random.default_rng(0)
    frames = rng.integers(0, 255, (2, 5, 48, 64, 3), np.uint8)
    shown = [Demonstration(each, rng.uniform(size=(5, 2)), 5.0, ("base", "wrist")) for each in frames]
    preimage.train(shown, preimage.ModelConfig.tiny(), config=preimage.TrainOptions(updates=1), folder=place / "run")
    preimage.save(shown, place / "data", task="wave")
    return client(opened(place / "run", [place / "data"], place / "work"))


# ---- who may speak with it


@pytest.mark.parametrize("host", ["localhost:8230", "127.0.0.1:9000", "[::1]:8230"])
def test_it_listens_on_this_machine_and_through_a_tunnel(page, host):
    assert page.get("/api/jobs", headers={"host": host}).status_code == 200


@pytest.mark.parametrize("host", ["evil.example", "localhost.evil.example", "127.0.0.1.evil.example:8230", "a@localhost", "10.0.0.1", ""])
def test_a_name_that_was_made_to_lead_here_is_refused(page, host):
    assert "localhost" in sentence(page.get("/api/jobs", headers={"host": host}))


@pytest.mark.parametrize(
    "headers", [{"origin": "http://evil.example"}, {"origin": "null"}, {"origin": "http://localhost:1"}, {"sec-fetch-site": "cross-site"}]
)
def test_the_page_of_another_site_is_refused(page, headers):
    for answer in (page.post("/api/plans", json={"goal": 1}, headers=headers), page.get("/api/jobs", headers=headers)):
        assert answer.status_code == 403
        assert "another site" in sentence(answer)


def test_elsewhere_than_on_this_machine_a_token_is_asked_for(studio):
    guarded = client(studio, token="secret")
    assert guarded.get("/").status_code == 200  # the page itself tells nothing
    for given in ({}, {"authorization": "Bearer wrong"}, {"authorization": "secret ö".encode("latin-1")}):
        answer = guarded.get("/api/jobs", headers=given)
        assert answer.status_code == 401
        assert "token" in sentence(answer)
    assert guarded.get("/api/jobs", headers={"authorization": "Bearer secret", "host": "robot.lab:8230"}).status_code == 200


def test_every_answer_has_the_headers_that_keep_it_closed(page):
    for path in ("/", "/plan.js", "/api/studio", "/api/jobs/none", "/nothing"):
        headers = page.get(path).headers
        assert headers["content-security-policy"].startswith("default-src 'none'")
        assert "unsafe" not in headers["content-security-policy"]
        assert (headers["x-content-type-options"], headers["referrer-policy"]) == ("nosniff", "no-referrer")
        assert "set-cookie" not in headers
        assert "access-control-allow-origin" not in headers


@pytest.mark.parametrize(
    "path", ["/config.json", "/..%2f..%2fserver.py", "/static/../server.py", "/%2e%2e/api.py", "/api/data/..%2f..%2fetc/episodes/0"]
)
def test_no_path_leads_out_of_the_folders_that_were_given(page, path):
    answer = page.get(path)
    assert answer.status_code == 404
    sentence(answer)


def test_more_than_is_needed_is_not_read(page):
    said = sentence(page.post("/api/plans", content=b" " * (closed.MOST_ASKED + 1), headers={"content-type": "application/json"}))
    assert "send less" in said
    assert "32 MB" in sentence(page.post("/api/goals/picture", content=b" " * (closed.MOST_UPLOADED + 1)))

    def pieces():
        for _ in range(3):
            yield b" " * (closed.MOST_ASKED // 2)

    assert page.post("/api/plans", content=pieces()).status_code == 413  # its length is not said beforehand


# ---- goals


def test_a_place_on_the_table_becomes_a_goal_that_shows_the_hand_there(page):
    goal = page.post("/api/goals/place", json=MIDDLE).json()
    assert (goal["kind"], goal["executable"]) == ("place", True)
    np.testing.assert_allclose(goal["place"], MIDDLE["seen"], atol=1e-6)
    assert goal["goal"] != goal["start"]


@pytest.mark.parametrize(("seen", "why"), [((0.5, 0.02), "beside the table"), ((0.5, 0.22), "does not get there")])
def test_a_place_where_the_arm_does_not_get_is_refused_in_a_sentence(page, seen, why):
    assert why in sentence(page.post("/api/goals/place", json={"seen": seen}))


def test_a_request_of_another_form_is_refused_in_a_sentence(page):
    assert sentence(page.post("/api/goals/place", json={"seen": [2, 0]})).startswith("seen.0: input should be less")
    assert sentence(page.post("/api/plans", json={"goal": 10**6})).endswith("choose one again")
    assert "openapi" in sentence(page.delete("/api/jobs"))
    assert sentence(page.get("/api/jobs/none")) == "there is no such plan any more: plan again"


def test_an_uploaded_picture_is_decoded_as_everywhere_else(page, studio):
    turned = Image.Exif()
    turned[0x0112] = 6
    for content in (picture(), picture((200, 200)), picture(form="JPEG", exif=turned), picture((64, 64, 3))):
        answer = page.post("/api/goals/picture", content=content, headers={"x-name": "a%20cup.png"})
        assert answer.status_code == 201, answer.text
        assert answer.json()["words"] == "the picture a cup.png"
    lying = np.zeros((64, 64), np.uint8)
    lying[:8] = 255
    file = io.BytesIO()
    Image.fromarray(lying).save(file, "PNG", exif=turned)
    goal = page.post("/api/goals/picture", content=file.getvalue()).json()
    frame = studio.goals.find(goal["id"]).goal.frame
    assert frame[:, -8:].mean() == 255  # turned upright


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"", "cannot be decoded"),
        (b"GIF89a", "cannot be decoded"),
        (picture((30, 90)), "scale or crop it"),
        (picture()[:90], "cannot be decoded"),
    ],
)
def test_what_is_no_picture_is_refused_in_a_sentence(page, content, why):
    assert why in sentence(page.post("/api/goals/picture", content=content, headers={"x-name": "..%2f..%2fcup.png"}))


def test_a_picture_that_unpacks_to_more_than_any_camera_is_refused_before_it_is_unpacked(page):
    file = io.BytesIO()
    Image.new("1", (9_000, 9_000)).save(file, "PNG")
    assert "more than 64 million" in sentence(page.post("/api/goals/picture", content=file.getvalue()))


def test_a_frame_of_a_recording_becomes_a_goal_and_its_episode_the_start(page, data):
    goal = page.post("/api/goals/frame", json={"data": "three", "episode": 1, "step": 3}).json()
    shown = preimage.load(data)[1]
    assert goal["words"] == "step 3 of episode 1 of three"
    assert np.array_equal(decoded(goal["start"]), shown.frames[0][..., 0])
    assert np.array_equal(decoded(goal["goal"]), shown.frames[3][..., 0])
    assert "not 99" in sentence(page.post("/api/goals/frame", json={"data": "three", "episode": 1, "step": 99}))
    assert "no data set" in sentence(page.post("/api/goals/frame", json={"data": "/etc", "episode": 1, "step": 0}))


# ---- plans


def test_a_plan_is_told_of_from_its_first_evaluation_to_its_end_and_again_after_a_reload(page, studio):
    goal = page.post("/api/goals/place", json=MIDDLE).json()
    job = planned(page, goal)
    events = events_of(page, job)
    names = [event["event"] for event in events]
    assert names[:2] == ["waiting", "began"]
    assert names[-1] == "done"
    looked = [event for event in events if event["event"] == "looked"]
    assert [event["n"] for event in looked] == list(range(1, len(looked) + 1))
    lowest = [event["lowest"] for event in looked]
    assert lowest == sorted(lowest, reverse=True)
    assert all("frame" in event for event in looked if event["error"] == event["lowest"])
    plan = events[-1]["plan"]
    assert len(plan["joints"]) == plan["steps"] == len(plan["way"])
    assert events_of(page, job) == events
    assert events_of(page, job, headers={"last-event-id": str(events[-3]["id"])}) == events[-2:]
    assert page.get(f"/api/jobs/{job}").json()["about"]["goal"] == goal


def test_nothing_moves_before_it_is_asked_for(page, plan):
    assert page.get(f"/api/jobs/{plan}").json()["execution"] is None
    executed = page.post(f"/api/jobs/{plan}/execution").json()
    assert executed["deviation_cm"] > 0
    assert len(executed["joints"]) == executed["steps"] == len(executed["way"])
    assert page.get(f"/api/jobs/{plan}").json()["execution"] == executed
    assert page.post(f"/api/jobs/{plan}/execution").json() == executed  # it moves once


def test_what_is_kept_repeats_the_plan_on_the_command_line(page, studio, plan):
    goal = page.get(f"/api/jobs/{plan}").json()["about"]["goal"]
    command = page.post(f"/api/jobs/{plan}/kept").json()["command"]
    start, wanted = re.findall(r"--(?:start|goal) (\S+)", command)
    remembered = studio.goals.find(goal["id"])
    for source, percept in ((start, remembered.start), (wanted, remembered.goal)):
        found = find_percept(source, studio.run.sensors, view=studio.run.view, default_step=0)
        assert np.array_equal(found.percept.frame, percept.frame)
        assert found.scene == remembered.scene
    assert f"--as paper --out plans/{Path(start.split(':')[0]).name} && preimage execute plans/" in command


def test_a_plan_to_a_frame_has_the_command_from_the_beginning(page, data):
    job = planned(page, page.post("/api/goals/frame", json={"data": "three", "episode": 1, "step": 3}).json())
    assert f"--start {data}:1:0 --goal {data}:1:3 --as paper" in events_of(page, job)[-1]["plan"]["command"]


def test_the_joints_can_be_taken_along(page, plan):
    rows = page.get(f"/api/jobs/{plan}/joints.csv").text.splitlines()
    assert rows[0] == "time_s,joint1,joint2,joint4,joint6"
    assert len(rows) > 2
    assert page.get(f"/api/jobs/{plan}/film.mp4").content[4:8] == b"ftyp"
    with zipfile.ZipFile(io.BytesIO(page.get(f"/api/jobs/{plan}/lerobot.zip").content)) as archive:
        assert "lerobot/meta/info.json" in archive.namelist()


def test_a_run_without_a_simulator_plans_and_moves_nothing(own_page):
    assert own_page.get("/api/studio").json()["table"] is None
    assert "no simulated table" in sentence(own_page.post("/api/goals/place", json=MIDDLE))
    goal = own_page.post("/api/goals/frame", json={"data": "data", "episode": 0, "step": 4}).json()
    assert not goal["executable"]
    job = planned(own_page, goal)
    *events, last = events_of(own_page, job)
    plan = last["plan"]
    assert {len(event["point"]) for event in events if event["event"] == "looked"} == {
        2
    }  # of two sequences intentions differ in one number
    assert (plan["way"], plan["executable"]) == (None, False)
    assert "execute" not in plan["command"]
    assert "no simulated arm" in sentence(own_page.post(f"/api/jobs/{job}/execution"))
    wide = picture((48, 64, 3))
    named = {"x-name": "goal.png"}
    job = planned(own_page, own_page.post("/api/goals/picture", content=wide, headers=named).json())
    assert "--goal goal.png --as paper" in events_of(own_page, job)[-1]["plan"]["command"]


# ---- the rest


def test_the_plane_of_intentions_and_what_is_imagined_from_a_point(page, run_folder):
    plane = page.get("/api/intentions").json()
    count = read_config(run_folder)["num_sequences"]
    assert len(plane["points"]) == count == len(plane["colours"][0]["values"])
    film = page.post("/api/intentions/film", json={"point": plane["points"][0]}).json()
    assert len(film["joints"]) == film["steps"]
    assert page.post("/api/intentions/film", json={"point": [99, 0]}).status_code == 422


def test_recordings_are_shown_with_what_the_examination_finds(page, data):
    shown = page.get("/api/data/three/episodes/2").json()
    assert (len(shown["steps"]), shown["joint_names"]) == (8, ["joint1", "joint2", "joint4", "joint6"])
    assert decoded(shown["film"]).shape == (8 * 64, 64)
    found = page.get("/api/data/three/findings").json()
    assert found["verdict"]
    assert {"severity", "kind", "what", "help", "episodes", "places"} == set(found["findings"][0])


def test_trainings_are_watched_from_their_logs(page):
    (run,) = page.get("/api/runs").json()
    assert (run["name"], run["done"], run["updates"], run["left_s"]) == ("tiny", 2, 2, 0)
    assert len(run["visual"]) == len(run["proprioceptive"]) == 2


def results_in(folder, studio) -> TestClient:
    return client(Studio(studio.run, studio.recordings, studio.trainings, results=folder))


def test_results_are_shown_with_their_command(studio):
    rows = results_in(RESULTS, studio).get("/api/results").json()
    assert rows
    assert all(row["goals"] >= row["success"] and len(row["interval"]) == 2 for row in rows)
    assert sum(row["command"] is not None for row in rows) > len(rows) / 2


def test_a_result_leads_to_the_films_beside_it_and_to_no_other_file(studio, tmp_path):
    some = next(path for path in RESULTS.glob("*.json") if is_evaluation(read_result(path)))
    for place in ("a.json", "demo/result.json"):
        (tmp_path / place).parent.mkdir(exist_ok=True)
        shutil.copy(some, tmp_path / place)
    for film in ("a/best.mp4", "demo/goal-1.mp4", "other.mp4"):
        (tmp_path / film).parent.mkdir(exist_ok=True)
        (tmp_path / film).write_bytes(film.encode())
    page = results_in(tmp_path, studio)
    assert {row["name"]: row["films"] for row in page.get("/api/results").json()} == {"a": ["best.mp4"], "demo": ["goal-1.mp4"]}
    assert page.get("/api/results/a/films/best.mp4").content == b"a/best.mp4"
    for path in ("a/films/other.mp4", "a/films/..%2fother.mp4", "a/films/..%2fa.json", "demo/films/result.json", "none/films/best.mp4"):
        assert page.get(f"/api/results/{path}").status_code == 404


def test_the_page_asks_for_nothing_that_is_not_described(page):
    described = {re.sub(r"\{\w+\}", "X", path) for path in page.get("/api/openapi.json").json()["paths"]}
    calls = re.findall(
        r"(?<![.\w])(?:get|post|upload|download|blob|asked)\(\s*[`\"]([^`\"]+)[`\"]",
        "".join(path.read_text() for path in STATIC.glob("*.js")),
    )
    asked = {"/api/" + re.sub(r"\$\{[^}]*\}", "X", call).split("?")[0] for call in calls}
    assert asked - described <= {"/api/openapi.json", "/api/X"}
    assert len(asked) > 10


def test_the_page_asks_nobody_else_and_is_light():
    texts = {path.name: path.read_text() for path in (*STATIC.iterdir(), DESIGN)}
    outside = {
        name: re.findall(r"(?:https?:)?//[\w.-]+\.\w+", re.sub(r"http://www\.w3\.org/\S+", "", text)) for name, text in texts.items()
    }
    assert not {name: found for name, found in outside.items() if found}
    assert sum(len(text.encode()) for text in texts.values()) < 150_000
    assert not re.search(r"\son\w+=|\sstyle=|javascript:", texts["index.html"])


def test_a_studio_without_its_libraries_says_what_to_install(refused, monkeypatch):
    monkeypatch.setattr("preimage.cli.showing.find_spec", lambda name: None)
    assert refused("studio") == (2, "the studio needs fastapi and uvicorn: pip install 'preimage[studio]', or make studio")


def test_words_that_are_off_are_refused(refused, tmp_path):
    assert refused("studio", "--port", 70000)[0] == 2
    assert refused("studio", "--results", tmp_path / "none")[0] == 2
    assert refused("studio", tmp_path)[0] == 2
