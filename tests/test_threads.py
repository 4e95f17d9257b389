"""Threads leave the neighbours' cores alone, and there is always one."""

import os
import subprocess
import sys

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from preimage.compute import threads
from preimage.compute.threads import busy_cores, choose_threads, threads_for


@given(cores=st.integers(1, 256), busy=st.floats(0, 1000), at_most=st.none() | st.integers(1, 64))
def test_there_is_one_thread_at_least_and_never_more_than_cores_are_left(cores: int, busy: float, at_most: int | None) -> None:
    chosen = threads_for(cores=cores, busy=busy, at_most=at_most)
    assert 1 <= chosen <= max(1, min(cores - busy + 0.5, at_most or cores))


@given(cores=st.integers(1, 64), busy=st.floats(0, 64))
def test_a_busier_machine_never_gets_more_threads(cores: int, busy: float) -> None:
    assert threads_for(cores=cores, busy=busy + 1) <= threads_for(cores=cores, busy=busy)


@pytest.mark.parametrize(
    ("busy", "allowed", "taken", "line"),
    [
        (0, 8, 4, "threads: 4 (8 cores, none busy)"),
        (0, 2, 2, "threads: 2 (8 cores, none busy)"),
        (6, 8, 2, "threads: 2 (8 cores, 6 other threads at work)"),
        (9, 8, 1, "threads: 1 (8 cores, 9 other threads at work)"),
    ],
)
def test_torch_gets_what_is_chosen_and_it_is_said(monkeypatch, busy: int, allowed: int, taken: int, line: str) -> None:
    given: list[int] = []
    monkeypatch.setattr(os, "cpu_count", lambda: 8)
    monkeypatch.setattr(threads, "busy_cores", lambda: float(busy))
    monkeypatch.setattr(torch, "get_num_threads", lambda: allowed)
    monkeypatch.setattr(torch, "set_num_threads", given.append)
    assert choose_threads() == line
    assert given == [taken]


def test_what_runs_beside_this_process_is_counted(monkeypatch, tmp_path) -> None:
    monkeypatch.setattr(threads, "RUNNING", tmp_path / "loadavg")
    monkeypatch.setattr(os, "getloadavg", lambda: (2.5, 1.0, 0.5), raising=False)
    assert busy_cores() == 2.5
    (tmp_path / "loadavg").write_text("7.10 5.00 3.00 4/512 12345\n")
    assert busy_cores() == 3.0
    monkeypatch.setattr(threads, "RUNNING", tmp_path / "none")
    monkeypatch.delattr(os, "getloadavg", raising=False)
    assert busy_cores() == 0.0


CPU_SECONDS = """
import preimage, time, torch

def cpu_seconds(threads: int) -> float:
    torch.set_num_threads(threads)
    numbers, began = torch.ones(2**17), time.process_time()
    for _ in range(300):
        numbers.add_(1)  # on all threads
        sum(range(20_000))  # on one
    return time.process_time() - began

cpu_seconds(2)
print(cpu_seconds(2) / cpu_seconds(1))
"""


@pytest.mark.slow
def test_a_thread_that_waits_takes_no_core() -> None:
    environment = {name: value for name, value in os.environ.items() if name not in ("OMP_WAIT_POLICY", "OMP_NUM_THREADS")}
    told = subprocess.run([sys.executable, "-c", CPU_SECONDS], capture_output=True, text=True, check=True, env=environment)
    assert float(told.stdout) < 1.5  # awake it would be near 2


def test_who_has_chosen_how_threads_wait_is_left_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_WAIT_POLICY", "ACTIVE")
    threads.sleep_while_waiting()
    assert os.environ["OMP_WAIT_POLICY"] == "ACTIVE"
