"""A studio in a process of its own, as whoever opens it has it."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def serving(*words: object, threads: str | None = "1") -> Iterator[tuple[str, int]]:
    """The address of a studio that was started with these words, and the number of its process; None leaves its threads to the machine."""
    environment = os.environ | ({"OMP_NUM_THREADS": threads} if threads else {})
    command = [sys.executable, "-m", "preimage", "studio", *map(str, words), "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=environment) as server:
        assert server.stdout is not None
        told = server.stdout.readline()
        yield told.removeprefix("open ").strip(), server.pid
        server.terminate()


@contextmanager
def served(*words: object, threads: str | None = "1") -> Iterator[str]:
    """Its address alone."""
    with serving(*words, threads=threads) as (address, _):
        yield address
