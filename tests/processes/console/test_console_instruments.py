"""What the console's page shows beside the map: attitude, compass, latitude, longitude; and its alarms."""

import math

import pytest

from companion.core.geometry.frames import Origin, site_from_geodetic
from companion.core.messages import Alert
from tests.support.console_fixture import Page

pytestmark = pytest.mark.real_time

EARS = """
globalThis.tones = []; globalThis.notes = [];
const start = OscillatorNode.prototype.start;
OscillatorNode.prototype.start = function (...when) {
  tones.push(this.frequency.value); return start.apply(this, when); };
globalThis.Notification = class { constructor(title, { body }) { notes.push(body); }
  static permission = "granted"; static requestPermission() {} };
"""
"""What the page sounds, and what it notifies of: heard where it leaves the page."""


def test_attitude_compass_and_where_on_earth_it_is(console, boat, browser):
    page = Page(browser, console)
    page.wait("aritra.history.last('one', 'attitude') && aritra.map.boats.get('one')?.made.has('hull')")
    page.page.wait_for_timeout(300)
    told = page.page.evaluate(
        """() => { const h = aritra.history, s = h.last('one', 'state'), a = h.last('one', 'attitude');
        const turn = document.querySelector('.compass .needle').getAttribute('transform').match(/-?[\\d.]+/)[0];
        const text = (k) => document.querySelector(`#figures [data-key=${k}] dd`).innerText.match(/[\\d.]+/)[0];
        const [lat, lon] = [text('Latitude'), text('Longitude')].map(Number);
        return { s, a, about: h.last('one', 'about'), turn: Number(turn), lat, lon }; }"""
    )
    about, state = told["about"], told["s"]
    origin = Origin(about["lat_deg"], about["lon_deg"], math.radians(about["rotation_deg"]))
    north_m, east_m = site_from_geodetic(origin, told["lat"], told["lon"])
    assert math.hypot(north_m - state["north_m"], east_m - state["east_m"]) < 0.5, "it moves on meanwhile"
    assert abs(math.remainder(told["turn"] - math.degrees(state["psi_rad"]), 360.0)) < 15.0
    assert abs(told["a"]["roll_rad"]) < 0.5 and told["a"]["heading_rad"] is not None
    assert "Roll" in page.text("#attitude") and "true" in page.text("#attitude")
    assert page.page.get_attribute(".horizon", "aria-label").startswith("Roll ")
    page.context.close()


def test_latitude_and_longitude_are_those_of_the_boats_program(console, browser):
    page = Page(browser, console)
    for rotation_deg in (0.0, 35.0, -120.0):
        geodetic_of(page, rotation_deg)
    page.context.close()


def geodetic_of(page, rotation_deg):
    about = {"lat_deg": 59.6581, "lon_deg": 10.6248, "rotation_deg": rotation_deg}
    lat, lon = page.page.evaluate(
        "async (about) => (await import('/web/shapes.js')).geodetic(about, [120.0, -45.0])", about
    )
    origin = Origin(about["lat_deg"], about["lon_deg"], math.radians(rotation_deg))
    assert site_from_geodetic(origin, lat, lon) == pytest.approx((120.0, -45.0), abs=1e-3)
    unknown = about | {"lat_deg": 0, "lon_deg": 0}
    assert (
        page.page.evaluate("async (about) => (await import('/web/shapes.js')).geodetic(about, [0, 0])", unknown) is None
    )


@pytest.mark.long
def test_alarms_sound_and_notify_once_they_are_switched_on(console, boat, browser):
    page = Page(browser, console)
    page.page.add_init_script(EARS)
    page.page.reload()
    page.wait("document.querySelector('#link').dataset.kind === 'live'")
    say = lambda level, text: boat.telemetry.see(Alert(t_ns=boat.now_ns(), level=level, text=text))  # noqa: E731
    say("error", "before it was asked for")
    page.wait("aritra.history.list('one', 'alert').some((a) => a.text.startsWith('before'))")
    assert page.page.evaluate("[tones, notes]") == [[], []], "silent without a gesture"
    page.page.click("#alarms")
    assert page.text("#alarms") == "Alarms on" and page.page.evaluate("tones") == [660], "what it will be like"
    page.page.wait_for_timeout(1600)
    say("info", "a note")
    say("error", "the fence is near")
    page.wait("notes.length === 1 && tones.length === 5")
    assert page.page.evaluate("notes") == ["one: the fence is near"]
    page.page.wait_for_timeout(1600)
    boat.still = True
    page.wait("notes.length === 2 && tones.length === 9")
    assert page.page.evaluate("notes[1]") == "No word from one."
    page.page.wait_for_timeout(2000)
    assert page.page.evaluate("[tones.length, notes.length]") == [9, 2], "told once while it lasts"
    page.page.click("#alarms")
    boat.still = False
    page.wait("document.querySelector('#link').dataset.kind === 'live'")
    say("error", "after it was switched off")
    page.wait("aritra.history.list('one', 'alert').some((a) => a.text.startsWith('after'))")
    assert page.page.evaluate("[tones.length, notes.length]") == [9, 2] and page.unexpected() == []
    page.context.close()
