"""Missions drawn on the console's map: drawn, changed, checked, sent, opened, saved; "Drive here"."""

import json

import pytest

from companion.core.guidance.missions.mission import parse
from tests.processes.console.layout import SIZES, THEMES, overlaps, place, reachable, resize
from tests.processes.console.test_console_theme import grave
from tests.project.house import ROOT
from tests.support.console_fixture import Page, TapedBoat

pytestmark = pytest.mark.real_time

READY = "!document.querySelector('#hold').disabled && aritra.map.boats.get('one')?.made.has('hull')"
ROWS = """[...document.querySelectorAll('#mission-list li')]
.map((r) => [...r.querySelectorAll('input')].map((i) => i.value))"""
"""What stands in the fields beside the map, row by row."""


@pytest.fixture
def page(console, boat, browser):
    made = Page(browser, console)
    made.wait(READY)
    made.posted = []
    made.page.on("request", lambda r: made.posted.append((r.url, r.post_data)) if r.method == "POST" else None)
    yield made
    assert made.unexpected() == []
    made.context.close()


def pixel(page, north_m, east_m):
    """Where a place of the site is on the screen [px]."""
    return page.page.evaluate(
        """([n, e]) => { const p = aritra.map.map.latLngToContainerPoint([n, e]);
        const box = document.querySelector('#map').getBoundingClientRect();
        return [box.left + p.x, box.top + p.y]; }""",
        [north_m, east_m],
    )


def click(page, north_m, east_m):
    page.page.mouse.click(*pixel(page, north_m, east_m))


def drag(page, start, end):
    page.page.mouse.move(*pixel(page, *start))
    page.page.mouse.down()
    page.page.mouse.move(*pixel(page, *end), steps=4)
    page.page.mouse.up()


def places(page):
    return [(float(north), float(east)) for north, east, *_ in page.page.evaluate(ROWS)]


def problems(page):
    return page.page.locator("#mission-problems li").all_inner_texts()


def near(places, *wanted, within_m=0.2):
    """Whether places are these, to a pixel or two."""
    return list(places) == [pytest.approx(w, abs=within_m) for w in wanted]


def test_a_mission_is_drawn_checked_and_sent_once_somebody_said_yes(page, boat):
    page.page.click("#draw")
    for at in ((5, 5), (25, 5), (25, 25)):
        click(page, *at)
    assert near(places(page), (5, 5), (25, 5), (25, 25)) and problems(page) == []
    page.wait("document.querySelector('#mission-sum').innerText.includes('about')")  # by the boat's own guidance
    course = page.page.evaluate("aritra.editor.layer.course.getLatLngs().map((p) => [p.lat, p.lng])")
    assert near([course[0], course[-1]], (5, 5), (25, 25)) and len(course) > 5, "with its corner rounded"
    drag(page, (25, 25), (25, 33))
    assert problems(page)[0].startswith("Waypoint 3 lies 3.") and "beyond the fence" in problems(page)[0]
    assert page.page.locator(".draft-point.wrong").all_inner_texts() == ["3"]
    assert page.page.locator("#mission-send").is_disabled()
    page.page.click("#mission-undo")
    assert near(places(page), (5, 5), (25, 5), (25, 25)) and page.page.locator(".draft-point.wrong").count() == 0
    page.page.fill("#mission-list li >> nth=1 >> [name=speed_m_s]", "0.3")
    page.page.keyboard.press("Tab")
    page.page.click("#mission-send")
    question = page.text("#question")
    assert "one takes “drawn.toml” (3 waypoints, 40" in question and boat.obeyed == []
    page.page.click("#question .yes")
    page.wait("document.querySelector('#answers li')?.dataset.kind === 'done'")
    assert boat.obeyed == ["load_mission"], "it is loaded, and starts nothing"
    (sent,) = [json.loads(data)["mission"] for url, data in page.posted if url.endswith("/order")]
    mission = parse(sent["text"], "toml")
    assert near(mission.path.points, (5, 5), (25, 5), (25, 25))
    assert [w.speed_m_s for w in mission.path.waypoints] == [None, 0.3, None]


def test_drive_here_asks_like_start_and_then_loads_one_point_and_starts(page, boat):
    page.wait("aritra.history.last('one', 'mode')?.mode === 'auto'")
    page.page.click("#drive-here")
    click(page, 5, 34)
    assert "beyond the fence" in page.text("#map-note") and page.page.locator("#question").is_hidden()
    click(page, 20, 10)
    asked = page.text("#question").replace("\u202f", " ")
    assert "goes to 20.0 m N, 10." in asked and "leaves the mission" in asked and boat.obeyed == []
    page.page.keyboard.press("Escape")
    assert page.page.locator(".target").count() == 0 and page.page.locator("#question").is_hidden()
    page.page.click("#drive-here")
    click(page, 20, 10)
    page.page.click("#question .yes")
    page.wait("document.querySelectorAll('#answers li[data-kind=done]').length === 3")
    assert boat.obeyed == ["hold", "load_mission", "start"], "the mission that it drives is left first"
    (told,) = [json.loads(data) for url, data in page.posted if url.endswith("/drive_there")]
    assert near(parse(told["mission"]["text"], "toml").path.points, (20, 10))
    assert page.page.evaluate("document.querySelector('#says').textContent").startswith("Start → one: done")


@pytest.mark.long
def test_waypoints_are_put_in_between_taken_out_and_brought_back_on_the_map(page):
    page.page.click("#draw")
    for at in ((5, 5), (25, 5)):
        click(page, *at)
    click(page, 15, 5)
    assert near(places(page), (5, 5), (15, 5), (25, 5)), "a click on a leg puts a waypoint into it"
    page.page.mouse.click(*pixel(page, 15, 5), button="right")
    assert near(places(page), (5, 5), (25, 5))
    for key, count in (("Control+z", 3), ("Control+z", 2), ("Control+y", 3), ("Control+Shift+z", 2), ("Control+z", 3)):
        page.page.locator("#map").focus()
        page.page.keyboard.press(key)
        assert len(places(page)) == count, key
    page.page.click("#mission-clear")
    assert places(page) == [] and problems(page) == ["No waypoint yet: click on the map, or add one."]
    page.page.click("#mission-undo")
    assert len(places(page)) == 3
    page.page.click("#mission-close")
    assert page.page.locator("#mission-box").is_hidden() and page.page.locator(".draft-point").count() == 0
    click(page, 10, 10)
    page.page.click("#draw")
    assert len(places(page)) == 3, "what was drawn is kept, and a click on the map was none meanwhile"


@pytest.mark.long
def test_a_mission_by_keyboard_alone(page, boat):
    press, fill = page.page.keyboard.press, page.page.keyboard.type
    page.page.focus("#draw")
    press("Enter")
    page.page.focus("#mission-add")
    press("Enter")
    for value in ("12", "8", "0.4", "0.5"):
        press("Control+a")
        fill(value)
        press("Tab")
    page.page.focus("#map")
    press("Enter")
    assert page.page.evaluate(ROWS)[0] == ["12", "8", "0.4", "0.5"] and len(places(page)) == 2
    assert page.page.evaluate(ROWS)[1][2:] == ["0.4", "0.5"], "as fast and as wide as the one before"
    page.page.focus("#mission-list li >> nth=1 >> .remove")
    press("Enter")
    assert page.page.evaluate("document.activeElement.title") == "Delete waypoint 1"
    page.page.focus("#mission-send")
    press("Enter")
    press("Enter")
    page.wait("document.querySelector('#answers li')?.dataset.kind === 'done'")
    assert boat.obeyed == ["load_mission"]


@pytest.mark.long
def test_what_is_wrong_names_the_waypoint(page):
    page.page.click("#draw")
    for at in ((5, 5), (25, 5), (25, 25)):
        click(page, *at)
    for row, name, value, says in (
        (0, "speed_m_s", "-1", "Waypoint 1 needs a speed above 0, or none."),
        (1, "acceptance_m", "0", "Waypoint 2 needs an acceptance radius above 0, or none."),
        (2, "north_m", "31", "Waypoint 3 lies 1.5 m beyond the fence."),
    ):
        field = f"#mission-list li >> nth={row} >> [name={name}]"
        page.page.fill(field, value)
        page.page.keyboard.press("Tab")
        assert [p.replace("\u202f", " ") for p in problems(page)] == [says]
        assert page.page.locator("#mission-send").is_disabled()
        page.page.click("#mission-undo")
    page.page.fill("#mission-list li >> nth=1 >> [name=north_m]", "")
    page.page.keyboard.press("Tab")
    assert near(places(page), (5, 5), (25, 5), (25, 25)), "a place that was emptied is as it was"


@pytest.mark.long
def test_files_are_opened_and_saved(page, tmp_path):
    page.page.click("#draw")
    for ending in ("toml", "plan", "geojson"):
        page.page.set_input_files("#mission-file", ROOT / f"deploy/missions/square.{ending}")
        page.wait("document.querySelectorAll('#mission-list li').length === 5")
        assert near(places(page), (9, 9), (21, 9), (21, 21), (9, 21), (9, 12), within_m=0.01)
        with page.page.expect_download() as saved:
            page.page.click("#mission-save")
        saved.value.save_as(tmp_path / saved.value.suggested_filename)
        mission = parse((tmp_path / "square.toml").read_text(), "toml")
        assert mission.name == "square" and [w.speed_m_s for w in mission.path.waypoints] == [0.5] * 5
        page.page.click("#mission-clear")
    (tmp_path / "bad.toml").write_text("[[waypoints]]\nnorth_m = 1.0\n")
    page.page.set_input_files("#mission-file", tmp_path / "bad.toml")
    page.wait("document.querySelector('#mission-problems').innerText.includes('waypoints[0].east_m: missing key')")
    page.page.click("#mission-boat")
    points = page.page.evaluate("aritra.history.last('one', 'path').waypoints.map((w) => [w.north_m, w.east_m])")
    assert places(page) == [pytest.approx(p) for p in points], "the boat's own, to be changed"


@pytest.mark.long
def test_each_boat_has_a_draft_of_its_own_and_another_boat_ends_drive_here(page, zenoh_port):
    other = TapedBoat(zenoh_port, "two")
    try:
        page.wait("document.querySelectorAll('.boat').length === 2")
        page.page.click("#draw")
        click(page, 5, 5)
        page.page.click(".boat >> nth=1")
        assert places(page) == [] and page.text("#mission-send") == "Send to two…"
        page.page.click(".boat >> nth=0")
        assert len(places(page)) == 1 and page.text("#mission-send") == "Send to one…"
        page.page.click("#drive-here")
        assert page.page.locator("#mission-box").is_hidden()
        page.page.click(".boat >> nth=1")
        click(page, 10, 10)
        assert page.page.locator("#question").is_hidden() and page.page.locator("#map-note").is_hidden()
    finally:
        other.close()


@pytest.mark.long
@pytest.mark.parametrize("theme", THEMES)
@pytest.mark.parametrize("width", [w if w == min(SIZES) else pytest.param(w, marks=pytest.mark.matrix) for w in SIZES])
def test_the_list_lies_on_nothing_can_be_read_and_stop_stays(console, boat, browser, width, theme):
    page = Page(browser, console, reduced_motion="reduce")
    page.wait(READY)
    resize(page, width, theme)
    before = place(page, "#stop")
    page.page.click("#draw")
    for _ in range(3):
        page.page.click("#mission-add")
    page.page.fill("#mission-list li >> nth=1 >> [name=north_m]", "99")
    page.page.keyboard.press("Tab")
    assert len(problems(page)) >= 1
    assert overlaps(page) == [] and page.page.evaluate("document.documentElement.scrollWidth") <= width
    assert grave(page) == [] and grave(page, ["color-contrast-enhanced"]) == []
    assert place(page, "#stop") == before and reachable(page, "#stop")
    page.page.click("#drive-here")
    assert grave(page) == [] and place(page, "#stop") == before and reachable(page, "#stop")
    page.context.close()
