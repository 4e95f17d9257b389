"""The studio's jobs: how they go on, stop, wait for each other and are told of."""

import asyncio
import threading
import time

import pytest

pytest.importorskip("fastapi", reason="the extra studio is not installed: pip install -e '.[studio]'")

from preimage.studio import jobs
from preimage.studio.problems import Refusal
from studios import forever, until


def test_a_job_that_is_asked_to_stop_ends_at_its_next_step():
    job = jobs.Jobs().add("plan", forever)
    until(lambda: job.state == "running")
    job.stop()
    until(lambda: job.ended)
    assert (job.state, job.events[-1]["event"]) == ("stopped", "stopped")


def test_a_job_to_which_nobody_listens_is_stopped(monkeypatch):
    monkeypatch.setattr(jobs, "GRACE_S", 0.05)
    job = jobs.Jobs().add("plan", forever)
    until(lambda: job.ended)
    assert (job.state, job.events[-1]["event"]) == ("stopped", "stopped")


def test_a_job_whose_last_listener_leaves_is_stopped(monkeypatch):
    monkeypatch.setattr(jobs, "GRACE_S", 0.05)
    job = jobs.Jobs().add("plan", forever)

    async def listen_for_a_while() -> None:
        first, second = (job.listen(-1, never) for _ in range(2))
        assert (await anext(first))["event"] == (await anext(second))["event"] == "waiting"
        await first.aclose()
        await asyncio.sleep(4 * jobs.GRACE_S)
        assert not job.ended  # one is still there
        await second.aclose()

    async def never() -> bool:
        return False

    asyncio.run(listen_for_a_while())
    until(lambda: job.ended)
    assert job.state == "stopped"


def test_the_queue_is_bounded_and_says_when_to_come_again():
    queue, go = jobs.Jobs(), threading.Event()
    waiting = [queue.add("plan", lambda _: go.wait(20) and {}) for _ in range(jobs.MOST_WAITING + 1)]
    with pytest.raises(Refusal, match="waiting already") as refused:
        queue.add("plan", lambda _: {})
    assert refused.value.headers == {"Retry-After": "2"}
    waiting[-1].stop()
    queue.add("plan", lambda _: {})  # there is room again
    go.set()
    until(lambda: all(job.ended for job in queue.all()))
    assert waiting[-1].state == "stopped"


def test_what_goes_on_beside_the_queue_is_bounded_and_does_not_hold_it_up():
    queue, go = jobs.Jobs(), threading.Event()
    beside = [queue.add_beside("walk", lambda _: go.wait(20) and {}) for _ in range(jobs.MOST_BESIDE)]
    with pytest.raises(Refusal, match="moving already"):
        queue.add_beside("walk", lambda _: {})
    job = queue.add("plan", lambda _: {})
    until(lambda: job.ended)
    assert not any(each.ended for each in beside)
    go.set()


def test_few_jobs_are_remembered():
    queue = jobs.Jobs()
    for _ in range(3 * jobs.MOST_KEPT):
        job = queue.add("plan", lambda _: {"plan": "a"})
        until(lambda job=job: job.ended)
    assert len(queue.all()) <= jobs.MOST_KEPT
    with pytest.raises(Refusal, match="plan again"):
        queue.find("none")


def test_what_fails_is_told_in_one_sentence():
    queue = jobs.Jobs()

    def fail(error):
        raise error

    told = [queue.add("plan", lambda _, error=error: fail(error)) for error in (ValueError("the goal has\nno frame"), KeyError("x"))]
    until(lambda: all(job.ended for job in told))
    assert [job.state for job in told] == ["failed", "failed"]
    assert told[0].events[-1]["detail"] == "the goal has no frame"
    assert told[1].events[-1]["detail"].startswith("an error inside preimage (KeyError)")


def test_what_is_short_is_done_between_two_steps_of_what_is_long():
    queue, go = jobs.Jobs(), threading.Event()

    def long(job):
        while not go.is_set():
            job.go_on()
            queue.run_errands()
            time.sleep(0.001)
        return {}

    job = queue.add("plan", long)
    assert queue.errand(lambda: 7).result(timeout=20) == 7
    assert not job.ended
    go.set()
