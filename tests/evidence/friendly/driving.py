"""Evidence for driving from the page: a mission drawn and driven, and a gamepad that lets go, at a simulated boat."""

from __future__ import annotations

import contextlib
import math
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from companion.python_child import aritra
from tests.evidence.line import Line, at_least, at_most, exactly
from tests.evidence.shore.console import NEUTRAL, running_boat
from tests.processes.console.test_console_mission import click
from tests.processes.test_loopback import GroundStation, wait_for
from tests.support.console_fixture import Page, chromium, served

PAD = """(() => {
  const made = { axes: [0, 0, 0, 0], held: false, moved: 1, there: true };
  globalThis.pad = made;
  navigator.getGamepads = () => made.there ? [{ connected: true, index: 0, id: 'Test pad (made by the test)',
    mapping: 'standard', timestamp: made.moved, axes: made.axes,
    buttons: Array.from({ length: 17 }, (_, k) => ({ pressed: k === 5 && made.held })) }] : [];
})()"""
"""A gamepad of the browser's; `pad` is what its hands do."""
HIDDEN = """Object.defineProperty(document, 'hidden', { value: true, configurable: true });
document.dispatchEvent(new Event('visibilitychange'));"""
AHEAD = "pad.moved++; pad.axes = [0, -0.8, 0, 0]"
GOAL_S = 0.7
SIDE_M = 5.0
PROGRESS = """({ passed: aritra.history.last('aritra', 'reference')?.waypoints_passed ?? 0,
  mode: aritra.history.last('aritra', 'mode').mode })"""
DRIVEN_S = 120.0


class LettingGo(NamedTuple):
    """One way in which the sticks end, and how the page is brought back from it."""

    words: str
    act: Callable[[Page], None]


class Rig(NamedTuple):
    """A simulated boat at rest, and a page on its console; `again`: another page; `console`: the program's process;
    `folder`: of the boat's log."""

    page: Page
    station: GroundStation
    again: Callable[[], Page]
    console: subprocess.Popen
    folder: Path


@contextlib.contextmanager
def _rig() -> Iterator[Rig]:
    with (
        running_boat(start=False) as run,
        chromium() as browser,
        served(run.folder / "shore.txt", *run.given, "--logs", run.folder) as (address, child),
    ):

        def opened() -> Page:
            page = Page(browser, address)
            page.page.add_init_script(PAD)
            page.page.reload()
            page.wait("!document.querySelector('#hold').disabled && aritra.map.boats.get('aritra')?.made.has('hull')")
            page.wait("aritra.history.last('aritra', 'checks')")
            return page

        yield Rig(opened(), run.station, opened, child, run.folder)


def _hold(page: Page) -> None:
    """The dead man pressed with the stick at rest, and then ahead."""
    page.page.evaluate("pad.there = true; pad.axes = [0, 0, 0, 0]; pad.held = true")
    page.wait("!aritra.steering.grip.waits")
    page.page.wait_for_timeout(300)  # the boat, too, wants to see them at rest
    page.wait("aritra.history.last('aritra', 'mode')?.mode === 'manual'")
    page.page.evaluate(AHEAD)


def _all_neutral(station: GroundStation) -> bool:
    return all(p == NEUTRAL for _, p in station.outputs[-10:])


def _moving(station: GroundStation) -> bool:
    return all(p != NEUTRAL for _, p in station.outputs[-5:])


def _take(page: Page) -> None:
    page.page.click("#steer-take")
    page.page.click("#question .yes")
    page.wait("aritra.steering.boat === 'aritra'")
    page.wait("aritra.history.last('aritra', 'mode')?.mode === 'manual'")


def _neutral_s(station: GroundStation, act: Callable[[], None]) -> float:
    """From what ends the sticks to the last output off neutral [s]."""
    begun_ns = time.monotonic_ns()
    act()
    wait_for(lambda: _all_neutral(station), 30.0, lambda: "outputs stay off neutral")
    after = [t_ns for t_ns, p in station.outputs if t_ns > begun_ns and p != NEUTRAL]
    return (max([begun_ns, *after]) - begun_ns) * 1e-9


def _let_go_s(page: Page, station: GroundStation, act: Callable[[], None]) -> float:
    """The boat is driven ahead, and then `act`: seconds to neutral."""
    page.page.evaluate("clearInterval(aritra.steering.timer); aritra.steering.open = false")
    page.page.evaluate("delete document.hidden; aritra.steering.setOpen(true)")
    if page.page.evaluate("aritra.steering.boat") is None:
        _take(page)
    _hold(page)
    wait_for(lambda: _moving(station), 20.0, lambda: page.text("#steer-says"))
    return _neutral_s(station, act)


ENDS = (
    LettingGo("the dead man's button let go of", lambda page: page.page.evaluate("pad.held = false")),
    LettingGo("gamepad unplugged", lambda page: page.page.evaluate("pad.there = false")),
    LettingGo(
        "script of the page stands still",
        lambda page: page.page.evaluate("(() => { const end = Date.now() + 1500; while (Date.now() < end); })()"),
    ),
    LettingGo(
        "the page sends no more",
        lambda page: page.page.evaluate("clearInterval(aritra.steering.timer)"),
    ),
    LettingGo("tab hidden", lambda page: page.page.evaluate(HIDDEN)),
    LettingGo("STOP", lambda page: page.page.keyboard.press("F9")),
    LettingGo("tab closed", lambda page: page.page.close()),
)


def a_gamepad_drives_and_lets_go(full: bool) -> Iterator[Line]:
    """A gamepad in a headless Chromium drives a simulated boat, and lets go in every way; measured at its outputs"""
    with _rig() as rig:
        page, station = rig.page, rig.station
        page.page.click("#steer")
        page.page.evaluate("pad.held = true; " + AHEAD)
        page.page.wait_for_timeout(2000)
        moved = sum(p not in (NEUTRAL, (0,) * 4) for _, p in station.outputs)
        yield exactly("outputs off neutral before the boat gave its sticks", moved, 0)
        page.page.evaluate("pad.held = false")
        _take(page)
        page.page.evaluate(AHEAD)
        page.page.wait_for_timeout(1500)
        moved = sum(p not in (NEUTRAL, (0,) * 4) for _, p in station.outputs)
        yield exactly("outputs off neutral with a stick ahead and no dead man", moved, 0)
        page.page.evaluate("pad.held = true")
        page.page.wait_for_timeout(1500)
        moved = sum(p not in (NEUTRAL, (0,) * 4) for _, p in station.outputs)
        yield exactly("... and with it, pressed while the stick was off its middle", moved, 0)
        for end in ENDS:
            took_s = _let_go_s(page, station, lambda end=end: end.act(page))
            yield at_most(f"{end.words}: to neutral at the boat's outputs", took_s, GOAL_S, "s")
        page = rig.again()
        took_s = _let_go_s(page, station, rig.console.kill)
        yield at_most("console program killed: to neutral at the boat's outputs", took_s, GOAL_S, "s")


def a_mission_is_drawn_and_driven(full: bool) -> Iterator[Line]:
    """Four waypoints clicked on the map of a headless Chromium, sent, started, and driven by a simulated boat"""
    with _rig() as rig:
        page = rig.page
        here = page.newest("state", "aritra")
        n, e = here["north_m"] + 2.0, here["east_m"] + 2.0
        corners = [(n, e), (n + SIDE_M, e), (n + SIDE_M, e + SIDE_M), (n, e + SIDE_M)]
        page.page.click("#fit")
        page.page.click("#draw")
        for place in corners:
            click(page, *place)
        page.wait("document.querySelector('#mission-sum').innerText.includes('about')")
        told_s = page.page.evaluate("aritra.editor.checked.told.duration_s")
        yield exactly("problems that the boat's checks find", page.page.locator("#mission-problems li").count(), 0)
        page.page.click("#mission-send")
        page.page.click("#question .yes")
        page.wait("document.querySelector('#answers li')?.dataset.command === 'load_mission'")
        page.wait("document.querySelector('#answers li')?.dataset.kind === 'done'")
        page.page.click("#mission-close")
        page.page.click("#start")
        page.page.click("#question .yes")
        page.wait("aritra.history.last('aritra', 'mode')?.mode === 'auto'")
        begun_s = time.monotonic()
        while (now := page.page.evaluate(PROGRESS))["passed"] < 4 and now["mode"] == "auto":
            if time.monotonic() - begun_s > DRIVEN_S:
                break
            page.page.wait_for_timeout(50)
        took_s = time.monotonic() - begun_s
        track = [(s["north_m"], s["east_m"]) for s in page.page.evaluate("aritra.history.list('aritra', 'state')")]
        missed = max(min(math.dist(place, at) for at in track) for place in corners)
        yield at_least("waypoints passed of those that were drawn", now["passed"], 4, "", f"mode {now['mode']}")
        yield at_most("largest miss of a drawn waypoint", missed, 0.6, "m")
        yield at_most(
            "driven in, beside what the page foretold", took_s - told_s, 30.0, "s", f"foretold {told_s:.0f} s"
        )
        page.page.click("#log-again")
        with page.page.expect_download() as saved:
            page.page.click("[aria-label='Download run.mcap']")
        saved.value.save_as(copy := rig.folder / "copy.mcap")
        replayed = subprocess.run(aritra("replay", copy), capture_output=True, text=True, check=False)
        said = replayed.stdout.strip().splitlines() or [replayed.stderr]
        yield exactly("log downloaded while it is written, replayed: exit code", replayed.returncode, 0, "", said[-1])


PARTS = (a_mission_is_drawn_and_driven, a_gamepad_drives_and_lets_go)
