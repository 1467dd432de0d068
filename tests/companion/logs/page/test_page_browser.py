"""The page of a log in a real browser, from a file: time goes by, the boat and its ghosts move, nothing is loaded."""

import time
from pathlib import Path

import pytest

from companion.__main__ import main
from companion.boat.load_run import EXAMPLES
from tests.companion.logs.page.page_logs import page_log
from tests.support.console_fixture import PATIENCE_S, Page, chromium

BASE, EXTENDED = "simulated (base)", "simulated (extended)"


@pytest.fixture(scope="module")
def pages(tmp_path_factory) -> dict[str, Path]:
    """With two ghosts, and without any: 15 s of a boat that is pushed about (seed 3)."""
    folder = tmp_path_factory.mktemp("page")
    log = page_log(folder)
    vessel = str(EXAMPLES / "boats" / "aritra.toml")
    assert main(["log", "page", str(log), "--extended", vessel, "-o", str(folder / "ghosts.html")]) == 0
    assert main(["log", "page", str(log), "--no-ghosts", "-o", str(folder / "plain.html")]) == 0
    return {name: folder / f"{name}.html" for name in ("ghosts", "plain")}


@pytest.fixture(scope="module")
def browser():
    with chromium() as found:
        yield found


def opened(browser, path: Path, **size) -> tuple[Page, list[str]]:
    page, asked = Page(browser, "about:blank", **size), []
    page.page.on("request", lambda r: asked.append(r.url) if not r.url.startswith(("data:", "blob:")) else None)
    page.page.goto(path.as_uri())
    until(page, "document.body.dataset.ready")
    return page, asked


def until(page: Page, script: str) -> None:
    """Wait for it. The page's own policy forbids what the usual way would do."""
    end = time.monotonic() + PATIENCE_S
    while not page.page.evaluate(script):
        assert time.monotonic() < end, script
        page.page.wait_for_timeout(30)


def now_s(page: Page) -> float:
    return page.page.evaluate("page.t_s")


def shown(page: Page) -> list[str]:
    return page.page.evaluate("[...page.map.boats.keys()]")


def place(page: Page, boat: str) -> dict:
    """Where the boat's outline stands on the map [m]."""
    centre = "page.map.boats.get(b).made.get('hull').getBounds().getCenter()"
    return page.page.evaluate(f"b => (({{lat, lng}}) => ({{north: lat, east: lng}}))({centre})", boat)


@pytest.mark.long
def test_play_slider_keys_and_plots_move_the_time(pages, browser):
    page, asked = opened(browser, pages["ghosts"])
    page.page.click("#play")
    start = now_s(page)
    until(page, f"page.t_s > {start} + 0.5")
    page.page.click("#play")
    paused = now_s(page)
    page.page.wait_for_timeout(300)
    assert now_s(page) == paused
    page.page.evaluate("document.activeElement.blur()")
    for key, expected in (("Home", 0.0), ("ArrowRight", 1.0), ("Shift+ArrowRight", 11.0), ("ArrowLeft", 10.0)):
        page.page.keyboard.press(key)
        assert now_s(page) == pytest.approx(expected)
    page.page.keyboard.press("End")
    assert now_s(page) == pytest.approx(page.page.evaluate("page.length_s"))
    page.page.locator("#slider").fill("5")
    assert now_s(page) == pytest.approx(5.0)
    page.page.locator("#plots .u-over").first.click()
    assert now_s(page) == pytest.approx(page.page.evaluate("page.length_s") / 2, abs=0.5)
    page.page.keyboard.press("]")
    assert page.page.locator("#speed").input_value() == "2"
    page.page.evaluate("document.activeElement.blur()")
    page.page.keyboard.press("End")
    page.page.keyboard.press("Space")  # at the end: from the beginning
    until(page, "page.t_s > 0.5 && page.t_s < 8")
    assert not page.unexpected()
    assert asked == [pages["ghosts"].as_uri()]


@pytest.mark.long
def test_times_of_day_are_utc_as_in_its_head_wherever_it_is_read(pages, browser):
    page, _ = opened(browser, pages["plain"], timezone_id="Asia/Tokyo")
    page.page.evaluate("page.unix_minus_t_ns = 1_700_000_000_500_000_000 - page.zero_s * 1e9; page.seek(0)")
    assert page.text("#clock").endswith(", 22:13:20 UTC")


def test_the_boat_moves_and_ghosts_come_and_go(pages, browser):
    page, _ = opened(browser, pages["ghosts"])
    places = []
    for t_s in (6.0, 12.0):
        page.page.evaluate("t => page.seek(t)", t_s)
        places.append(place(page, "aritra"))
        assert shown(page) == ["aritra", BASE, EXTENDED]
        ghost = place(page, BASE)
        assert abs(ghost["north"] - places[-1]["north"]) + abs(ghost["east"] - places[-1]["east"]) < 1.5
    assert places[0] != places[1]
    assert page.page.locator(".boat-name").all_inner_texts() == ["aritra"]  # ghosts' names would cover the boat's
    page.page.keyboard.press("g")
    assert shown(page) == ["aritra"]
    page.page.get_by_label(EXTENDED).check()
    assert shown(page) == ["aritra", EXTENDED]
    legends = page.page.locator("#plots .legend").first.inner_text()
    assert "extended u" in legends
    assert "base" not in legends
    assert "smoothed measurements" in page.text("#error-box")
    assert not page.unexpected()


def test_without_ghosts_there_is_no_trace_of_them(pages, browser):
    page, _ = opened(browser, pages["plain"])
    page.page.evaluate("page.seek(8)")
    assert shown(page) == ["aritra"]
    assert not page.page.locator("#error-box").is_visible()
    assert not page.page.locator("#ghosts").is_visible()
    assert "Distance from simulation" not in page.text("#plots")
    assert page.text("#mode strong")
    assert page.page.locator("#plots canvas").count() == 8
    assert not page.unexpected()


@pytest.mark.long
def test_it_fits_a_phone_and_has_no_serious_barriers(pages, browser):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe is not installed: the extra `dev`")
    for size in ({"width": 390, "height": 844}, {"width": 1440, "height": 900}):
        page, _ = opened(browser, pages["ghosts"], **size)
        assert page.page.evaluate("document.documentElement.scrollWidth") <= size["width"]
        found = axe.Axe().run(page.page).response["violations"]
        assert [v["id"] for v in found if v["impact"] in ("serious", "critical")] == []
        assert not page.unexpected()
