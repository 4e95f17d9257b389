"""Compiled ahead: what runs is read from numba's cache, in a first process as in every later one.

Code that numba has compiled a moment ago rounds otherwise, in the last bit, than the same code read from its cache: the first training on a
machine would end with other weights than the second. So what a machine has not compiled yet is compiled in a process of its own, and an
empty file beside the cache says that it was.
"""

import hashlib
import os
import platform
import subprocess
import sys
from functools import cache
from pathlib import Path

import numba
from llvmlite import binding

from preimage.fast.compiled import go_forward
from preimage.fast.convolution import OPTIONS

SOURCES = Path(__file__).parent


@cache
def compile_ahead() -> None:
    """Have the loops compiled and cached, where they are not; where that cannot be, the first call compiles them here."""
    if not OPTIONS["cache"] or mark().exists():
        return
    found_at = os.pathsep.join([str(SOURCES.parents[1]), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep)
    environment = {**os.environ, "PYTHONPATH": found_at}
    subprocess.run([sys.executable, "-m", "preimage.fast"], env=environment, capture_output=True, check=False)


def mark() -> Path:
    """The file that says that these sources were compiled by this numba for this processor."""
    processor = os.environ.get("NUMBA_CPU_NAME", binding.get_host_cpu_name()), os.environ.get("NUMBA_CPU_FEATURES", "")
    told = [numba.__version__, platform.python_version(), *processor]
    told += [f"{path.name} {path.stat().st_mtime} {path.stat().st_size}" for path in sorted(SOURCES.glob("*.py"))]  # as numba knows them
    return Path(str(go_forward.stats.cache_path)) / f"compiled-{hashlib.sha256(repr(told).encode()).hexdigest()[:16]}"
