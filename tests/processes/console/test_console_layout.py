"""The console's page at three sizes of screen, light and dark, with no, one and three boats: no box lies on another."""

import contextlib

import pytest

from tests.processes.console.layout import SIZES, THEMES, overlaps, resize, scroll
from tests.support.console_fixture import CHOSEN, Page, TapedBoat

pytestmark = pytest.mark.real_time

FLEETS = {0: (), 1: ("taped",), 3: ("boat-1", "boat-2", "boat-3")}


@contextlib.contextmanager
def boats(port, *names, **more):
    made = [TapedBoat(port, name, **more) for name in names]
    try:
        yield made
    finally:
        for boat in made:
            boat.close()


@pytest.mark.parametrize("fleet", [pytest.param(0, marks=pytest.mark.long), 1, pytest.param(3, marks=pytest.mark.long)])
def test_no_box_lies_on_another(console, zenoh_port, browser, fleet):
    with boats(zenoh_port, *FLEETS[fleet]):
        page = Page(browser, console)
        page.wait(f"aritra.history.boats().length === {fleet}")
        if fleet:
            page.wait(f"aritra.history.last({CHOSEN}, 'checks') !== undefined")
            page.page.click("#stop")
            page.wait("document.querySelector('#answers li')?.dataset.kind === 'done'")
        found = {}
        for width in SIZES:
            for theme in THEMES:
                resize(page, width, theme)
                for share in (0.0,) if width > 960 else (0.0, 1.0):
                    scroll(page, share)
                    found[width, theme, share] = overlaps(page)
                    assert page.page.evaluate("document.documentElement.scrollWidth") <= width
        assert {key: pairs for key, pairs in found.items() if pairs} == {}
        assert page.unexpected() == []
        page.context.close()
