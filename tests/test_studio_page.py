"""The studio's page in a real browser: what a person clicks, drops, stops and reads, by mouse and by keyboard alone."""

import io
import re

import numpy as np
import pytest
from PIL import Image

from browsing import click_table, findings, found, reach, served, sideways, visit
from preimage.studio.closed import MOST_UPLOADED

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def address(run_folder, data, tmp_path_factory):
    """The page of a tiny network on the simulated table."""
    with served(run_folder, "--data", data, "--runs", run_folder.parent, "--work", tmp_path_factory.mktemp("work")) as address:
        yield address


@pytest.mark.parametrize(("width", "scheme"), [(1440, "light"), (360, "dark")])
def test_click_then_film_then_execution(browser, address, width, scheme):
    with visit(browser, address, width=width, color_scheme=scheme) as page:
        assert findings(page) == []
        click_table(page)
        page.wait_for_selector("#errors .best")
        found(page)
        assert page.locator("#deviation").inner_text().startswith("Nothing has moved yet")
        assert page.locator("#film-executed.shown").count() == 0
        page.click("#execute")
        page.wait_for_selector("#film-executed.shown")
        assert re.search(r"\d+\.\d cm off", page.locator("#deviation").inner_text())
        assert findings(page) == []
        assert not sideways(page)
        for name in ("intentions", "demonstrations", "training"):
            page.click(f"nav a[href='#/{name}']")
            page.wait_for_selector({"intentions": "#intention-film.shown", "demonstrations": "#findings li", "training": "#runs svg"}[name])
            assert findings(page) == [], name
            assert not sideways(page), name


def test_a_picture_is_uploaded_and_one_that_is_none_gets_a_sentence(browser, address, tmp_path):
    with open(tmp_path / "huge.png", "wb") as huge:
        huge.truncate(MOST_UPLOADED + 1)
    with visit(browser, address, wrong=("422",)) as page:
        bad = {"name": "notes.png", "mimeType": "image/png", "buffer": b"no picture"}
        page.set_input_files("#file", files=[bad])
        page.wait_for_selector("#trouble:not([hidden])")
        assert page.locator("#trouble").inner_text().startswith("notes.png is not an image that can be read")
        page.set_input_files("#file", tmp_path / "huge.png")
        page.wait_for_selector("#trouble >> text=huge.png has more than 32 MB")
        file = io.BytesIO()
        Image.fromarray(np.full((64, 64), 90, np.uint8)).save(file, "PNG")
        page.set_input_files("#file", files=[{"name": "goal.png", "mimeType": "image/png", "buffer": file.getvalue()}])
        found(page)
        assert page.locator("#trouble").is_hidden()


def test_a_plan_goes_on_through_a_reload(browser, address):
    with visit(browser, address) as page:
        page.click("label[for=preset-paper]")
        click_table(page)
        page.wait_for_selector("#errors .best")
        page.reload()
        page.wait_for_selector("#errors .best")
        assert "job=" in page.evaluate("location.hash")
        found(page)


def test_two_tabs_have_each_their_own_plan(browser, address):
    with visit(browser, address) as page:
        other = page.context.new_page()
        other.goto(address)
        other.wait_for_selector("#scene.shown")
        click_table(page, 0.4)
        click_table(other, 0.6)
        found(page)
        found(other)
        assert page.evaluate("location.hash") != other.evaluate("location.hash")


def test_everything_can_be_done_by_keyboard_alone(browser, address):
    with visit(browser, address, reduced_motion="reduce") as page:
        reach(page, "table")
        for key in ("ArrowRight", "ArrowRight", "ArrowDown"):
            page.keyboard.press(key)
        page.keyboard.press("Enter")
        found(page)
        reach(page, "execute")
        page.keyboard.press("Enter")
        page.wait_for_selector("#film-executed.shown")
        reach(page, "head")
        page.keyboard.press("ArrowRight")
        assert page.locator("#head-words").inner_text().startswith("step 1 of")
        assert page.locator("#play").get_attribute("aria-label") == "Play"  # nothing plays by itself where no motion is wanted


def test_a_point_is_dragged_in_the_plane_of_intentions_and_the_film_follows(browser, address):
    with visit(browser, address) as page:
        page.click("nav a[href='#/intentions']")
        page.wait_for_selector("#intention-film.shown")
        before = page.locator("#intention-words").inner_text()
        box = page.locator("#plane").bounding_box()
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        page.mouse.down()
        page.mouse.move(box["x"] + box["width"] / 4, box["y"] + box["height"] / 3, steps=4)
        page.mouse.up()
        page.wait_for_function("before => document.getElementById('intention-words').textContent !== before", arg=before)
        assert page.locator("#intention-film.shown").is_visible()


def test_a_frame_of_a_demonstration_is_taken_as_the_goal(browser, address):
    with visit(browser, address) as page:
        page.click("#from-frame")
        page.wait_for_selector("#frame-preview.shown")
        page.click("#frame-chooser .chief")
        found(page)
        assert ":0:" in page.locator("#command").inner_text()
