"""Evidence that a shore stopped, killed, absent, or behind a bad radio costs the boat nothing, and loses nothing.

One boat drives laps while the shore and the link change under it, in rounds, each in another order. Every condition
stands beside the good one of its own round, so that what else the machine does touches both.
"""

from __future__ import annotations

import random
import signal
import subprocess
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from companion.core.messages import LoopTiming, ProcessStats
from companion.logs.log_file import LogFile
from companion.python_child import python
from tests.evidence.line import Line, at_least, at_most, exactly, information
from tests.evidence.shore.field import Field, missing, read_heard
from tests.evidence.shore.lossy_link import ADDRESSES

S = 1_000_000_000
PHASE_S, OUTAGE_S, SETTLE_S = 20.0, 10.0, 3.0
ROUNDS, FULL_ROUNDS = 3, 8
LOSS, DELAY_S = 0.05, 0.5
WELL = "shore well"
WARM_S = 200.0
"""Memory is judged from here on: history is full, 200 samples of the topics that are told once a second."""
SEED = 6


@dataclass
class Seen:
    """What was done when [ns]. `windows`: condition -> [(begin, end)]; `back_s`: until shore heard the boat again."""

    windows: dict[str, list[tuple[int, int]]] = field(default_factory=lambda: defaultdict(list))
    back_s: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    late: list[tuple[int, int, dict[int, int]]] = field(default_factory=list)

    def during(self, name: str, seconds: float) -> tuple[int, int]:
        begin = time.monotonic_ns()
        time.sleep(seconds)
        self.windows[name].append((begin, time.monotonic_ns()))
        return self.windows[name][-1]


def lines(full: bool) -> Iterator[Line]:
    """All figures of one long run."""
    if why := missing():
        yield exactly(f"network namespaces: {why}", 0, 1)
        return
    with Field(SEED) as boat:
        yield from _link_is_what_it_says(boat)
        boat.start_router()
        boat.start_listener(boat.heard)
        boat.wait(boat.heard.exists, 20.0)
        boat.start_boat()
        boat.wait_until_heard()
        seen, rng = Seen(), random.Random(SEED)
        begun_ns = time.monotonic_ns()
        for k in range(FULL_ROUNDS if full else ROUNDS):
            conditions = [_well, _well, _stopped, _killed_and_absent, _loss, _delay, _outage]
            rng.shuffle(conditions)
            for condition in conditions:
                condition(boat, seen)
                time.sleep(SETTLE_S)
            print(f"  (round {k + 1} done)", flush=True)
        boat.end_boat()
        yield from _lateness(boat, seen)
        yield from _gaps(boat, seen)
        yield from _memory(boat, begun_ns)


# --- conditions -------------------------------------------------------------------------------------


def _well(boat: Field, seen: Seen) -> None:
    seen.during(WELL, PHASE_S / 2)


def _stopped(boat: Field, seen: Seen) -> None:
    assert boat.router
    boat.router.send_signal(signal.SIGSTOP)
    seen.during("shore stopped (SIGSTOP)", PHASE_S)
    boat.router.send_signal(signal.SIGCONT)
    seen.back_s["stopped"].append(boat.wait_until_heard())


def _killed_and_absent(boat: Field, seen: Seen) -> None:
    assert boat.router
    boat.router.kill()
    boat.router.wait()
    seen.during("shore killed, first 5 s", PHASE_S / 4)
    seen.during("shore absent", PHASE_S)
    boat.start_router()
    seen.back_s["killed"].append(boat.wait_until_heard())


def _loss(boat: Field, seen: Seen) -> None:
    boat.set_link(loss=LOSS)
    seen.during("5 % loss, each way", PHASE_S)
    boat.set_link()
    seen.back_s["loss"].append(boat.wait_until_heard())


def _delay(boat: Field, seen: Seen) -> None:
    boat.set_link(delay_s=DELAY_S)
    seen.during("500 ms delay, each way", PHASE_S)
    boat.set_link()
    seen.back_s["delay"].append(boat.wait_until_heard())


def _outage(boat: Field, seen: Seen) -> None:
    """And a console that is opened only after it."""
    boat.set_link(up=False)
    begin, end = seen.during("10 s outage", OUTAGE_S)
    boat.set_link()
    seen.back_s["outage"].append(boat.wait_until_heard())
    file = boat.folder / f"late{len(seen.late)}.txt"
    late = boat.start_listener(file)
    time.sleep(8.0)
    seen.late.append((begin, end, read_heard(file)))
    late.terminate()
    late.wait()


# --- figures ----------------------------------------------------------------------------------------


def _lateness(boat: Field, seen: Seen) -> Iterator[Line]:
    """p99 of all ticks of a condition against those of the good one."""
    timings = [m for m in LogFile(boat.log).messages(LoopTiming) if isinstance(m, LoopTiming)]
    t_ns, late_ms = np.array([m.t_ns for m in timings]), np.array([m.lateness_ms for m in timings])

    def of(windows: list[tuple[int, int]]) -> np.ndarray:
        return np.concatenate([late_ms[(t_ns >= begin) & (t_ns < end)] for begin, end in windows])

    def p99(windows: list[tuple[int, int]]) -> float:
        return float(np.percentile(of(windows), 99))

    good = seen.windows.pop(WELL)
    well, median = p99(good), np.median(of(good))
    halves = abs(p99(good[::2]) - p99(good[1::2]))
    note = f"median {median:.2f}; windows {_spread([p99([w]) for w in good])}; two halves of them: {halves:.2f} apart"
    yield information(f"lateness p99, {WELL}", well, "ms", note)
    for name, windows in seen.windows.items():
        here, rounds = p99(windows), _spread([p99([w]) for w in windows])
        note = f"p99 {here:.2f}, median {np.median(of(windows)):.2f}; windows {rounds}"
        yield at_most(f"lateness p99 more than well: {name}", here - well, 1.0, "ms", note)
    everything = [*good, *(w for windows in seen.windows.values() for w in windows)]
    slowest = min(len(of([w])) / (w[1] - w[0]) * S for w in everything)
    yield at_least("ticks a second in the slowest window of all", slowest, 9.8)


def _gaps(boat: Field, seen: Seen) -> Iterator[Line]:
    """Every state of the outages: at a console that came later, and at the one that was there."""
    told = np.array(boat.published())
    steady = read_heard(boat.heard)
    windows = [(begin, end) for begin, end, _ in seen.late]
    wanted = [told[(told >= begin) & (told < end)] for begin, end in windows]
    n = sum(map(len, wanted))
    note = f"{len(wanted)} outages, {n} samples"
    late = sum(int(t) not in heard for states, (_, _, heard) in zip(wanted, seen.late, strict=True) for t in states)
    yield at_least("samples of the outages that the boat published, a second", n / len(wanted) / OUTAGE_S, 9.8, "")
    yield exactly("missing at a console opened afterwards", late, 0, "", note)
    yield exactly("missing at the console that was there", sum(int(t) not in steady for w in wanted for t in w), 0)
    first, last = min(steady), max(steady)
    all_of = told[(told >= first) & (told <= last)]
    lost = sum(int(t) not in steady for t in all_of)
    note = f"of {len(all_of)}; 60 s are kept, absences of shore were shorter"
    yield exactly("missing there in the whole run, all conditions", lost, 0, "", note)
    pairs = zip(windows, wanted, strict=True)
    waits = [max((steady[int(t)] - end) / S for t in states if int(t) in steady) for (_, end), states in pairs]
    yield information("last sample of an outage came after its end by", max(waits), "s", _spread(waits))


def _memory(boat: Field, begun_ns: int) -> Iterator[Line]:
    """Straight lines through the memory of both companions from WARM_S on; the one without telemetry grows, too."""
    slopes, ranges = [], []
    for log in (boat.log, boat.silent_log):
        stats = [m for m in LogFile(log).messages(ProcessStats) if isinstance(m, ProcessStats)]
        kept = [m for m in stats if m.t_ns - begun_ns > WARM_S * S]
        t_s, rss = np.array([(m.t_ns - begun_ns) / S for m in kept]), np.array([m.rss_mb for m in kept])
        slopes.append(float(np.polyfit(t_s / 3600.0, rss, 1)[0]))
        ranges.append(f"{rss.min():.1f} to {rss.max():.1f} MB")
    note = f"{slopes[0]:+.1f} with it ({ranges[0]}), {slopes[1]:+.1f} without ({ranges[1]}), {t_s[-1] - t_s[0]:.0f} s"
    yield at_most("memory grows faster with telemetry than without", slopes[0] - slopes[1], 10.0, "MB/h", note)


def _spread(values: list[float]) -> str:
    return f"median {np.median(values):.2f}, {min(values):.2f} to {max(values):.2f}"


ECHO = f"""
import socket
s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
s.bind(("{ADDRESSES[1]}", 9))
print("ready", flush=True)
while True:
    s.sendto(*s.recvfrom(100))
"""
ASK = f"""
import socket, sys, time
s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
s.settimeout(2.0)
n, back, waits = int(sys.argv[1]), 0, []
for k in range(n):
    t = time.monotonic()
    s.sendto(b"x", ("{ADDRESSES[1]}", 9))
    s.settimeout(2.0 if n < 10 else 0.05)
    try:
        s.recv(100)
        waits.append(time.monotonic() - t)
    except TimeoutError:
        pass
print(len(waits) / n, sorted(waits)[len(waits) // 2] if waits else 0)
"""


def _link_is_what_it_says(boat: Field) -> Iterator[Line]:
    """The link's own test, with datagrams there and back."""

    def ask(n: int) -> tuple[float, float]:
        words = boat.in_boat(python("-c", ASK, str(n)))
        came, wait_s = subprocess.run(words, capture_output=True, text=True, check=True).stdout.split()
        return float(came), float(wait_s)

    echo = subprocess.Popen(boat.in_shore(python("-c", ECHO)), stdout=subprocess.PIPE, text=True)
    assert echo.stdout and echo.stdout.readline()
    try:
        boat.set_link(loss=LOSS)
        yield at_least(
            "the link loses datagrams there and back", 100 * (1 - ask(600)[0]), 6.0, "%", "5 % each way: 9.75 %"
        )
        boat.set_link(delay_s=DELAY_S)
        yield at_least("the link delays them there and back", ask(3)[1], 2 * DELAY_S, "s")
        boat.set_link(up=False)
        yield exactly("of datagrams in an outage come back", ask(3)[0], 0)
        boat.set_link()
    finally:
        echo.terminate()
        echo.wait()
