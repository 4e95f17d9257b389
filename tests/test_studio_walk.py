"""Laws of a plan that is gone with eyes open: what is told of each step, what a person does to the arm, how it stops, who is refused."""

import time
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("fastapi", reason="the extra studio is not installed: pip install -e '.[studio]'")

from preimage.presets import Planner, ReplanConfig
from preimage.records import Trust
from preimage.robot import TASKS, Arm
from preimage.robot.execution import Stage
from preimage.studio import jobs
from preimage.studio.eyes_open import Walk
from preimage.studio.table import Table
from preimage.studio.touches import Touches, move_object, push, want
from studios import MIDDLE, decoded, events_of, planned, sentence, until

FAST = {"pace": 20}
SLOW = {"pace": 0.5}


@pytest.fixture(scope="module", autouse=True)
def believing():
    """A network that learned nothing believes what it sees, so that it walks to the end."""
    replanner = Planner.replanner
    with pytest.MonkeyPatch.context() as patch:
        settings = ReplanConfig(disbelief=1e9, budget_ms=20)
        patch.setattr(Planner, "replanner", lambda self, **more: replanner(self, settings=settings, **more))
        yield


def walk(page, plan: str, pace: dict) -> str:
    answer = page.post(f"/api/jobs/{plan}/walk", json=pace)
    assert answer.status_code == 202, answer.text
    return answer.json()["job"]


def steps_of(page, job: str) -> list[dict]:
    return [event for event in events_of(page, job) if event["event"] == "step"]


def test_every_step_tells_what_is_believed_and_the_end_how_far_off_it_is(page, plan):
    events = events_of(page, walk(page, plan, FAST))
    steps = [event for event in events if event["event"] == "step"]
    assert [step["step"] for step in steps] == list(range(len(steps)))
    assert [step["steps_left"] for step in steps] == [step["arrival"] - step["at"] for step in steps]
    assert "film" in steps[0]
    assert all(decoded(step["picture"]).shape == (320, 320) for step in steps)
    assert events[-1]["event"] == "done"
    assert events[-1]["ended"] == "arrived"
    assert events[-1]["execution"]["deviation_cm"] > 0
    assert page.get(f"/api/jobs/{plan}").json()["execution"] is None  # the plan itself was not executed blind


def test_a_push_moves_the_hand_to_where_it_was_pushed(page, plan, studio):
    before = steps_of(page, walk(page, plan, FAST))[0]
    there = [before["hand"][0] + 0.1, before["hand"][1]]
    job = walk(page, plan, SLOW)  # of two steps: a busy machine takes longer for the first than it is to last
    assert page.post(f"/api/jobs/{job}/touch", json={"kind": "push", "seen": there}).status_code == 200
    until(lambda: any(event.get("happened") for event in studio.jobs.find(job).events))
    after = next(event for event in studio.jobs.find(job).events if event.get("happened"))
    page.post(f"/api/jobs/{job}/stop")
    assert after["happened"][0].startswith("the hand was pushed")
    assert after["hand"][0] == pytest.approx(there[0], abs=0.03)


def test_another_goal_is_shown_and_judged_by(page, plan):
    job = walk(page, plan, SLOW)
    page.post(f"/api/jobs/{job}/touch", json={"kind": "goal", "seen": [0.35, 0.7]})
    events = events_of(page, job)
    assert sum("goal" in event for event in events) == 1
    blind = page.post(f"/api/jobs/{plan}/execution").json()
    assert events[-1]["execution"]["deviation_cm"] != pytest.approx(blind["deviation_cm"], abs=0.1)


def test_an_arm_that_does_not_believe_what_it_sees_is_held_and_says_why(page, plan, monkeypatch):
    made, doubting = Planner.replanner, ReplanConfig(disbelief=1e-9, patience=1, budget_ms=20)
    monkeypatch.setattr(Planner, "replanner", lambda self, **more: believing_nothing(made(self, **more), doubting))
    events = events_of(page, walk(page, plan, FAST))
    assert (events[-1]["event"], events[-1]["ended"]) == ("done", "held")
    assert events[-1]["why"] == events[-2]["held"]
    assert "what is sensed is not what is imagined" in events[-1]["why"]


def believing_nothing(replanner, settings: ReplanConfig):
    replanner.settings = settings
    return replanner


def test_what_is_done_after_the_last_decision_is_left_undone(plan, studio, monkeypatch):
    walked, made = Walk(studio.run, studio.planned(plan), studio.jobs, pace=20), Planner.replanner

    def late(self, **more):
        replanner = made(self, **more)

        def decide(percept):
            belief = replanner(percept)
            decide.imagined = replanner.imagined
            if belief.done:
                walked.touches.add("goal", (0.35, 0.7))
            return belief

        return decide

    monkeypatch.setattr(Planner, "replanner", late)
    job = studio.jobs.add_beside("walk", walked.go)
    until(lambda: job.ended)
    assert job.state == "done"
    assert walked.touches.taken() == [("goal", (0.35, 0.7))]


def test_a_walk_that_is_stopped_moves_no_more(page, plan, studio):
    job = walk(page, plan, SLOW)
    until(lambda: len(studio.jobs.find(job).events) > 2)
    page.post(f"/api/jobs/{job}/stop")
    until(lambda: studio.jobs.find(job).ended)
    ended = len(studio.jobs.find(job).events)
    time.sleep(1 / (2.5 * SLOW["pace"]))
    assert studio.jobs.find(job).events[-1]["event"] == "stopped"
    assert len(studio.jobs.find(job).events) == ended
    assert "nothing moves" in sentence(page.post(f"/api/jobs/{job}/touch", json={"kind": "push", "seen": [0.5, 0.5]}))


def test_a_plan_is_found_while_an_arm_moves(page, plan, studio):
    job = walk(page, plan, {"pace": 0.25})
    until(lambda: len(studio.jobs.find(job).events) > 2)
    other = studio.jobs.find(planned(page, page.post("/api/goals/place", json=MIDDLE).json()))
    until(lambda: other.began_s is not None)
    assert not studio.jobs.find(job).ended
    assert other.events[0]["ahead"] == 0
    assert events_of(page, other.id)[-1]["event"] == "done"
    page.post(f"/api/jobs/{job}/stop")


def test_a_walk_that_nobody_watches_is_held(page, plan, studio, monkeypatch):
    monkeypatch.setattr(jobs, "GRACE_S", 0.05)
    job = walk(page, plan, SLOW)
    until(lambda: studio.jobs.find(job).ended)
    assert studio.jobs.find(job).state == "stopped"


def test_what_cannot_be_done_on_a_table_is_refused(page, plan):
    job = walk(page, plan, SLOW)
    assert "choose push or goal" in sentence(page.post(f"/api/jobs/{job}/touch", json={"kind": "object", "seen": [0.5, 0.5]}))
    page.post(f"/api/jobs/{job}/stop")
    assert "not found yet" in sentence(page.post(f"/api/jobs/{job}/walk", json=FAST))
    assert page.post(f"/api/jobs/{plan}/walk", json={"pace": 0}).status_code == 422


def test_a_refused_goal_moves_nothing_until_somebody_goes_on_anyway(page, plan, studio, monkeypatch):
    made, refusal = studio.jobs.find(plan).result, ("the goal is off what was demonstrated",)
    monkeypatch.setattr(made, "plan", replace(made.plan, trust=Trust(0.1, refused=True, reasons=refusal, note="by 50 goals")))
    for answer in (
        page.post(f"/api/jobs/{plan}/execution"),
        page.post(f"/api/jobs/{plan}/walk", json=FAST),
        page.get(f"/api/jobs/{plan}/joints.csv"),
        page.get(f"/api/jobs/{plan}/lerobot.zip"),
    ):
        assert "off what was demonstrated" in sentence(answer)
        assert answer.status_code == 409
    assert page.post(f"/api/jobs/{plan}/kept").json()["command"].count("--anyway") == 2
    page.post(f"/api/jobs/{plan}/anyway")
    assert page.get(f"/api/jobs/{plan}").json()["anyway"]
    assert page.post(f"/api/jobs/{plan}/execution").status_code == 200
    assert page.get(f"/api/jobs/{plan}/joints.csv").status_code == 200


# ---- touches


def staged(name: str, seed: int = 0) -> tuple[Table, Arm, Stage]:
    table, arm = Table(TASKS[name], pixels=64), Arm()
    arm.set_up(table.task.workspace)
    return table, arm, Stage(table.task, arm, table.scene(seed))


def test_a_moved_object_stands_where_it_was_clicked():
    table, arm, stage = staged("move-object")
    there = np.array([0.5, 0.3, 0.05])
    words = move_object(table, arm, stage, tuple(table.camera.project(there)))
    np.testing.assert_allclose(arm.ground_truth().object_m[:2], there[:2], atol=1e-6)
    np.testing.assert_allclose(stage.scene.positions_m["object"][:2], there[:2], atol=1e-6)
    assert words.startswith("the object was moved by")


def test_an_object_that_is_held_is_not_moved():
    table, arm, stage = staged("move-object")
    closed = np.append(stage.true_joints[:-1], 0.0)
    stage.move(closed, 0.4)
    with pytest.raises(ValueError, match="the hand holds the object"):
        move_object(table, arm, stage, (0.5, 0.5))


@pytest.mark.parametrize(("seen", "why"), [((0.02, 0.02), "beside the table"), ((0.5, 0.9), "does not get there")])
def test_the_hand_is_not_pushed_to_where_it_does_not_get(seen, why):
    table, arm, stage = staged("reach")
    before = arm.end_effector_m
    with pytest.raises(ValueError, match=why):
        push(table, arm, stage, seen)
    np.testing.assert_array_equal(arm.end_effector_m, before)


def test_another_goal_is_what_the_camera_would_see_there():
    table, _, stage = staged("reach")
    percept, _ = want(table, stage, (0.4, 0.6))
    np.testing.assert_allclose(table.camera.project(np.array(stage.scene.positions_m["goal"])), (0.4, 0.6), atol=1e-6)
    np.testing.assert_array_equal(percept.frame, table.goal(stage.scene).frame)


def test_of_what_is_done_within_a_step_the_last_of_each_kind_counts():
    touches = Touches(("push", "goal"))
    for kind, seen in (("push", (0.1, 0.1)), ("goal", (0.2, 0.2)), ("push", (0.3, 0.3))):
        touches.add(kind, seen)
    assert touches.taken() == [("push", (0.3, 0.3)), ("goal", (0.2, 0.2))]
    assert touches.taken() == []
