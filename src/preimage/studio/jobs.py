"""Work that takes seconds: a queue of bounded length, one worker, and an account of each job that can be read again from its beginning.

What takes long without computing much, as an arm that moves, is done beside the queue, and asks the worker for what it has to compute.

A job writes down what happens as events with numbers. Whoever listens gets those that were, then those that come; after a reload the page
asks for the rest by the number of the last one it saw. A job to which nobody listens any more for `GRACE_S` is stopped.
"""

import asyncio
import itertools
import queue
import secrets
import threading
import time
from collections import OrderedDict
from collections.abc import AsyncIterator, Callable
from concurrent.futures import Future
from http import HTTPStatus
from typing import Any, TypeVar

from preimage.records import number_of
from preimage.studio.problems import Refusal

MOST_WAITING = 8
"""Jobs that may wait for their turn: more would wait for minutes."""
MOST_BESIDE = 4
"""Jobs that may go on beside the queue: each has a thread, and every person looks at one."""
MOST_KEPT = 24
"""Jobs that are remembered once they ended; one takes about 0.2 MB."""
GRACE_S = 20.0
"""How long a job goes on while nobody listens: a reload takes less, also where the job itself takes the processor."""
HEARTBEAT_S = 1.0
"""How often a listener is looked after: whether it is still there."""
Event = dict[str, Any]
Value = TypeVar("Value")


class JobStopped(Exception):
    """Raised inside a job that was asked to stop."""


class Job:
    """One piece of work and its account."""

    def __init__(self, kind: str, work: "Callable[[Job], Event]", about: dict[str, Any], *, beside: bool = False) -> None:
        self.id, self.kind, self.about = secrets.token_urlsafe(9), kind, about
        self.work, self.beside = work, beside
        self.events: list[Event] = []
        self.result: Any = None
        self.began_s: float | None = None
        self.listeners: dict[int, asyncio.Event] = {}
        self.last_heard_s = time.monotonic()
        self._numbers = itertools.count()
        self._stop = threading.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self.state = "waiting"

    @property
    def ended(self) -> bool:
        return self.state in ("done", "stopped", "failed")

    def stop(self) -> None:
        """Ask it to end at its next step; where it still waits, it ends when its turn comes."""
        self._stop.set()

    @property
    def asked_to_stop(self) -> bool:
        return self._stop.is_set()

    def go_on(self) -> None:
        """Raises JobStopped where the job was asked to stop, or nobody has listened for a while."""
        if not self.listeners and time.monotonic() - self.last_heard_s > GRACE_S:
            self._stop.set()
        if self._stop.is_set():
            raise JobStopped

    def rest(self, seconds: float) -> None:
        """Wait (s), but not once the job was asked to stop."""
        self._stop.wait(seconds)

    def tell(self, name: str, **about: Any) -> None:
        """Write an event down, from any thread, and wake whoever listens."""
        self.events.append({"event": name, "id": len(self.events), **about})
        self._wake()

    def end(self, state: str, **about: Any) -> None:
        """Write the last event down: nobody who listens leaves before it."""
        self.events.append({"event": state, "id": len(self.events), **about})
        self.state, self.work = state, _nothing  # what it held is let go of
        self._wake()

    def _wake(self) -> None:
        for listener in list(self.listeners.values()):
            if self._loop is not None:
                self._loop.call_soon_threadsafe(listener.set)

    async def listen(self, after: int, gone: Callable[[], Any]) -> AsyncIterator[Event | None]:
        """Events with higher numbers than `after`, as they come, up to the last; None now and then, while there is nothing to say."""
        number, wake = next(self._numbers), asyncio.Event()
        self._loop, self.listeners[number] = asyncio.get_running_loop(), wake
        following = after + 1
        try:
            while True:
                wake.clear()
                while following < len(self.events):
                    yield self.events[following]
                    following += 1
                if self.ended and following >= len(self.events):
                    return
                try:
                    await asyncio.wait_for(wake.wait(), HEARTBEAT_S)
                except TimeoutError:
                    if await gone():
                        return
                    yield None
        finally:
            del self.listeners[number]
            self.last_heard_s = time.monotonic()


class Jobs:
    """The worker, what waits for it, and the jobs that are remembered."""

    def __init__(self) -> None:
        self._jobs: OrderedDict[str, Job] = OrderedDict()
        self._waiting: queue.Queue[Job | None] = queue.Queue()
        self._errands: queue.SimpleQueue[tuple[Future, Callable[[], Any]]] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._work, name="studio worker", daemon=True)
        self._thread.start()

    def add(self, kind: str, work: Callable[[Job], Event], **about: Any) -> Job:
        """A new job at the end of the queue.

        Raises:
            Refusal: there is no more room in the queue.
        """
        sentence = f"{number_of(MOST_WAITING, 'plan')} are waiting already: wait until one has ended, or stop one"
        job = self._remember(Job(kind, work, about), most=MOST_WAITING + 1, sentence=sentence)
        self._waiting.put(job)
        return job

    def add_beside(self, kind: str, work: Callable[[Job], Event], **about: Any) -> Job:
        """A new job that begins at once in a thread of its own: what it computes, it asks the worker for (`errand`).

        Raises:
            Refusal: as many go on as may.
        """
        sentence = f"{number_of(MOST_BESIDE, 'arm')} are moving already: wait until one has arrived, or stop one"
        job = self._remember(Job(kind, work, about, beside=True), most=MOST_BESIDE, sentence=sentence)
        threading.Thread(target=self._do, args=[job], name=f"studio {kind}", daemon=True).start()
        return job

    def _remember(self, job: Job, *, most: int, sentence: str) -> Job:
        """Raises Refusal where as many of its kind are not ended yet."""
        with self._lock:
            ahead = [each for each in self._jobs.values() if each.beside == job.beside and not each.ended and not each.asked_to_stop]
            if len(ahead) >= most:
                raise Refusal(HTTPStatus.SERVICE_UNAVAILABLE, sentence, retry_after_s=2)
            job.tell("waiting", ahead=0 if job.beside else len(ahead))
            self._jobs[job.id] = job
            for old in [key for key, each in self._jobs.items() if each.ended][: max(0, len(self._jobs) - MOST_KEPT)]:
                del self._jobs[old]
        return job

    def find(self, key: str) -> Job:
        """Raises Refusal where there is no such job, or it is too long ago."""
        with self._lock:
            job = self._jobs.get(key)
        if job is None:
            raise Refusal(HTTPStatus.NOT_FOUND, "there is no such plan any more: plan again")
        return job

    def all(self) -> list[Job]:
        with self._lock:
            return list(self._jobs.values())

    def errand(self, work: Callable[[], Value]) -> "Future[Value]":
        """Something short that the worker does next, also between two steps of a job."""
        promised: Future[Value] = Future()
        self._errands.put((promised, work))
        self._waiting.put(None)  # wakes the worker where it has nothing to do
        return promised

    async def by_worker(self, work: Callable[[], Value]) -> Value:
        """What the worker computes, also between two steps of a job; given up where whoever asked has left."""
        return await asyncio.wrap_future(self.errand(work))

    def run_errands(self) -> None:
        """Called by the worker, and by its jobs between two steps."""
        while not self._errands.empty():
            promised, work = self._errands.get()
            if not promised.set_running_or_notify_cancel():
                continue  # whoever asked has left
            try:
                promised.set_result(work())
            except BaseException as error:
                promised.set_exception(error)

    def _work(self) -> None:
        while True:
            job = self._waiting.get()
            self.run_errands()
            if job is not None:
                self._do(job)

    def _do(self, job: Job) -> None:
        try:
            job.go_on()
            job.state, job.began_s = "running", time.monotonic()
            job.tell("began")
            job.end("done", **job.work(job))
        except JobStopped:
            job.end("stopped")
        except Exception as error:
            job.end("failed", detail=sentence_of(error))


def _nothing(_: Job) -> Event:
    raise AssertionError("a job is done once")


def sentence_of(error: Exception) -> str:
    """What the page shows of an error: that of a ValueError, which was written for people, and of others where to look."""
    if isinstance(error, Refusal):
        return error.sentence
    if isinstance(error, ValueError):
        return " ".join(str(error).split("\n"))
    return f"an error inside preimage ({type(error).__name__}): it is not yours; what the terminal shows of it helps to mend it"
