"""What the console's page may show of a boat: nothing that is not known, nothing in the axes of another site; and that
no key that is still down answers a question.
"""

import pytest

from tests.processes.console.test_console_lost import by_hand
from tests.support.console_fixture import Page

pytestmark = pytest.mark.real_time

TELL = """() => { globalThis.tell = (boat, t_ms, more = {}, site = {}) => { const told = about(boat, t_ms);
  Object.assign(told.sample, site); frame(t_ms, { [boat]: [0, true, 1, ''] }, [told, state(boat, t_ms, more)]); };
globalThis.told = (boat, topic, t_ms, more) => frame(t_ms, {}, [
  { boat, topic, sample: { run: 'r', t_ns: t_ms * 1e6, ...more } }, state(boat, t_ms)]); }"""
HEADING = "#figures [data-key=Heading] dd"


def test_a_heading_is_from_true_north_and_is_shown_once_it_is_known(console, browser):
    page = by_hand(browser, console)
    page.page.evaluate(TELL)
    page.page.evaluate("tell('anna', 5e6, { health: 'initialising' })")
    page.wait("document.querySelector('#figures [data-key=Estimate] dd')?.innerText.startsWith('initialising')")
    assert page.text(HEADING) == page.text("#figures [data-key=Speed] dd") == "–"
    assert page.page.get_attribute(".compass .needle", "visibility") == "hidden"
    page.page.evaluate("tell('anna', 5e6 + 100, {}, { lat_deg: 59, lon_deg: 10, rotation_deg: 90 })")
    page.wait(f"document.querySelector('{HEADING}').innerText === '090°'")
    assert "Heading 090° true" in page.text("#attitude")
    assert page.page.get_attribute(".north-arrow", "aria-label") == "Up is 090° true"
    assert page.page.evaluate("document.querySelector('.north-arrow').style.rotate") == "-90deg"
    assert page.unexpected() == []
    page.context.close()


def test_of_a_mission_that_was_just_loaded_no_waypoint_is_passed(console, browser):
    page = by_hand(browser, console)
    page.page.evaluate(TELL)
    page.page.evaluate(
        """() => { const path = (n) => ({ name: 'm', end_heading_rad: null, origin: 'shore',
          waypoints: Array.from({ length: n }, (_, k) => ({ north_m: k, east_m: 0 })) });
        globalThis.path = path; tell('anna', 5e6); told('anna', 'path', 5e6 + 100, path(3));
        told('anna', 'mode', 5e6 + 200, { mode: 'idle', why: '', armed: true });
        told('anna', 'reference', 5e6 + 300, { waypoints_passed: 2, y_e_m: 0, north_ref_m: 1, east_ref_m: 0 }); }"""
    )
    waypoints = "document.querySelector('#figures [data-key=Waypoints] dd')?.innerText"
    page.wait(f"{waypoints} === '2 of 3' && document.querySelector('#start').innerText === 'Resume…'")
    page.page.evaluate("told('anna', 'path', 5e6 + 400, path(5))")
    page.wait(f"{waypoints} === '0 of 5' && document.querySelector('#start').innerText === 'Start…'")
    assert page.page.locator("#map .waypoint").count() == 5
    assert page.page.locator("#map .waypoint.passed").count() == 0
    assert page.unexpected() == []
    page.context.close()


def test_a_boat_of_another_site_is_drawn_where_it_is_in_the_axes_of_the_map_or_not_at_all(console, browser):
    page = by_hand(browser, console)
    page.page.evaluate(TELL)
    page.page.evaluate(
        """() => { const here = { site: 'lake', lat_deg: 59, lon_deg: 10, rotation_deg: 0 };
        tell('anna', 5e6, {}, here); aritra.choose('anna'); tell('bob', 5e6, {}, here);
        tell('carl', 5e6, {}, { ...here, site: 'bay', lat_deg: 59.001, rotation_deg: 90 });
        tell('dora', 5e6, {}, { site: 'basin', lat_deg: 0, lon_deg: 0, rotation_deg: 0 }); }"""
    )
    page.wait("aritra.map.boats.get('carl')?.made.has('bow')")
    bow = "aritra.map.boats.get('%s').made.get('bow')?.getLatLngs()[0]"
    places = {name: page.page.evaluate(bow % name) for name in ("anna", "bob", "carl", "dora")}
    assert [places[name] for name in ("anna", "bob")] == [{"lat": 1, "lng": 2}] * 2 and places["dora"] is None
    # 0.001 degrees of latitude are 111.4 m there; its axes are north to east, east to south
    assert (places["carl"]["lat"], places["carl"]["lng"]) == pytest.approx((111.4 - 2.0, 1.0), abs=0.1)
    page.page.evaluate("aritra.choose('dora')")
    page.wait("!aritra.map.boats.get('anna').made.has('bow') && aritra.map.boats.get('dora').made.has('bow')")
    assert page.unexpected() == []
    page.context.close()


def test_a_key_that_is_held_down_answers_no_question(console, browser):
    """Enter on Start asks, with the focus on Yes; its own repetition a half second later said yes. F9 is one STOP."""
    page, sent = by_hand(browser, console), []
    page.page.evaluate(TELL)
    page.page.evaluate("tell('anna', 5e6)")
    page.page.route("**/order", lambda route: sent.append(route.request) or route.abort())
    page.wait("!document.querySelector('#start').disabled")
    page.page.focus("#start")
    for _ in range(3):
        page.page.keyboard.down("Enter")
    page.page.keyboard.up("Enter")
    page.page.wait_for_timeout(200)
    assert sent == [] and page.page.is_visible("#question")
    page.page.keyboard.press("Enter")
    page.wait("document.querySelector('#answers li')")
    assert len(sent) == 1
    stops = []
    page.page.route("**/stop", lambda route: stops.append(route.request) or route.fulfill(json=[]))
    for _ in range(3):
        page.page.keyboard.down("F9")
    page.page.keyboard.up("F9")
    page.page.wait_for_timeout(200)
    assert len(stops) == 1
    page.context.close()


@pytest.mark.long
def test_an_error_sounds_right_after_a_warning_and_what_suspended_the_sound_is_over(console, browser):
    tones = Page(browser, console).page.evaluate(
        """async () => { const { Alarms } = await import('/web/alarms.js'), tones = [];
        const alarms = new Alarms(document.createElement('button'));
        alarms.context = { currentTime: 0, resume: () => tones.push('resumed') };
        alarms.tone = (pitch) => tones.push(pitch);
        for (const level of ['warning', 'error', 'warning', 'error']) alarms.alert('anna', { level, text: level }, 0);
        return tones; }"""
    )
    assert tones == ["resumed", 660, "resumed", 880, 660, 880, 660]


def test_a_battery_that_is_not_told_is_a_gap_and_plotted_headings_are_from_true_north(console, browser):
    told = Page(browser, console).page.evaluate(
        """async () => { const { PANELS, FURTHER } = await import('/web/plots.js');
        const lines = (id, about) => [...PANELS, ...FURTHER].find((panel) => panel.id === id).lines(about);
        return [1, 60].map((age_s) => lines('voltage')[0].value({ voltage_v: 15, age_s })).concat(
          lines('psi', { rotation_deg: 30 }).map(({ value }) => value({ psi_rad: 0, psi_ref_rad: 0 }))); }"""
    )
    assert told == [15, None, 30, 30]
