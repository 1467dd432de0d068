"""Evidence for the console in the first hour: three sizes of screen, light and dark, with no, one and three boats."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path

from axe_playwright_python.sync_playwright import Axe

from companion.core.messages import Alert
from tests.evidence.line import Line, at_least, exactly
from tests.processes.console.layout import SIZES, THEMES, overlaps, place, reachable, resize, scroll
from tests.support.console_fixture import CHOSEN, KEY, Page, TapedBoat, chromium, served
from tests.support.zenoh_fixture import free_port

FLEETS = {0: (), 1: ("one",), 3: ("boat-1", "boat-2", "boat-3")}
HISTORY_S = 150.0
TONES = """globalThis.tones = 0; const start = OscillatorNode.prototype.start;
OscillatorNode.prototype.start = function (...when) { tones++; return start.apply(this, when); };"""


@contextlib.contextmanager
def _console(*names: str) -> Iterator[tuple[Page, list[TapedBoat]]]:
    """A page of a console that has the key of all these boats, and they drive."""
    with tempfile.TemporaryDirectory() as name, chromium() as browser, contextlib.ExitStack() as held:
        key, port = Path(name) / "key", free_port()
        key.write_bytes(KEY)
        key.chmod(0o600)
        given = ("--listen", f"tcp/127.0.0.1:{port}", "--command-key", key)
        address, _ = held.enter_context(served(Path(name) / "out.txt", *given))
        made = []
        for boat in names:
            made.append(TapedBoat(port, boat))
            held.callback(made[-1].close)
        page = Page(browser, address, reduced_motion="reduce")
        page.wait(f"aritra.history.boats().length === {len(names)}")
        if names:
            page.wait(f"!document.querySelector('#hold').disabled && aritra.history.last({CHOSEN}, 'checks')")
        yield page, made


def nothing_lies_on_anything(full: bool) -> Iterator[Line]:
    """Boxes that share more than a pixel, and what axe-core finds, at 390, 820, 1440 px, light and dark"""
    for count, names in FLEETS.items():
        lying, grave, wide = 0, 0, 0
        with _console(*names) as (page, _):
            if names:
                page.page.click("#stop")
                page.wait("document.querySelector('#answers li')?.dataset.kind === 'done'")
            for width in SIZES:
                for theme in THEMES:
                    resize(page, width, theme)
                    for share in (0.0,) if width > 960 else (0.0, 1.0):
                        scroll(page, share)
                        lying += len(overlaps(page))
                    wide += page.page.evaluate("document.documentElement.scrollWidth") > width
                    found = Axe().run(page.page).response["violations"]
                    grave += sum(v["impact"] in ("serious", "critical") for v in found)
            yield exactly(f"{count} boats: boxes that lie on each other, 6 screens", lying, 0)
            yield exactly(f"{count} boats: screens that are wider than they are", wide, 0)
            yield exactly(f"{count} boats: axe-core, serious or critical", grave, 0)
            yield exactly(f"{count} boats: errors on the browser's console", len(page.unexpected()), 0)


def stop_keeps_its_place(full: bool) -> Iterator[Line]:
    """STOP while questions, answers, a second boat and scrolling come and go, at three widths"""
    for width in SIZES:
        with _console("one", "two") as (page, _):
            resize(page, width, "light")
            before, moved, missed, asked, lying = place(page, "#stop"), 0.0, 0, 0, 0
            for act in ("hold", "start", "stop", "draw", "draw-fence", "drive-here", "steer", "steer-take", "scroll"):
                scroll(page, 1.0) if act == "scroll" else page.page.click(f"#{act}")
                page.page.wait_for_timeout(200)
                now = place(page, "#stop")
                moved = max(moved, *(abs(a - b) for a, b in zip(before, now, strict=True)))
                missed += not reachable(page, "#stop")
                lying += len(overlaps(page)) if width <= 960 or act != "scroll" else 0
                asked += 1
            yield exactly(f"{width} px: STOP moved by, in {asked} moments", moved, 0, "px")
            yield exactly(f"{width} px: moments in which a click would miss it", missed, 0)
            yield exactly(f"{width} px: boxes that lie on each other meanwhile", lying, 0)


def stop_says_what_it_can(full: bool) -> Iterator[Line]:
    """A boat that ended: STOP, F9, STOP ALL, the list"""
    with _console("one", "two") as (page, (one, two)):
        page.page.click(".boat >> nth=1")
        page.wait("aritra.history.last('two', 'mode') !== undefined")
        yield exactly("boats that STOP ALL counts, both there", int(page.text("#stop-all").split()[-1]), 2)
        two.close()
        page.wait("document.querySelector('#stop').disabled")
        yield exactly("boats that STOP ALL counts, one ended", int(page.text("#stop-all").split()[-1]), 1)
        page.page.keyboard.press("F9")
        page.page.wait_for_timeout(500)
        yield exactly("orders that F9 gave to the boat that ended", page.page.locator("#answers li").count(), 0)
        page.page.click(".away:visible")
        page.wait("document.querySelector('#stop-whom').innerText === 'one'")
        page.page.keyboard.press("F9")
        page.wait("document.querySelector('#answers li')?.dataset.kind === 'done'")
        yield exactly("put away: STOPs that reach the other by F9", len(one.obeyed), 1)


def history_and_alarms(full: bool) -> Iterator[Line]:
    """What a page that opens late shows, and what it sounds"""
    with _console("one") as (page, (boat,)):
        seconds = HISTORY_S if full else 20.0
        page.page.wait_for_timeout(1e3 * seconds)
        page.page.add_init_script(TONES)
        page.page.reload()
        page.wait("aritra.history.list('one', 'state').length > 10")
        page.page.wait_for_timeout(500)
        span_s = page.page.evaluate("(([a, b]) => b - a)(aritra.history.span('one'))")
        yield at_least(f"history of a page opened after {seconds:.0f} s", span_s, seconds - 5.0, "s")
        boat.telemetry.see(Alert(t_ns=boat.now_ns(), level="error", text="unheard"))
        page.page.wait_for_timeout(500)
        yield exactly("tones before the alarms are switched on", page.page.evaluate("tones"), 0)
        page.page.click("#alarms")
        page.page.wait_for_timeout(2000)
        before = page.page.evaluate("tones")
        boat.telemetry.see(Alert(t_ns=boat.now_ns(), level="error", text="heard"))
        page.page.wait_for_timeout(1000)
        yield exactly("tones of an error afterwards", page.page.evaluate("tones") - before, 4)


PARTS = (nothing_lies_on_anything, stop_keeps_its_place, stop_says_what_it_can, history_and_alarms)
