"""The autopilot's clock and the ground station's in a telemetry log. Every record has the host's stamp of its arrival.

Records with a stamp of the autopilot are moved to the host's clock by the line of least delay,

    t_host = t_autopilot + a + b t_autopilot,   a, b: the highest line with t_host <= arrival for every record

which removes the jitter of the link; its constant least delay remains and is unknown. Where the host's clock was set
meanwhile, the least delay changes for good from one record to the next: that is taken out of the arrivals first.
"""

from __future__ import annotations

import itertools
from collections import Counter, defaultdict
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from companion.logs.readers.join import BACK_NS
from companion.logs.runs.run import LogProblem
from drivers.mavlink.decode import STAMPS

MOST_DRIFT = 5e-4
"""Largest drift of two clocks; crystals keep 1e-4 and better. Assumed."""
STEP_S, BIN_S = 0.3, 10.0
"""A least delay over `BIN_S` that changes by more than `STEP_S` for good is a clock that was set; assumed."""
SET_S = 1800.0
"""A delay that changes by more from one record to the next is a clock that was set, from 1970 to now for example: no
link holds a record up for so long. Assumed."""
WRAP_S = 60.0
"""A stamp that wrapped agrees with the host's clock to so much; else the autopilot was started anew. Assumed."""


class Arrival(NamedTuple):
    """A record: arrival by the host [ns], the autopilot's own stamp [ns since boot, may have wrapped; -1: none]."""

    t_rx_ns: int
    device_ns: int
    message: Any

    @property
    def wrap_ns(self) -> int:
        """Where the stamp wraps; 0: nowhere."""
        return STAMPS.get(self.message.get_type(), ("", 0, None))[2] or 0


def longest_boot(arrivals: Sequence[Arrival], notes: list[LogProblem]) -> list[Arrival]:
    """Those of the boot with the most servo outputs, and a note of what that leaves out; parameters of all come first.

    A stamp that goes back, and has not wrapped, is of another boot, or of a slower link to the same autopilot. What has
    no stamp may be of the next boot already, after the last record of the kept one that has: it is left out.
    """
    late, begins = _gone_back(arrivals)
    if late:
        text = f"{len(late)} records came more than {BACK_NS / 1e9:g} s after later ones, as by a second link: left out"
        notes.append(LogProblem(kind="out of order", text=text))
    bounds = [0, *sorted(begins), len(arrivals)]
    boots = [[arrivals[k] for k in range(first, end) if k not in late] for first, end in itertools.pairwise(bounds)]
    if len(boots) == 1:
        return boots[0]
    kept = max(boots, key=lambda boot: sum(one.message.get_type() == "SERVO_OUTPUT_RAW" for one in boot))
    if kept is not boots[-1]:
        kept = kept[: max(k for k, one in enumerate(kept) if one.device_ns >= 0) + 1]
    left_out = sum(map(len, boots)) - len(kept)
    text = f"the autopilot was started anew {len(boots) - 1} times; {left_out} records of its other boots are left out"
    notes.append(LogProblem(kind="clock jump", text=text))
    return [*(one for one in itertools.chain(*boots) if one.message.get_type() == "PARAM_VALUE"), *kept]


def _gone_back(arrivals: Sequence[Arrival]) -> tuple[set[int], set[int]]:
    """Places of records that came late, and of the first ones of further boots.

    After a boot, stamps need as long as they went back by to be where they were; those of a quicker link are at once.
    What is as far behind as what was late is late, too: at the end of a log nothing quicker follows.
    """
    late, begins, behind_ns = set[int](), set[int](), -1
    last: dict[str, Arrival] = {}
    of_type: dict[str, list[Arrival]] = defaultdict(list)
    for one in arrivals:
        of_type[one.message.get_type()].append(one)
    nth = Counter[str]()
    for k, one in enumerate(arrivals):
        name = one.message.get_type()
        nth[name] += 1
        if name in last and _went_back(before := last[name], one):
            offset_ns = one.t_rx_ns - one.device_ns
            if (late and abs(offset_ns - behind_ns) < BACK_NS) or _is_passed(before, one, of_type[name], nth[name]):
                behind_ns = offset_ns
                late.add(k)
                continue
            begins.add(k)
            last.clear()
        if one.device_ns >= 0:
            last[name] = one
    return late, begins


def _is_passed(before: Arrival, one: Arrival, of_type: Sequence[Arrival], first: int) -> bool:
    """Whether of those of its type from `first` on one has a stamp like `before`'s, sooner than `one` could have it."""
    until_ns = one.t_rx_ns + (before.device_ns - one.device_ns) // 2
    soon = itertools.takewhile(lambda later: later.t_rx_ns < until_ns, itertools.islice(of_type, first, None))
    return any(later.device_ns >= before.device_ns for later in soon)


def _went_back(before: Arrival, now: Arrival) -> bool:
    """Whether the autopilot's stamp went back from one record to the next of its type, other than by wrapping."""
    step_ns = now.device_ns - before.device_ns
    missed_ns = step_ns + now.wrap_ns - (now.t_rx_ns - before.t_rx_ns)
    return step_ns < -BACK_NS and not (now.wrap_ns and abs(missed_ns) < WRAP_S * 1e9)


def host_stamps(arrivals: list[Arrival], notes: list[LogProblem]) -> list[int]:
    """Stamps of records of one boot, in their order, on the host's clock [ns]; `notes` get the steps of that clock."""
    # 1. The autopilot's stamps without wraps, and the delay of each record that has one.
    rx_ns, device_ns = np.array([one[:2] for one in arrivals], dtype=np.int64).T
    at, names = np.flatnonzero(device_ns >= 0), np.array([one.message.get_type() for one in arrivals])
    offset_ns = int(np.median(rx_ns[at] - device_ns[at]))
    for name, wrap_ns in ((name, wrap_ns) for name, (_, _, wrap_ns) in STAMPS.items() if wrap_ns and name in names):
        mine = names == name
        own_ns = device_ns[mine]
        own_ns -= wrap_ns * np.rint(np.diff(own_ns, prepend=own_ns[0]) / wrap_ns).astype(np.int64).cumsum()
        device_ns[mine] = own_ns + wrap_ns * round(float(np.median(rx_ns[mine] - own_ns - offset_ns)) / wrap_ns)
    since_ns, zero_ns = device_ns - device_ns[at[0]], rx_ns[at[0]]
    t_s, delay_s = since_ns[at] / 1e9, (rx_ns - zero_ns - since_ns)[at] / 1e9
    # 2. Steps of the host's clock, large and small; its time is what it showed at most records.
    larger_s = np.diff(delay_s, prepend=delay_s[0])
    set_s = np.where(np.abs(larger_s) > SET_S, larger_s, 0.0).cumsum()
    steps_s = set_s + _steps(t_s, delay_s - set_s)
    if len(changes := np.flatnonzero(np.diff(steps_s)) + 1):
        sizes = ", ".join(f"{steps_s[k] - steps_s[k - 1]:+.2f} s after {t_s[k]:.0f} s" for k in changes[:5])
        text = (
            f"the ground station's clock was set {len(changes)} times ({sizes}): taken out, so that time goes on "
            "evenly; a UWB log beside, stamped by that clock, is off by as much there"
        )
        notes.append(LogProblem(kind="clock jump", text=text))
        values, counts = np.unique(steps_s, return_counts=True)
        steps_s = steps_s - values[counts.argmax()]
    # 3. The line; records without a stamp of the autopilot count by their arrival.
    line = _least_delay(t_s, delay_s - steps_s)
    of_line_s = np.polynomial.polynomial.polyval(since_ns / 1e9, line)
    latest = np.maximum(np.searchsorted(at, np.arange(len(arrivals)), side="right") - 1, 0)
    own = since_ns + zero_ns + np.rint(of_line_s * 1e9).astype(np.int64)
    arrived = rx_ns - np.rint(steps_s[latest] * 1e9).astype(np.int64)
    return np.where(device_ns >= 0, own, arrived).tolist()


def _steps(t_s: np.ndarray, delay_s: np.ndarray) -> np.ndarray:
    """How much the host's clock had been set by until each record, (n,) [s], by stamps (n,) and delays in file order.

    Set forward, no later record is as early as the least before; set back, no earlier one as the least after. Nothing
    is found within `BIN_S` of either end, nor a link that is slow for a while and then as fast as before.
    """
    # 1. Least delays by bin; where all before, or all after, are larger by `STEP_S`, the first record after the step.
    _, bins = np.unique(np.floor(t_s / BIN_S), return_inverse=True)
    least_s, places = np.full(bins.max() + 1, np.inf), []
    np.minimum.at(least_s, bins, delay_s)
    before, after = np.minimum.accumulate(least_s), np.minimum.accumulate(least_s[::-1])[::-1]
    for k in range(1, len(least_s) - 2):
        if after[k + 1] - after[k] > STEP_S:
            places.append(np.flatnonzero(delay_s < (after[k] + after[k + 1]) / 2)[-1] + 1)
        if before[k] - before[k + 1] > STEP_S:
            places.append(np.flatnonzero(delay_s < (before[k] + before[k + 1]) / 2)[0])
    # 2. Its size, by the least delays next to it: later ones have drifted.
    steps_s = np.zeros(len(t_s))
    for place in places:
        earlier, later = t_s[:place] > t_s[place - 1] - BIN_S, t_s[place:] < t_s[place] + BIN_S
        steps_s[place:] += delay_s[place:][later].min() - delay_s[:place][earlier].min()
    return steps_s


def _least_delay(t_s: np.ndarray, delay_s: np.ndarray) -> tuple[float, float]:
    """a, b of the highest line a + b t under all delays, through the least one of either half of the time.

    b is 0 where it would be more than `MOST_DRIFT`.
    """
    middle = (t_s.min() + t_s.max()) / 2
    points = []
    for half in (t_s <= middle, t_s > middle):
        if half.any():
            at = np.flatnonzero(half)[delay_s[half].argmin()]
            points.append((t_s[at], delay_s[at]))
    (t0, d0), (t1, d1) = points[0], points[-1]
    b = (d1 - d0) / (t1 - t0) if t1 - t0 > 60.0 else 0.0  # a drift from less than a minute would be jitter
    b = b if abs(b) <= MOST_DRIFT else 0.0
    return float((delay_s - b * t_s).min()), float(b)
