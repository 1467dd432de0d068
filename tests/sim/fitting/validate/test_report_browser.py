"""A report in a real browser: on a phone and on a desk, without barriers, with contents that lead where they say."""

import pytest
from matplotlib.figure import Figure

from sim.fitting.validate.report import Section, page
from sim.fitting.validate.table import ScoreTable
from tests.support.console_fixture import Page, chromium

WIDE = ScoreTable(tuple(f"column {i}" for i in range(12)), (tuple(f"**{1000 + i}**" for i in range(12)),))
WORD = "gain_" + "front_port_" * 12
FIGURE = Figure(figsize=(11, 3))
SECTIONS = (
    Section("What to believe", (f"Of <all> parameters {WORD} is open.",), look=True),
    Section("Every figure", tables=(WIDE,), note="Bold: best.", figures=((FIGURE, "Nothing."),)),
    Section("Text", tables=(WIDE,), text=True, preformatted="a = 1\n" + 200 * "b"),
)


@pytest.fixture(scope="module")
def browser():
    with chromium() as found:
        yield found


@pytest.mark.long
@pytest.mark.parametrize("width", [390, 1440])
def test_a_report_fits_and_has_no_serious_barriers(width, browser, tmp_path):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe is not installed: the extra `dev`")
    there = tmp_path / "report.html"
    there.write_text(page("Boat <1>", SECTIONS, (("Logs", WORD),)), encoding="utf-8")
    shown = Page(browser, there.as_uri(), width=width)
    assert shown.page.evaluate("document.documentElement.scrollWidth") <= width
    found = axe.Axe().run(shown.page).response["violations"]
    assert [v["id"] for v in found if v["impact"] in ("serious", "critical")] == []
    shown.page.get_by_role("link", name="Text").click()
    assert shown.page.evaluate("document.querySelector(':target h2').textContent") == "Text"
    assert not shown.errors
