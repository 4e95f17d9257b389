"""The studio under load, on loopback: some tabs that plan in turn, and what that does to the memory of the server.

    python tests/load.py --plans 200 --tabs 8

trains a network that knows nothing, opens the studio of it, and lets each tab choose a goal, ask for a plan and listen to it to its end,
over and over. Every plan has to be found. The memory (RSS, of Linux) is looked at after as many plans as the studio remembers, and at the
end.
"""

import argparse
import json
import tempfile
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from http.client import HTTPResponse
from pathlib import Path
from urllib.request import Request, urlopen

import preimage
from preimage.robot import TASKS, Arm, record
from serving import serving

PATIENCE_S = 300.0
"""How long a plan may take among others, on a machine that does other work."""
WARM_UP = 24
"""Plans before the memory is looked at first: as many jobs are remembered."""


@dataclass(frozen=True)
class Load:
    """What came of it."""

    found: int
    failed: list[str]
    grown_mb: float


def network(folder: Path) -> Path:
    """A run folder of the smallest network, which learned nothing."""
    shown = record(Arm(), TASKS["reach"], count=3, seed=0)
    preimage.train(shown, preimage.ModelConfig.tiny(), config=preimage.TrainOptions(updates=1), folder=folder, about={"task": "reach"})
    return folder


def memory_mb(pid: int) -> float:
    """Resident memory of a process (MB)."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS:")) / 1024


def plan(address: str, place: tuple[float, float]) -> str:
    """Choose a goal, ask for a plan and listen to it; how it ended."""
    goal = json.load(asked(f"{address}api/goals/place", {"seen": place}))
    job = json.load(asked(f"{address}api/plans", {"goal": goal["id"], "preset": "regression"}))["job"]
    with asked(f"{address}api/jobs/{job}/events") as told:
        *_, last = (json.loads(line.removeprefix(b"data: ")) for line in told if line.startswith(b"data: "))
    return last["event"]


def asked(address: str, body: dict | None = None) -> HTTPResponse:
    """The answer to a request; OSError where it is a refusal."""
    content = None if body is None else json.dumps(body).encode()
    return urlopen(Request(address, content, {"Content-Type": "application/json"}), timeout=PATIENCE_S)


def put_under_load(address: str, pid: int, *, plans: int, tabs: int, warm_up: int = WARM_UP) -> Load:
    """Plan as often as that, shared by the tabs, once the studio is warm."""
    waiting, lock, ended = iter(range(warm_up + plans)), threading.Lock(), list[str]()
    before_mb: list[float] = []

    def visit() -> None:
        while (number := next_of(waiting, lock)) is not None:
            if number == warm_up:
                before_mb.append(memory_mb(pid))
            try:
                ended.append(plan(address, (0.4 + 0.02 * (number % 10), 0.55 + 0.01 * (number % 7))))
            except (ValueError, OSError) as error:
                ended.append(repr(error))

    threads = [threading.Thread(target=visit) for _ in range(tabs)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return Load(ended.count("done"), [how for how in ended if how != "done"], memory_mb(pid) - before_mb[0])


def next_of(waiting: Iterator[int], lock: threading.Lock) -> int | None:
    with lock:
        return next(waiting, None)


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    words.add_argument("--plans", type=int, default=200)
    words.add_argument("--tabs", type=int, default=8)
    given = words.parse_args()
    with tempfile.TemporaryDirectory() as folder, serving(network(Path(folder) / "tiny"), "--work", folder) as (address, pid):
        load = put_under_load(address, pid, plans=given.plans, tabs=given.tabs)
    print(f"{load.found} plans found, {WARM_UP} of them to warm up, {len(load.failed)} failed, grown by {load.grown_mb:.1f} MB")
    print(*sorted(set(load.failed)), sep="\n")
    raise SystemExit(bool(load.failed))


if __name__ == "__main__":
    main()
