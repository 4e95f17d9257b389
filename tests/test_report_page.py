"""The pages of reports and checks in a real browser: every table fits from 360 pixels to a projector, and axe finds nothing."""

import pytest

from browsing import findings, sideways
from preimage.cli import main
from preimage.report.figures import figure
from preimage.report.films import film
from preimage.report.pages import page
from test_report import make_cases, make_plan, make_results, make_trial

pytestmark = pytest.mark.slow
BOXES = """[...document.querySelectorAll('td, th')]
    .map((cell) => [cell.scrollWidth, cell.clientWidth, cell.getBoundingClientRect().right])"""
"""Of every cell: how wide what is in it is, how wide it is, and where it ends."""
WIDTHS = (360, 480, 768, 1024, 1440, 2560)


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    cases = make_cases(folder)
    for case in cases:
        case.film.parent.mkdir(exist_ok=True)
        film(make_plan(), make_trial(make_plan()), case.film)
        figure(make_plan(), make_trial(make_plan()), case.figure)
    return page(make_results(), cases, folder / "report.html", title="preimage: reach")


@pytest.fixture(scope="module")
def check(data, tmp_path_factory):
    place = tmp_path_factory.mktemp("check") / "check.html"
    main(["check", str(data), "--out", str(place)])
    return place


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("name", ["report", "check"])
def test_nothing_is_hidden_at_any_width_and_axe_finds_nothing(browser, request, name, scheme):
    context = browser.new_context(color_scheme=scheme)
    tab = context.new_page()
    tab.goto(request.getfixturevalue(name).as_uri())
    for width in WIDTHS:
        tab.set_viewport_size({"width": width, "height": 900})
        assert not sideways(tab), width
        boxes = tab.evaluate(BOXES)
        assert all(inside <= shown and right <= width for inside, shown, right in boxes), width
        if width in (360, 1440):
            assert findings(tab) == [], width
    context.close()


@pytest.mark.parametrize("width", WIDTHS)
def test_the_interval_and_the_deviation_of_every_method_are_seen(browser, report, width):
    context = browser.new_context(viewport={"width": width, "height": 900})
    tab = context.new_page()
    tab.goto(report.as_uri())
    for head in ("95 % interval", "deviation (cm): mean", "max"):
        cells = tab.locator(f"table >> nth=0 >> td[data-head='{head}']")
        assert cells.count() == 3
        assert all(cell.is_visible() and cell.inner_text() for cell in cells.all())
    context.close()
