"""How many threads compute: as many as there are cores that nothing else uses, and no more than the work has use for.

torch's threads wait for one another at every operation, and the small network has some hundred of these a step. Where a neighbour holds a
core, all of them wait for the one thread that has to share it. They wait asleep (`sleep_while_waiting`): awake, as is usual, they hold the
cores that the others wait for, and a plan takes five to ten times as long.
"""

import os
import time
from pathlib import Path
from statistics import median

MOST_FOR_SMALL = 4
"""Threads that a plan of the small network has use for: its operations are too short to be divided further."""
LOOKS, PAUSE_S = 5, 0.01
"""How often it is counted what runs now, and the time between."""
RUNNING = Path("/proc/loadavg")
"""Linux counts here what runs at this moment, beside the means of some minutes (proc_loadavg(5))."""


def sleep_while_waiting() -> None:
    """Let threads that wait for one another sleep, unless OMP_WAIT_POLICY says otherwise; nothing changes once torch is loaded."""
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")


def threads_for(*, cores: int, busy: float, at_most: int | None = None) -> int:
    """Cores that are left, one at least.

    >>> threads_for(cores=8, busy=1.0, at_most=4), threads_for(cores=2, busy=1.0), threads_for(cores=2, busy=9.0)
    (4, 1, 1)
    """
    left = max(1, round(cores - busy))
    return min(left, at_most) if at_most else left


def busy_cores() -> float:
    """Cores that other processes use now; 0 where the system does not say.

    Linux says what runs at this moment; macOS the mean of the last minute.
    """
    if RUNNING.is_file():
        looks = []
        for _ in range(LOOKS):
            running, _ = RUNNING.read_text().split()[3].split("/")
            looks.append(int(running) - 1)  # one of them is this process
            time.sleep(PAUSE_S)
        return float(max(0, median(looks)))
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0


def choose_threads(*, at_most: int | None = MOST_FOR_SMALL) -> str:
    """Let torch compute with as many threads as suit the machine now, never more than it would take by itself (OMP_NUM_THREADS).

    Args:
        at_most: threads that the work has use for; None: any number.

    Returns:
        what was chosen, in one line.
    """
    import torch

    cores, busy = os.cpu_count() or 1, busy_cores()
    allowed = torch.get_num_threads()
    threads = min(allowed, threads_for(cores=cores, busy=busy, at_most=at_most))
    torch.set_num_threads(threads)
    reason = f"{cores} cores, {busy:.0f} other threads at work" if busy >= 0.5 else f"{cores} cores, none busy"
    return f"threads: {threads} ({reason})"
