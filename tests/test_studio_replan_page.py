"""Replanning, trust and stopping on the studio's page, in a real browser: nothing moves unasked, pushes are told of, stop holds."""

import re
import shutil
from dataclasses import asdict

import pytest

from browsing import click_table, findings, found, reach, served, sideways, visit
from preimage.ideas.calibration import Calibration
from preimage.presets import PlanOptions
from preimage.storage.atomic_write import write_json
from preimage.storage.run_files import CALIBRATION

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def refusing(run_folder, tmp_path_factory):
    """A run that was calibrated such that every goal as `full` is refused."""
    folder = tmp_path_factory.mktemp("calibrated") / "tiny"
    shutil.copytree(run_folder, folder)
    known = Calibration(("goal_residual",), (-99.0,), (1.0,), (0.0,), 3.0, 1.0, 50, 0, 60, 55, PlanOptions.full().calibrated_with())
    write_json(folder / CALIBRATION, asdict(known))
    return folder


@pytest.fixture(scope="module")
def address(refusing):
    with served(refusing) as address:
        yield address


@pytest.fixture(scope="module")
def bundled():
    with served("reach") as address:
        yield address


@pytest.mark.parametrize(("width", "scheme"), [(1440, "dark"), (360, "light")])
def test_a_refused_goal_says_why_and_can_be_gone_to_anyway(browser, address, width, scheme):
    with visit(browser, address, width=width, color_scheme=scheme) as page:
        click_table(page)
        found(page)
        assert page.locator("#verdict").inner_text().startswith("Refused")
        assert "not found in what can be imagined" in page.locator("#reasons").inner_text()
        assert page.locator("#execute").is_hidden()
        assert page.locator("#walk-link").is_hidden()
        assert "--anyway" in page.locator("#command").inner_text()
        assert findings(page) == []
        assert not sideways(page)
        page.click("#anyway")
        page.reload()
        found(page)  # what was said stays said
        page.click("#execute")
        page.wait_for_selector("#film-executed.shown")


def test_a_search_is_stopped_and_another_can_begin(browser, bundled):
    with visit(browser, bundled) as page:
        page.click("label[for=preset-paper]")  # of the bundled network it takes some ten seconds: a click comes before its end
        click_table(page)
        page.wait_for_selector("#errors .best")
        page.click("#stop")
        page.wait_for_selector("#status >> text=stopped after")
        assert page.locator("#found").is_hidden()
        page.click("label[for=preset-full]")
        found(page)


def test_a_walk_begins_when_it_is_asked_for_tells_of_a_push_and_is_held_by_stop(browser, bundled):
    with visit(browser, f"{bundled}#/replan", shown="#walk-scene.shown", reduced_motion="reduce") as page:
        assert findings(page) == []
        reach(page, "walk-table")
        page.keyboard.press("ArrowDown")
        page.keyboard.press("Enter")
        page.wait_for_selector("#walk-go:not([disabled])")
        assert page.locator("#walk-status").inner_text() == "Nothing has moved yet."
        assert page.locator("#beliefs .limit").count() == 1  # the axes, and nothing in them
        assert page.locator("#beliefs .end-doubt").count() == 0
        page.select_option("#pace", "0.25")
        page.click("#walk-go")
        page.wait_for_selector("#beliefs .end-doubt")
        page.focus("#walk-table")
        page.keyboard.press("ArrowRight")
        page.keyboard.press("Enter")
        page.wait_for_selector("#happened li >> text=pushed")
        page.click("#walk-stop")
        page.wait_for_selector("#walk-status >> text=held where it is")
        assert findings(page) == []
        page.reload()
        page.wait_for_selector("#walk-status >> text=held where it is")  # the walk is told of again
        assert page.locator("#happened li").count() >= 1


def test_a_plan_of_the_other_page_is_gone_to_its_end(browser, bundled):
    with visit(browser, bundled, width=360, color_scheme="dark") as page:
        click_table(page)
        found(page)
        assert re.match(r"\d+ % likely to succeed", page.locator("#trust").inner_text())
        page.click("#walk-link")
        page.wait_for_selector("#walk-go:not([disabled])")
        page.select_option("#pace", "1")
        page.click("#walk-go")
        page.wait_for_selector("#walk-status >> text=cm off")
        assert page.locator("#walk-status").inner_text().startswith("Arrived")
        assert findings(page) == []
        assert not sideways(page)
