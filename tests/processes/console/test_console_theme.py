"""Light and dark: the page follows the system, its switch is remembered, and all of it can be read in both."""

from itertools import product

import pytest
from axe_playwright_python.sync_playwright import Axe

from tests.processes.console.layout import THEMES
from tests.support.console_fixture import CHOSEN, Page, TapedBoat

pytestmark = pytest.mark.real_time

PAPER = "getComputedStyle(document.querySelector('header')).backgroundColor"
WHITE, DARK = "rgb(255, 255, 255)", "rgb(22, 27, 32)"


def grave(page, rules=None):
    """What axe-core finds serious or critical, or all that it finds against `rules`: (rule, element)."""
    found = Axe().run(page.page, options={"runOnly": rules} if rules else None).response["violations"]
    return [
        (v["id"], n["target"]) for v in found if rules or v["impact"] in ("serious", "critical") for n in v["nodes"]
    ]


@pytest.mark.long
def test_the_page_follows_the_system_and_the_switch_is_remembered(console, browser):
    page = Page(browser, console, color_scheme="dark")
    assert page.page.evaluate(PAPER) == DARK
    page.page.emulate_media(color_scheme="light")
    assert page.page.evaluate(PAPER) == WHITE
    page.page.select_option("#theme", "dark")
    assert page.page.evaluate(PAPER) == DARK
    page.page.reload()
    assert page.page.evaluate(PAPER) == DARK and page.page.input_value("#theme") == "dark"
    page.page.select_option("#theme", "system")
    page.page.reload()
    assert page.page.evaluate(PAPER) == WHITE and page.unexpected() == []
    page.context.close()


@pytest.mark.parametrize(
    ("theme", "boats"),
    [
        ("light", 1),
        *(pytest.param(*each, marks=pytest.mark.long) for each in product(THEMES, (0, 1, 3)) if each != ("light", 1)),
    ],
)
def test_axe_finds_nothing_serious_and_all_text_is_seven_to_one(console, zenoh_port, browser, theme, boats):
    made = [TapedBoat(zenoh_port, f"boat-{k}") for k in range(boats)]
    try:
        page = Page(browser, console, color_scheme=theme, reduced_motion="reduce")
        page.wait(f"aritra.history.boats().length === {boats}")
        if boats:
            page.wait(f"aritra.history.last({CHOSEN}, 'checks') && aritra.map.boats.get({CHOSEN})?.made.has('hull')")
            page.page.click("#stop")
            page.wait("document.querySelector('#answers li')?.dataset.kind === 'done'")
            page.page.click("#hold")
        for stale in (False, True)[: 1 + bool(boats)]:
            for boat in made:
                boat.still = stale
            page.wait(f"document.body.classList.contains('stale') === {str(stale).lower()}")
            assert grave(page) == [] and grave(page, ["color-contrast-enhanced"]) == [], stale
        page.context.close()
    finally:
        for boat in made:
            boat.close()


@pytest.mark.long
def test_plots_and_map_take_the_colours_of_the_theme(console, zenoh_port, browser):
    boat = TapedBoat(zenoh_port, "one")
    try:
        page = Page(browser, console, color_scheme="light")
        page.wait("aritra.map.boats.get('one')?.made.has('hull') && aritra.history.list('one', 'state').length > 20")
        seen = {}
        for theme in THEMES:
            page.page.select_option("#theme", theme)
            page.page.wait_for_timeout(500)
            seen[theme] = page.page.evaluate(
                """() => { const c = document.querySelector('#plots canvas'), g = c.getContext('2d');
                const d = g.getImageData(0, 0, c.width, c.height).data; let light = 0, dark = 0;
                for (let i = 0; i < d.length; i += 4) if (d[i + 3] > 200) {
                  const sum = d[i] + d[i + 1] + d[i + 2]; light += sum > 690; dark += sum < 120; }
                const hull = aritra.map.boats.get('one').made.get('hull').getElement();
                return [light > 20, dark > 20, getComputedStyle(hull).stroke]; }"""
            )
        assert seen == {"light": [False, True, "rgb(11, 61, 145)"], "dark": [True, False, "rgb(147, 187, 255)"]}
        page.context.close()
    finally:
        boat.close()
