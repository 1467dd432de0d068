"""Driving by hand from the page: a gamepad or two thumbs, never without the dead man, and whose the sticks are."""

import pytest
from axe_playwright_python.sync_playwright import Axe

from drivers.sticks.gamepad import DEAD_ZONE, EXPO
from drivers.sticks.mapping import shaped
from tests.evidence.friendly.driving import PAD
from tests.processes.console.layout import SIZES, THEMES, overlaps, place, reachable, resize
from tests.support.console_fixture import Page

pytestmark = pytest.mark.real_time

READY = "!document.querySelector('#hold').disabled && aritra.map.boats.get('one')?.made.has('hull')"
REST, AHEAD = "pad.moved++; pad.axes = [0, 0, 0, 0]", "pad.moved++; pad.axes = [0, -1, 0, 0]"
PLACES = (-1.0, -0.5, -0.12, 0.0, 0.12, 0.3, 0.5, 1.0)
SAID = "document.querySelector('#steer-says').innerText.includes('{}')"


@pytest.fixture
def page(console, boat, browser):
    made = opened(browser, console)
    yield made
    assert made.unexpected() == []
    made.context.close()


def opened(browser, console):
    made = Page(browser, console)
    made.page.add_init_script(PAD)
    made.page.reload()
    made.wait(READY)
    made.page.click("#steer")
    return made


def take(page):
    page.page.click("#steer-take")
    page.page.click("#question .yes")
    page.wait("aritra.steering.boat === 'one'")


def until(page, condition):
    page.wait("true")
    for _ in range(200):
        if condition():
            return
        page.page.wait_for_timeout(50)
    raise AssertionError("not in time")


def strongest(boat, since=0):
    return max((m.surge for m in boat.moved[since:]), default=None)


def test_a_gamepad_drives_only_what_was_given_to_it_and_only_while_its_dead_man_is_held(page, boat):
    page.page.evaluate(f"pad.held = true; {AHEAD}")
    page.page.wait_for_timeout(400)
    assert boat.moved == [] and boat.obeyed == [], "nothing was asked yet"
    page.page.evaluate("pad.held = false")
    take(page)
    assert boat.obeyed == ["manual"]
    until(page, lambda: len(boat.moved) > 5)
    assert strongest(boat) == 0, "a stick ahead, and nobody holds"
    page.page.evaluate("pad.held = true")
    page.wait("document.querySelector('#steer-box').dataset.kind === 'held'")
    page.page.wait_for_timeout(300)
    assert strongest(boat) == 0, "pressed while the stick was off its middle"
    page.page.evaluate(REST)
    page.wait("!aritra.steering.grip.waits")
    page.page.evaluate(AHEAD)
    until(page, lambda: strongest(boat) == 1)
    for ends in ("pad.held = false", "pad.there = false", "globalThis.dispatchEvent(new Event('blur'))"):
        page.page.evaluate(f"pad.there = true; pad.held = false; {REST}")
        page.wait("aritra.steering.grip.waits")
        page.page.evaluate("pad.held = true")
        page.wait("!aritra.steering.grip.waits")
        page.page.evaluate(AHEAD)
        until(page, lambda: boat.moved[-1].surge == 1)
        page.page.evaluate(ends)
        until(page, lambda: boat.moved[-1].surge == 0)
    page.page.click("#steer-take")
    until(page, lambda: boat.obeyed == ["manual", "stop"])
    assert page.page.evaluate("aritra.steering.boat") is None


def test_another_page_takes_the_sticks_away_and_an_order_does(page, boat, console, browser):
    take(page)
    other = opened(browser, console)
    take(other)
    page.wait(SAID.format("Another page has taken the sticks"))
    page.wait("aritra.steering.boat === null")
    page.page.keyboard.press("F9")
    other.wait("aritra.steering.boat === null")
    other.wait("document.querySelector('#steer-says').textContent.startsWith('stop was given')")
    assert other.unexpected() == []
    other.context.close()


def test_by_keyboard_and_by_thumbs_it_needs_the_dead_man_too(page, boat):
    page.page.evaluate("pad.there = false")
    take(page)
    page.page.focus("#steer-stick")
    page.page.keyboard.down("ArrowUp")
    page.page.wait_for_timeout(300)
    assert strongest(boat) == 0
    page.page.keyboard.up("ArrowUp")
    page.page.keyboard.down("Shift")
    page.wait("!aritra.steering.grip.waits")
    page.page.keyboard.down("ArrowUp")
    until(page, lambda: boat.moved[-1].surge > 0.25)
    page.page.keyboard.up("Shift")
    until(page, lambda: boat.moved[-1].surge == 0)
    page.page.keyboard.up("ArrowUp")
    for kind, thing in (("pointerdown", "#steer-grip"), ("pointerup", "#steer-grip")):
        page.page.evaluate("HTMLElement.prototype.setPointerCapture = () => {}")
        page.page.dispatch_event(thing, kind, {"pointerId": 7, "bubbles": True})
        page.wait(f"aritra.steering.touch.read().held === {str(kind == 'pointerdown').lower()}")


@pytest.mark.long
def test_a_pad_that_stands_still_off_its_middle_and_one_of_unknown_layout_are_not_held(page):
    told = page.page.evaluate(
        """async () => { const { Pad, shaped } = await import('/web/driving/shares.js');
        const made = (axes, moved, mapping = 'standard') => [null, { connected: true, index: 1, id: 'x', mapping,
          timestamp: moved, axes, buttons: Array.from({ length: 17 }, (_, k) => ({ pressed: k === 4 })) }];
        const pad = new Pad();
        const held = [[0, 1, 0], [9000, 1, 0], [11000, 1, 0], [11100, 2, 0]].map(([now, moved]) =>
          pad.read(made([0, -1, 0, 0], moved), now).held);
        const resting = new Pad();
        resting.read(made([0, 0, 0, 0], 1), 0);
        return { held, rest: resting.read(made([0, 0, 0, 0], 1), 60000).held,
          strange: new Pad().read(made([0, 0, 0, 0], 1, ''), 0),
          shares: PLACES.map(shaped) }; }""".replace("PLACES", f"[{', '.join(map(str, PLACES))}]")
    )
    assert told["held"] == [True, True, False, True] and told["rest"] is True
    assert not told["strange"]["held"] and "layout" in told["strange"]["problem"]
    assert told["shares"] == pytest.approx([shaped(v, dead_zone=DEAD_ZONE, expo=EXPO) for v in PLACES])


@pytest.mark.long
@pytest.mark.parametrize("theme", THEMES)
def test_nothing_lies_on_anything_while_it_is_driven_by_hand(page, theme):
    take(page)
    for width in SIZES:
        resize(page, width, theme)
        before = place(page, "#stop")
        if width <= 960:  # a wider page scrolls beneath its top line
            page.page.evaluate("document.querySelector('#steer-box').scrollIntoView()")
        page.page.wait_for_timeout(200)
        assert overlaps(page) == [] and place(page, "#stop") == before and reachable(page, "#stop")
        found = Axe().run(page.page).response["violations"]
        assert [v["id"] for v in found if v["impact"] in ("serious", "critical")] == []
