"""The console's page where the network, the console or the autopilot is lost: what it says, and gives again."""

import pytest

from tests.support.console_fixture import Page

pytestmark = pytest.mark.real_time

BY_HAND = """() => { const line = aritra.connection, real = line.socket;
line.socket = null; real.close(); clearInterval(line.watch); [line.open, line.clocks] = [true, []];
globalThis.frame = (now_ms, clocks, samples = []) => line.hear({ type: 'samples', now_ms, clocks, samples });
globalThis.state = (boat, t_ms, more = {}) => ({ boat, topic: 'state', sample: { run: 'r', t_ns: t_ms * 1e6,
  north_m: 1, east_m: 2, psi_rad: 0, u_m_s: 0, v_m_s: 0, r_rad_s: 0, covariance: Array(21).fill(0.01),
  health: 'healthy', ...more } });
globalThis.about = (boat, t_ms) => ({ boat, topic: 'about', sample: { run: 'r', t_ns: t_ms * 1e6,
  within: [], without: [], thrusters: [], anchors: [{ id: '7', north_m: 3, east_m: 3 }],
  lat_deg: 0, lon_deg: 0, rotation_deg: 0, unix_minus_t_ns: 0, commands: true } });
globalThis.order = (number, boat, command, state, status) => line.hear({ type: 'order', number, boat, command, state,
  asked_ms: line.console_ms(), tries: 1, why: '', after_ms: 9,
  outcome: status ? { run: 'r', t_ns: 1, status, text: `${command}: heard` } : null });
globalThis.anew = () => { line.clocks = []; // as with every new line
  line.hear({ type: 'console', started: 'anew', commands: true, problem: '', where: '', logs: false }); }; }"""
"""From here on the page hears what a test says: frames, samples, orders, and that the console was started anew."""
LINES = "[...document.querySelectorAll('#answers li')].map((line) => [line.dataset.state, line.innerText])"


def by_hand(browser, console):
    page = Page(browser, console)
    page.wait("document.querySelector('#hears').textContent")
    page.page.evaluate(BY_HAND)
    return page


def test_a_stop_that_the_network_swallows_is_given_again(console, boat, browser):
    """A phone out of range: no refusal comes back, no answer either."""
    page = Page(browser, console)
    page.wait("!document.querySelector('#hold').disabled")
    swallowed = []
    page.page.route("**/stop", lambda route: swallowed.append(route.request))
    page.page.keyboard.press("F9")
    page.wait("document.querySelector('#answers li')?.innerText.includes('no answer yet (try 2)')")
    assert "Trying again" in page.text("#answers li") and len(swallowed) >= 2 and not boat.obeyed
    page.page.unroute("**/stop")
    page.wait("document.querySelector('#answers li')?.dataset.kind === 'done'")
    assert set(boat.obeyed) == {"stop"}
    assert page.unexpected() == []
    page.context.close()


@pytest.mark.long
def test_another_order_that_the_network_swallows_says_that_no_answer_came(console, boat, browser):
    page = Page(browser, console)
    page.wait("!document.querySelector('#hold').disabled")
    bodies = []
    page.page.route("**/order", lambda route: bodies.append(route.request.post_data_json))
    page.page.click("#hold")
    page.page.click("#question .yes")
    page.wait("document.querySelector('#answers li')?.dataset.state === 'no_answer'")
    assert "NO ANSWER" in page.text("#answers li") and not boat.obeyed
    ago_ms = page.page.evaluate("(given_ms) => aritra.connection.console_ms() - given_ms", bodies[0]["given_ms"])
    assert 9e3 < ago_ms < 60e3, "the console can tell how old it is"
    page.context.close()


@pytest.mark.long
def test_what_a_stop_came_to_is_said_only_of_what_is_known(console, browser):
    """Rows: pulses sent, whether they were, what the autopilot says that it gives."""
    still, moving = [1500] * 4, [1700, 1500, 1500, 1500]
    said = Page(browser, console).page.evaluate(
        """async (rows) => { const { OrderDesk } = await import('/web/orders.js');
        return rows.map(([pwm_us, sent, output_us]) => OrderDesk.prototype.neutral.call(
          { boats: () => ({ chosen: 'one', view: { thrusters: { run: 'r', t_ns: 2, pwm_us, sent, output_us } } }) },
          { boat: 'one', command: 'stop', state: 'answered', outcome: { run: 'r', t_ns: 1, status: 'done' } })); }""",
        [[still, True, still], [still, None, still], [still, True, moving], [still, True, None], [still, False, None],
         [moving, True, still]],
    )  # fmt: skip
    assert said[0] == said[1] == ["Neutral is sent, and the autopilot's outputs are neutral.", False]
    looks_failed = {"NOT neutral": True, "does not say": False, "NOT sent": True, "other pulses": False}
    for (words, failed), (expected, red) in zip(said[2:], looks_failed.items(), strict=True):
        assert expected in words and failed == red


def test_frames_that_come_late_make_the_boats_word_look_old(console, browser):
    """Ages are judged by the least delayed frames: those that were queued for 3 s must not look fresh."""
    age_s = Page(browser, console).page.evaluate(
        """async () => { const { Connection } = await import('/web/connection.js');
        const line = new Connection({}), at = performance.now();
        line.socket.close(); clearInterval(line.watch); line.socket = null;
        for (const late_ms of [10, 3000, 3000]) line.hear({ type: 'samples', now_ms: at + 5e6 - late_ms });
        return (line.console_ms() - (performance.now() + 5e6)) / 1000; }"""
    )
    assert age_s == pytest.approx(0.0, abs=0.2)


def test_a_boat_that_is_not_there_after_the_console_was_started_anew_is_lost(console, browser):
    """The new console's clock begins anew, too: its computer was started. It hears bob's token, and later its word."""
    page = by_hand(browser, console)
    page.page.evaluate(
        """() => { frame(5e6, { anna: [7e6, true, 1, ''], bob: [7e6, true, 1, ''] },
          [state('anna', 12e6 - 6e4), state('bob', 12e6 - 6e4)]);
        aritra.choose('anna'); anew(); frame(1e3, { bob: [null, true, 0, ''] }); }"""
    )
    page.wait("document.querySelector('#stop-all').textContent === 'STOP ALL 1'")  # bob's: looked at after the frame
    assert "its program cannot be reached" in page.text("#link-text")
    assert page.page.evaluate("['anna', 'bob'].map(aritra.age_s)") == pytest.approx([60.0, 60.0], abs=10.0)
    assert "cannot be reached" in page.text("#no-orders")
    assert page.page.locator(".away:visible").count() == 1
    page.page.evaluate("frame(2e3, { bob: [3e6, true, 1, ''] }, [state('bob', 3e6 + 2e3, { run: 'next' })])")
    assert page.page.evaluate("aritra.age_s('bob')") < 10.0 and page.page.evaluate("aritra.age_s('anna')") > 59.0
    assert page.unexpected() == []
    page.context.close()


@pytest.mark.long
def test_a_start_whose_answer_is_lost_may_have_come_there_and_the_consoles_word_takes_its_place(console, browser):
    page, routes = by_hand(browser, console), []
    page.page.evaluate("anew(); frame(5e6, { anna: [0, true, 1, ''] }, [about('anna', 5e6), state('anna', 5e6)])")
    page.page.route("**/order", lambda route: routes.insert(0, route))
    for number, word_first in ((1, True), (2, False)):
        page.wait("!document.querySelector('#start').disabled")
        page.page.click("#start")
        page.page.click("#question .yes")
        while len(routes) < number:
            page.page.wait_for_timeout(50)
        if word_first:
            page.page.evaluate("order(1, 'anna', 'start', 'answered', 'done')")
        routes[0].abort("connectionreset")
        if not word_first:
            page.wait("document.querySelector('#answers li').dataset.state === 'no_answer'")
            assert "NO ANSWER" in page.text("#answers li >> nth=0") and "may have come there" in page.text("#says")
            page.page.evaluate("order(2, 'anna', 'start', 'answered', 'done')")
        page.page.wait_for_timeout(300)
        lines = page.page.evaluate(LINES)
        assert [state for state, _ in lines] == ["answered"] * number, lines
        assert "start: heard" in page.text("#says")
    assert page.unexpected("ERR_CONNECTION_RESET") == []
    page.context.close()


@pytest.mark.parametrize("had", ["[steer.boat, steer.order] = ['anna', 3]", "steer.order = false"])
def test_sticks_must_be_taken_again_from_a_console_that_was_started_anew(console, browser, had):
    """They were this page's, or asked for."""
    page = by_hand(browser, console)
    page.page.evaluate(
        """() => { frame(5e6, { anna: [0, true, 1, ''] }, [about('anna', 5e6), state('anna', 5e6)]);
        globalThis.steer = aritra.steering; steer.setOpen(true); order(4, 'anna', 'start', 'sending'); }"""
    )
    page.page.evaluate(f"{had}; anew(); frame(5e6, {{ anna: [0, true, 1, ''] }})")
    page.wait("document.querySelector('#steer-says').textContent.includes('started anew: take the sticks again')")
    assert page.page.evaluate("[steer.boat, steer.order]") == [None, None]
    page.wait("!document.querySelector('#steer-take').disabled")
    ((told, text),) = page.page.evaluate(LINES)
    assert told == "no_answer" and "started anew meanwhile" in text
    assert page.unexpected() == []
    page.context.close()


@pytest.mark.long
def test_sticks_that_were_refused_and_sticks_without_an_answer_are_told_apart(console, browser):
    said = Page(browser, console).page.evaluate(
        """async () => { const { Steering } = await import('/web/driving/steer.js');
        return ['answered', 'no_answer'].map((state) => { const page = { order: false, wanted: 'anna', waits: 7 };
          Steering.prototype.note.call(page, { boat: 'anna', number: 7, state, outcome: { status: 'refused' } });
          return page.lost; }); }"""
    )
    assert "did not give" in said[0] and "No answer" in said[1]


def test_a_sensor_that_fell_silent_under_a_live_boat_is_not_shown_as_of_now(console, browser):
    page = by_hand(browser, console)
    page.page.evaluate(
        """() => { const told = { attitude: { roll_rad: 0.1, pitch_rad: 0.05, heading_rad: 1 },
          ranges: { ranges: [{ anchor: '7', residual_m: 0.2, accepted: true }] } };
        frame(5e6, { anna: [0, true, 1, ''] }, [about('anna', 5e6), state('anna', 5e6), ...Object.entries(told).map(
          ([topic, more]) => ({ boat: 'anna', topic, sample: { run: 'r', t_ns: 5e12, ...more } }))]); }"""
    )
    page.wait("document.querySelector('#map .anchor span')?.textContent === '+0.20 m'")
    assert "Roll 5.7°" in page.text("#attitude") and "autopilot 057°" in page.text("#attitude")
    assert page.page.get_attribute(".horizon .water", "visibility") != "hidden"
    page.page.evaluate("frame(5e6 + 3100, {}, [state('anna', 5e6 + 3100)])")
    page.wait("document.querySelector('#map .anchor.silent span')?.textContent === 'no range'")
    assert "Roll –°" in page.text("#attitude") and "autopilot –" in page.text("#attitude")
    assert page.page.get_attribute(".horizon .water", "visibility") == "hidden"
    assert page.unexpected() == []
    page.context.close()


def test_of_a_stop_to_nine_boats_every_answer_is_shown_and_a_failure_stays_longest(console, browser):
    page = by_hand(browser, console)
    page.page.evaluate(
        """() => { const boats = Array.from({ length: 9 }, (_, k) => `b${k}`), clock = [0, true, 1, ''];
        const clocks = Object.fromEntries(boats.map((boat) => [boat, clock]));
        anew(); frame(5e6, clocks, boats.map((boat) => state(boat, 5e6)));
        boats.forEach((boat, k) => order(k + 1, boat, 'stop', 'sending'));
        boats.forEach((boat, k) => order(k + 1, boat, 'stop', ...(k < 2 ? ['no_answer'] : ['answered', 'done']))); }"""
    )
    lines = page.page.evaluate(LINES)
    assert sorted(text.split(":")[0] for _, text in lines) == [f"STOP → b{k}" for k in range(9)]
    page.page.evaluate("for (let k = 10; k < 30; k++) order(k, 'b8', 'hold', 'answered', 'done')")
    lines = page.page.evaluate(LINES)
    assert len(lines) == 9 and [state for state, _ in lines].count("no_answer") == 2
    assert lines[0][1].startswith("Hold → b8"), "the newest"
    assert page.unexpected() == []
    page.context.close()
