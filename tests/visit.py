"""A whole visit of the studio in a browser, with its screenshots and a short film of it, those of README.

    python tests/visit.py --out docs/media

takes some minutes. `--all --width 360 --scheme dark --mark=-360` shows every page as it looks elsewhere.
"""

import argparse
import io
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from PIL import Image

import preimage
from browsing import chromium, click_table, found, visit
from preimage.robot import TASKS, Arm, record
from serving import served

FILM_WIDTH = 960
"""Pixels of the film: small enough to lie in a README, large enough to read the headings."""
QUALITY = 75
"""Of the film's pictures (WebP)."""
GO = "step => { const head = document.getElementById('head'); head.value = step; head.dispatchEvent(new Event('input')); }"
"""Puts the playhead on a step."""
SCREEN = 1200
"""Width of the screen that is filmed (pixels)."""


class Camera:
    """Takes screenshots, and the pictures of a film, each shown for so long."""

    def __init__(self, page, out: Path, *, mark: str, whole: bool) -> None:
        self._page, self._out, self._mark, self._whole = page, out, mark, whole
        self._pictures: list[Image.Image] = []
        self._shown_ms: list[int] = []

    def still(self, name: str) -> None:
        """What is on the screen, or the whole page, as a file."""
        self._page.screenshot(path=self._out / f"{name}{self._mark}.png", full_page=self._whole)

    def film(self, shown_ms: int) -> None:
        """What is on the screen now."""
        whole = Image.open(io.BytesIO(self._page.screenshot())).convert("RGB")
        self._pictures.append(whole.resize((FILM_WIDTH, whole.height * FILM_WIDTH // whole.width), Image.Resampling.LANCZOS))
        self._shown_ms.append(shown_ms)

    def save(self) -> Path:
        """The film."""
        place, (first, *rest) = self._out / f"studio{self._mark}.webp", self._pictures
        first.save(place, save_all=True, append_images=rest, duration=self._shown_ms, loop=0, quality=QUALITY, method=6)
        return place


def plan(page, camera: Camera) -> None:
    """A goal is clicked, searched for, imagined, and gone to."""
    camera.film(900)
    click_table(page, 0.36, 0.62)
    page.wait_for_selector("#errors .best")
    camera.film(250)
    found(page)
    page.wait_for_selector("#execute:not([hidden])")
    camera.film(900)
    page.click("#execute")
    page.wait_for_selector("#film-executed.shown")
    page.wait_for_selector("#play[aria-label=Pause]")
    page.click("#play")
    for step in range(int(page.get_attribute("#head", "max") or 0) + 1):
        page.evaluate(GO, step)
        camera.film(160)
    camera.film(900)
    page.evaluate("scrollTo(0, 0)")
    camera.still("studio")


def replan(page, camera: Camera) -> None:
    """The arm goes with eyes open, is pushed, and gets another goal."""
    page.click("nav a[href='#/replan']")
    page.wait_for_selector("#walk-scene.shown")
    page.mouse.click(*place(page, 0.4, 0.62))
    page.wait_for_selector("#walk-go:not([disabled])")
    camera.film(700)
    page.select_option("#pace", "0.25")
    page.click("#walk-go")
    page.wait_for_selector("#walk-stop:not([hidden])")
    for step in steps(page, camera):
        if step == 3:
            page.mouse.move(*place(page, 0.62, 0.48))
            page.mouse.down()
        if step == 5:
            page.mouse.up()
        if step == 7:
            page.click("label[for=touch-goal]")
            page.mouse.click(*place(page, 0.63, 0.7))
        if step == 9:
            camera.still("studio-replan")
    camera.film(1200)


def place(page, across: float, down: float) -> tuple[float, float]:
    """Where on the screen a place of the table is."""
    box = page.locator("#walk-scene").bounding_box()
    return box["x"] + across * box["width"], box["y"] + down * box["height"]


def steps(page, camera: Camera) -> Iterator[int]:
    """Every step of a walk once it is shown, up to the end."""
    seen = 0
    while page.locator("#walk-stop").is_visible():
        shown = page.locator("#beliefs").get_attribute("data-step")
        if shown is not None and int(shown) >= seen:
            camera.film(260)
            yield seen
            seen = int(shown) + 1
        page.wait_for_timeout(50)


def intentions(page, camera: Camera) -> None:
    """The point is dragged through the plane."""
    page.click("nav a[href='#/intentions']")
    page.wait_for_selector("#intention-film.shown")
    box = page.locator("#plane").bounding_box()
    page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
    page.mouse.down()
    for number in range(8):
        page.mouse.move(box["x"] + (0.5 - 0.04 * number) * box["width"], box["y"] + (0.5 + 0.03 * number) * box["height"])
        page.wait_for_timeout(300)
        camera.film(220)
    page.mouse.up()
    camera.film(900)
    camera.still("studio-intentions")


def others(page, camera: Camera) -> None:
    """The other pages, as they are; on that of trainings a tiny network learns."""
    page.click("nav a[href='#/demonstrations']")
    page.wait_for_selector("#findings li")
    camera.still("studio-demonstrations")
    page.click("nav a[href='#/training']")
    page.select_option("#train-size", "tiny")
    page.click("#train button")
    page.wait_for_selector("[data-film=film]:not([hidden])")
    camera.still("studio-training")
    page.click("button.stop:not([hidden])")
    page.click("nav a[href='#/results']")
    page.wait_for_selector("#result-rows tr")
    page.click("#result-rows button >> nth=0")
    camera.still("studio-results")


@contextmanager
def opened(scratch: Path) -> Iterator[str]:
    """The studio of the bundled model of reaching, with recordings, and with results where there are any."""
    data, results = scratch / "reach-six", Path("results")
    preimage.save(record(Arm(), TASKS["reach"], count=6, seed=3), data, task="reach", joint_unit="rad")
    more = ["--results", results] if results.is_dir() else []
    with served("reach", "--data", data, "--runs", scratch / "runs", "--work", scratch, *more) as address:
        yield address


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    words.add_argument("--out", type=Path, required=True, help="folder of the pictures")
    words.add_argument("--width", type=int, default=SCREEN)
    words.add_argument("--scheme", choices=["light", "dark"], default="light")
    words.add_argument("--all", action="store_true", help="the other pages too, and each as a whole")
    words.add_argument("--mark", default="", help="after the names of the files")
    given = words.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    with (
        tempfile.TemporaryDirectory() as scratch,
        opened(Path(scratch)) as address,
        chromium() as browser,
        visit(browser, address, width=given.width, color_scheme=given.scheme) as page,
    ):
        camera = Camera(page, given.out, mark=given.mark, whole=given.all)
        plan(page, camera)
        replan(page, camera)
        intentions(page, camera)
        if given.all:
            others(page, camera)
        film = camera.save()
        print(f"{film}, {film.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
