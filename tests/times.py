"""How long whoever looks at the studio waits, in a real browser, with the bundled network of reaching, beside what is asked.

    python tests/times.py --out results/studio-times.json

takes two minutes, and says something on quiet cores only: each time is the one on the clock until the page shows it. What the server
computed for it meanwhile (processor seconds, as Linux tells them) stands beside.
"""

import argparse
import json
import os
import shlex
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from urllib.request import urlopen

import numpy as np

from browsing import chromium, click_table, visit
from preimage.compute.devices import CPU
from preimage.compute.precision import instruction_set
from preimage.robot import TASKS
from preimage.storage.provenance import provenance
from preimage.studio.table import Table
from serving import serving

ASKED_S = {"up": 3.0, "first paint": 0.5, "click to first point": 0.3, "click to executed film": 3.0, "drag to film": 0.4}
"""What the page is to keep to; what else is measured has no such figure."""
GOAL_SEED = 600
"""Draws the goals: a validation seed."""
DRAGGED = 0.03
"""Share of the plane that the point is dragged by at a time."""
PAINTED = "[performance.getEntriesByName('first-contentful-paint')[0].startTime, performance.now()]"


class Watch:
    """Seconds on the clock, and those of the server's processors, since something began; of everything each time is kept."""

    def __init__(self) -> None:
        self.waited_s, self.computed_s = defaultdict[str, list[float]](list), defaultdict[str, list[float]](list)

    def begin(self, pid: int | None = None) -> None:
        self._pid, self._began_s, self._before_s = pid, time.perf_counter(), computed_s(pid)

    def ends(self, name: str) -> None:
        self.waited_s[name].append(time.perf_counter() - self._began_s)
        if self._pid is not None:
            self.computed_s[name].append(computed_s(self._pid) - self._before_s)

    def medians(self) -> dict[str, dict[str, float]]:
        kinds = {"median_s": self.waited_s, "server_cpu_median_s": self.computed_s}
        return {kind: {name: round(median(each), 3) for name, each in of.items()} for kind, of in kinds.items()}


def computed_s(pid: int | None) -> float:
    """Processor seconds of a process so far."""
    if pid is None:
        return 0.0
    numbers = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()  # its name may hold anything
    return (int(numbers[11]) + int(numbers[12])) / os.sysconf("SC_CLK_TCK")


def goals(count: int) -> Iterator[tuple[float, float]]:
    """Places on the picture as the task itself draws them."""
    table, rng = Table(TASKS["reach"], pixels=64), np.random.default_rng(GOAL_SEED)
    for _ in range(count):
        across, down = table.camera.project(np.array(table.task.sample(rng).positions_m[table.goal_name]))
        yield float(across), float(down)


def start(watch: Watch) -> None:
    """From the command to a page that can be opened."""
    watch.begin()
    with serving("reach", threads=None) as (address, pid):
        urlopen(address).read()
        watch.ends("up")
        watch.computed_s["up"].append(computed_s(pid))


def look(page, watch: Watch) -> None:
    """The page was just opened."""
    painted_ms, shown_ms = page.evaluate(PAINTED)
    watch.waited_s["first paint"].append(painted_ms / 1000)
    watch.waited_s["table shown"].append(shown_ms / 1000)


def click(page, place: tuple[float, float], pid: int, watch: Watch) -> None:
    """A goal is clicked, and gone to as soon as there is a plan."""
    watch.begin(pid)
    click_table(page, *place)
    page.wait_for_selector("#errors .best")
    watch.ends("click to first point")
    page.wait_for_selector("#execute:not([hidden])")
    watch.ends("click to plan")
    page.click("#execute")
    page.wait_for_selector("#film-executed.shown")
    watch.ends("click to executed film")


def drag(page, count: int, pid: int, watch: Watch) -> None:
    """The point is dragged through the plane of intentions, so far at a time."""
    watch.begin(pid)
    page.click("nav a[href='#/intentions']")
    page.wait_for_selector("#intention-film.shown")
    watch.ends("intentions shown")
    box = page.locator("#plane").bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()
    page.wait_for_timeout(1000)  # the film of where it was pressed
    for number in range(1, count + 1):
        before = page.locator("#intention-words").inner_text()
        watch.begin(pid)
        page.mouse.move(box["x"] + (0.5 - DRAGGED * number) * box["width"], box["y"] + 0.55 * box["height"])
        page.wait_for_function("before => document.getElementById('intention-words').textContent !== before", arg=before)
        watch.ends("drag to film")
    page.mouse.up()


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    words.add_argument("--out", type=Path, required=True, help="JSON file")
    words.add_argument("--rounds", type=int, default=9, help="how often each is done")
    given = words.parse_args()
    watch = Watch()
    for _ in range(given.rounds):
        start(watch)
    with serving("reach", threads=None) as (address, pid), chromium() as browser:
        for place in goals(given.rounds):
            with visit(browser, address) as page:
                look(page, watch)
                click(page, place, pid, watch)
        with visit(browser, address) as page:
            drag(page, given.rounds, pid, watch)
    found = watch.medians()
    for name, seconds in found["median_s"].items():
        computed, asked = found["server_cpu_median_s"].get(name), ASKED_S.get(name)
        print(f"{name}: {seconds:.2f} s" + (f" ({asked} s asked)" if asked else "") + (f", server {computed:.2f} s" if computed else ""))
    about = {"kind": "studio-times", "instruction_set": instruction_set(CPU), "rounds": given.rounds, "asked_s": ASKED_S} | found
    each = {name: [round(seconds, 3) for seconds in times] for name, times in watch.waited_s.items()}
    made = provenance() | {"command": shlex.join(["python", *sys.argv])}
    given.out.write_text(json.dumps(about | {"each_s": each, "provenance": made}, indent=2) + "\n")


if __name__ == "__main__":
    main()
