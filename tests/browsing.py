"""The studio in a real browser: a Chromium, and visits that ask nobody else for anything.

Where Playwright or a Chromium is missing, whatever imports this is skipped with a line that says what to install.
"""

import os
import shutil
from contextlib import contextmanager

import pytest

from serving import served as served

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytest.importorskip("fastapi", reason="the extra studio is not installed: pip install -e '.[studio]'")
api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed: pip install -e '.[test]'")
if CHROMIUM is None:
    pytest.skip("no Chromium is here to try the page in: apt-get install chromium", allow_module_level=True)

PATIENCE_MS = 180_000
"""How long a step of the page may take on a machine that does other work."""
QUIET = ["--disable-gpu", "--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync"]


@contextmanager
def chromium():
    alone = ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
    with api.sync_playwright() as play:
        browser = play.chromium.launch(executable_path=CHROMIUM, args=[*QUIET, *alone])
        yield browser
        browser.close()


@contextmanager
def visit(browser, address, *, width=1440, wrong=(), shown="#scene.shown", **more):
    """A visit of the page, which asks nobody else for anything and complains of nothing but what is expected."""
    context = browser.new_context(viewport={"width": width, "height": 900}, **more)
    context.set_default_timeout(PATIENCE_MS)
    outside, complaints, here = [], [], address.split("#")[0]
    context.on("request", lambda asked: outside.append(asked.url) if not asked.url.startswith((here, "blob:", "data:")) else None)
    context.on("console", lambda said: complaints.append(said.text) if said.type == "error" else None)
    context.on("weberror", lambda error: complaints.append(str(error.error)))
    page = context.new_page()
    page.goto(address)
    page.wait_for_selector(shown)
    try:
        yield page
    finally:
        context.close()
    assert not outside
    assert not [text for text in complaints if not any(status in text for status in wrong)]


def click_table(page, across=0.5, down=0.6):
    box = page.locator("#scene").bounding_box()
    page.mouse.click(box["x"] + across * box["width"], box["y"] + down * box["height"])


def found(page):
    page.wait_for_selector("#found:not([hidden])")


def findings(page) -> list[str]:
    """What axe has against the page as it is."""
    from axe_core_python.sync_playwright import Axe

    told = Axe().run(page)["violations"]
    return [f"{each['id']}: {each['nodes'][0]['html'][:120]}" for each in told]


def sideways(page) -> bool:
    """Whether the page has to be scrolled sideways."""
    return page.evaluate("document.documentElement.scrollWidth > document.documentElement.clientWidth")


def reach(page, name: str) -> None:
    """Press Tab until an element has the focus."""
    for _ in range(60):
        if page.evaluate("document.activeElement.id") == name:
            return
        page.keyboard.press("Tab")
    raise AssertionError(f"{name} is not reached by the Tab key")
