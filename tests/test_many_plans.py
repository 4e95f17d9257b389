"""A process that plans all day neither grows nor keeps files open."""

import json
import subprocess
import sys

import pytest

PLANS = """
import json, os, sys
from dataclasses import replace
from pathlib import Path
import preimage as pi
from preimage.network import engines
engines.ENGINES[:] = []  # compiling would take longer than all plans
few = {"iterations": 0, "horizon": 2, "dimensions": 2, "precision": "float32"}
options = replace(pi.PlanOptions.full(), **few)
without, searching = (pi.load_planner(sys.argv[1], replace(options, iterations=count)) for count in (0, 1))
goal, count = pi.Percept(pi.read_shown(Path(sys.argv[1]))[0].last_frame), int(sys.argv[2])
def used():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]), len(os.listdir("/proc/self/fd"))
seen = []
for number in range(count):
    (without if number % 10 else searching).plan(goal=goal)
    if number + 1 in (10, count):
        seen.append(used())
print(json.dumps(seen))
"""


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory and open files are read from /proc")
def test_hundreds_of_plans_take_the_memory_of_ten_and_leave_no_file_open(run_folder):
    ended = subprocess.run([sys.executable, "-c", PLANS, str(run_folder), "600"], capture_output=True, text=True, check=True)
    (pages, files), (pages_later, files_later) = json.loads(ended.stdout)
    assert pages_later <= 1.015 * pages  # 7 kB a plan
    assert files_later == files
