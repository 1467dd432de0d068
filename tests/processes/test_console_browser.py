"""The console in a real browser (Debian's Chromium, headless), with boats that play a taped voyage: what a person sees,
does and needs. The whole chain with simulator and companion is in test_console_demo.py.
"""

import contextlib
import signal
import time

import pytest
from axe_playwright_python.sync_playwright import Axe

from tests.support.console_fixture import KEY, Page, TapedBoat, chromium, served
from tests.support.zenoh_fixture import free_port

pytestmark = pytest.mark.real_time

LIVE = "document.querySelector('#link').dataset.kind === 'live'"
WENT_AWAY = ("ERR_CONNECTION_REFUSED", "WebSocket connection")
SERIOUS = ("serious", "critical")


@pytest.fixture(scope="module")
def browser():
    with chromium() as made:
        yield made


@pytest.fixture
def zenoh_port():
    return free_port()


@pytest.fixture
def console(tmp_path, zenoh_port):
    """`aritra shore` with a key; its address."""
    (tmp_path / "boat.key").write_bytes(KEY)
    (tmp_path / "boat.key").chmod(0o600)
    listen = f"tcp/127.0.0.1:{zenoh_port}"
    with served(tmp_path / "shore.txt", "--listen", listen, "--command-key", tmp_path / "boat.key") as (address, _):
        yield address


@contextlib.contextmanager
def boats(port, *names, **more):
    made = [TapedBoat(port, name, **more) for name in names or ("taped",)]
    try:
        yield made if names else made[0]
    finally:
        for boat in made:
            boat.close()


def violations(page, rules=None):
    """What axe-core finds serious or critical: (rule, element, why). `rules`: these alone."""
    found = Axe().run(page.page, options={"runOnly": rules} if rules else None).response["violations"]
    told = [(v["id"], n["target"], [c["message"] for c in n["any"]]) for v in found for n in v["nodes"]]
    grave = {v["id"] for v in found if v["impact"] in SERIOUS}
    return [t for t in told if t[0] in grave]


def drawn(page, index):
    """How many pixels of a plot are neither white nor clear."""
    return page.page.evaluate(
        """(k) => { const c = document.querySelectorAll('#plots canvas')[k];
        const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data; let n = 0;
        for (let i = 0; i < d.length; i += 4) if (d[i + 3] > 200 && Math.abs(d[i] - d[i + 2]) > 60) n++; return n; }""",
        index,
    )


def test_a_live_boat_is_drawn_told_and_plotted(console, zenoh_port, browser):
    with boats(zenoh_port) as boat:
        page = Page(browser, console)
        page.wait(LIVE)
        page.wait("aritra.history.list('taped', 'state').length > 40")
        first = page.newest("state", "taped")
        page.wait(f"aritra.history.last('taped', 'state').t_ns > {first['t_ns']} + 1e9")
        hull = page.page.evaluate("aritra.map.boats.get('taped').made.get('hull').getLatLngs()[0].length")
        ratio = page.page.evaluate(
            """() => { const l = aritra.map.boats.get('taped').made.get('hull').getLatLngs()[0];
            const d = (a, b) => Math.hypot(a.lat - b.lat, a.lng - b.lng);
            return [d(l[0], {lat: (l[3].lat + l[4].lat) / 2, lng: (l[3].lng + l[4].lng) / 2}), d(l[2], l[5])]; }"""
        )
        assert hull == 7 and ratio == pytest.approx([1.47, 0.75], rel=1e-6), "to scale, in metres"
        for layer in ("path", "horizon", "ellipse", "fence in 0", "anchor 1151", "waypoint 0", "track", "reference"):
            assert page.page.evaluate("(k) => aritra.map.boats.get('taped').made.has(k)", layer), layer
        assert page.page.locator("#map .anchor span").all_inner_texts()[0].endswith(" m"), "residuals at the anchors"
        page.wait("aritra.history.list('taped', 'timing').length > 6")
        page.page.wait_for_timeout(600)
        pixels = [drawn(page, k) for k in range(8)]
        assert min(pixels) > 20, pixels
        assert "0.5" in page.text("#figures [data-key=Speed] dd") or "0.4" in page.text("#figures [data-key=Speed] dd")
        assert "autopilot: FS_ACTION" in page.text("#checks") and "Charge it." in page.text("#checks")
        assert page.text("#checks tbody tr >> nth=0").startswith("Warning"), "what needs care comes first"
        assert page.text("#mode strong") == "Mission"
        assert violations(page) == [] and page.unexpected() == []
        assert boat.obeyed == []


def test_stop_goes_with_one_click_and_what_moves_the_boat_asks_first(console, zenoh_port, browser):
    with boats(zenoh_port) as boat:
        page = Page(browser, console)
        page.wait("!document.querySelector('#stop').disabled && !document.querySelector('#hold').disabled")
        page.page.click("#stop")
        page.wait("document.querySelector('#answers li')?.dataset.kind === 'done'")
        said = page.text("#answers li >> nth=0")
        assert boat.obeyed == ["stop"] and "STOP → taped: done" in said and "“stop: heard”" in said and "ago" in said
        assert "told so" in said, "the mode that the boat says it is in"
        page.page.click("#hold")
        question = page.page.locator("#question")
        assert question.is_visible() and boat.obeyed == ["stop"]
        assert page.page.evaluate("document.activeElement.textContent") == "Yes, hold"
        assert violations(page) == []
        assert page.page.locator("#stop").is_enabled(), "nothing is in the way of STOP"
        page.page.keyboard.press("Escape")
        assert question.is_hidden() and page.page.evaluate("document.activeElement.id") == "hold"
        page.page.keyboard.press("Enter")
        page.page.keyboard.press("Enter")
        page.wait("document.querySelectorAll('#answers li').length === 2")
        page.wait("document.querySelector('#answers li').dataset.kind === 'done'")
        assert boat.obeyed == ["stop", "hold"]
        page.page.keyboard.press("F9")
        page.wait("document.querySelectorAll('#answers li').length === 3")
        page.wait("document.querySelector('#answers li').dataset.kind === 'done'")
        assert boat.obeyed == ["stop", "hold", "stop"] and page.unexpected() == []


@pytest.mark.long
def test_with_the_keyboard_alone(console, zenoh_port, browser):
    """Every control can be reached, its focus seen; the map moves by arrow keys."""
    with boats(zenoh_port, "one", "two"):
        page = Page(browser, console)
        page.wait("document.querySelectorAll('.boat').length === 2 && !document.querySelector('#hold').disabled")
        reached, outlines = [], []
        for _ in range(30):
            page.page.keyboard.press("Tab")
            at, outline = page.page.evaluate(
                """() => { const e = document.activeElement; const s = getComputedStyle(e);
                return [e.id || e.dataset.boat || e.className || e.tagName, s.outlineStyle + ' ' + s.outlineWidth]; }"""
            )
            reached.append(at)
            outlines.append(outline)
        wanted = ["stop", "stop-all", "hold", "start", "load", "one", "two", "fit", "near", "follow", "window"]
        assert [r for r in reached if r in wanted][: len(wanted)] == wanted
        assert {"map", "alerts", "checks"} <= {r.split()[0] for r in reached if r} | set(reached), reached
        controls = [o for r, o in zip(reached, outlines, strict=True) if r in wanted]
        assert set(controls) == {"solid 4px"}
        page.page.focus(".boat >> nth=1")
        page.page.keyboard.press("Enter")
        page.wait("document.querySelectorAll('.boat')[1].getAttribute('aria-pressed') === 'true'")
        before = page.page.evaluate("aritra.map.map.getCenter().lat")
        page.page.focus("#map")
        page.page.keyboard.press("ArrowUp")
        page.wait(f"aritra.map.map.getCenter().lat > {before}")
        assert page.unexpected() == []


@pytest.mark.long
def test_a_silent_boat_turns_grey_and_its_age_goes_on(console, zenoh_port, browser):
    with boats(zenoh_port) as boat:
        page = Page(browser, console)
        page.wait(LIVE)
        boat.still = True
        page.wait("document.body.classList.contains('stale')")
        page.wait("document.querySelector('#link').dataset.kind === 'lost'")
        assert "No word from taped for" in page.text("#link-text") and "can be reached" in page.text("#link-text")
        assert "Last known," in page.text("#stale-note") and "(last known)" in page.page.evaluate(
            "getComputedStyle(document.querySelector('#mode strong'), '::after').content"
        )
        assert page.page.locator("#stop").is_enabled(), "STOP is for such moments"
        page.page.click("#stop")
        page.wait("document.querySelector('#answers li')?.dataset.kind === 'done'")
        assert boat.obeyed == ["stop"]
        assert violations(page) == []
        boat.still = False
        page.wait(LIVE)
        assert not page.page.evaluate("document.body.classList.contains('stale')") and page.unexpected() == []


@pytest.mark.long
def test_a_boat_that_does_not_answer_is_told_as_that(console, zenoh_port, browser):
    with boats(zenoh_port, deaf=True):
        page = Page(browser, console)
        page.wait("!document.querySelector('#stop').disabled")
        page.page.click("#stop")
        page.wait("document.querySelector('#answers li').innerText.includes('no answer yet (try 3)')")
        page.wait("document.querySelector('#answers li').dataset.state === 'no_answer'")
        assert "NO ANSWER" in page.text("#answers li") and "may not have heard it" in page.text("#answers li")


@pytest.mark.long
def test_reload_and_a_killed_server_recover_and_a_stop_meanwhile_arrives(tmp_path, zenoh_port, browser):
    (tmp_path / "boat.key").write_bytes(KEY)
    (tmp_path / "boat.key").chmod(0o600)
    port = free_port()
    given = ("--listen", f"tcp/127.0.0.1:{zenoh_port}", "--command-key", tmp_path / "boat.key", "--port", str(port))
    with boats(zenoh_port) as boat:
        with served(tmp_path / "first.txt", *given) as (address, child):
            page = Page(browser, address)
            page.wait("aritra.history.list('taped', 'state').length > 60")
            page.page.reload()
            page.wait("aritra.history.list('taped', 'state').length > 60", 5.0)
            assert page.unexpected() == [], "what was known is there again at once"
            child.send_signal(signal.SIGKILL)
            child.wait(5)
        page.wait("document.querySelector('#link').dataset.kind === 'lost'")
        assert "No connection to the console program for" in page.text("#link-text")
        known = page.page.evaluate("aritra.history.list('taped', 'state').length")
        page.page.click("#stop")
        page.wait("document.querySelector('#answers li')?.innerText.includes('Trying again')")
        assert boat.obeyed == []
        time.sleep(1.5)
        with served(tmp_path / "second.txt", *given):
            page.wait("document.querySelector('#answers li').dataset.kind === 'done'")
            assert boat.obeyed == ["stop"]
            page.wait(LIVE)
            page.wait(f"aritra.history.list('taped', 'state').length > {known} + 20")
            gaps = page.page.evaluate(
                """() => { const t = aritra.history.list('taped', 'state').map(s => s.t_ns * 1e-9);
                return Math.max(...t.slice(1).map((x, k) => x - t[k])); }"""
            )
            assert gaps < 0.5, "the outage was filled from the boat's cache"
            assert page.unexpected(*WENT_AWAY) == []
            page.context.close()


@pytest.mark.long
def test_several_boats_each_with_its_own_orders(console, zenoh_port, browser):
    with boats(zenoh_port, "boat-1", "boat-2", "boat-10") as (one, two, ten):
        page = Page(browser, console)
        page.wait("document.querySelectorAll('.boat').length === 3")
        assert page.page.locator(".boat b").all_inner_texts() == ["boat-1", "boat-2", "boat-10"]
        page.page.click(".boat >> nth=1")
        page.wait("aritra.history.list('boat-2', 'thrusters').length > 10")
        page.page.click("#stop")
        page.wait("document.querySelector('#answers li')?.dataset.kind === 'done'")
        assert (one.obeyed, two.obeyed, ten.obeyed) == ([], ["stop"], [])
        assert page.text("#stop-all") == "STOP ALL 3"
        page.page.click("#stop-all")
        page.wait("document.querySelectorAll('#answers li[data-kind=done]').length === 4")
        assert (one.obeyed, two.obeyed, ten.obeyed) == (["stop"], ["stop", "stop"], ["stop"])
        assert violations(page) == []
        page.page.reload()
        page.wait("document.querySelector('.boat[aria-pressed=true]')?.dataset.boat === 'boat-2'")
        assert page.unexpected() == []


@pytest.mark.long
def test_on_a_phone(console, zenoh_port, browser):
    with boats(zenoh_port, "boat-1", "boat-2"):
        page = Page(browser, console, width=360, height=740, device_scale_factor=2, has_touch=True, is_mobile=True)
        page.wait("!document.querySelector('#stop').disabled && aritra.history.list('boat-1', 'state').length > 10")
        box = page.page.locator("#stop").bounding_box()
        assert box["width"] > 300 and box["height"] >= 60 and box["y"] + box["height"] <= 740, "a thumb finds it"
        page.page.evaluate("window.scrollTo(0, document.body.scrollHeight)")
        assert page.page.locator("#stop").bounding_box() == box, "wherever one has scrolled to"
        assert page.page.evaluate("document.documentElement.scrollWidth") <= 360
        small = page.page.evaluate(
            "[...document.querySelectorAll('button')].filter(b => b.offsetParent && b.offsetHeight < 40).map(b => b.id)"
        )
        assert small == []
        page.page.evaluate("window.scrollTo(0, 0)")
        page.page.tap("#near")
        page.page.tap("#stop")
        page.wait("document.querySelector('#answers li')?.dataset.kind === 'done'")
        assert violations(page) == [] and page.unexpected() == []


@pytest.mark.long
def test_figures_can_be_read_in_sunlight(console, zenoh_port, browser):
    """Contrast 7 to 1 (WCAG 2.2 AAA) for all text, live and stale; nothing moves that need not."""
    with boats(zenoh_port) as boat:
        page = Page(browser, console, reduced_motion="reduce")
        page.wait("aritra.history.list('taped', 'state').length > 20")
        page.page.click("#stop")
        page.wait("document.querySelector('#answers li')?.dataset.kind === 'done'")
        for stale in (False, True):
            boat.still = stale
            page.wait(f"document.body.classList.contains('stale') === {str(stale).lower()}")
            assert violations(page, rules=["color-contrast-enhanced"]) == [], stale


def test_a_console_without_a_key_only_looks(tmp_path, zenoh_port, browser):
    listen = f"tcp/127.0.0.1:{zenoh_port}"
    with boats(zenoh_port) as boat, served(tmp_path / "shore.txt", "--listen", listen) as (address, _):
        page = Page(browser, address)
        page.wait(LIVE)
        assert "only looks" in page.text("#no-orders")
        assert all(page.page.locator(f"#{name}").is_disabled() for name in ("stop", "hold", "start", "load"))
        page.page.keyboard.press("F9")
        page.page.wait_for_timeout(500)
        assert boat.obeyed == []
        page.context.close()
