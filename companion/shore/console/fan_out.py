"""Samples for each browser: all of the boat that it chose, and what list and map need of the others. Pure.

A frame is one text message, every 0.1 s at most:

    {"type": "samples", "now_ms": t, "missed": n,
     "clocks": {boat: [ahead_ms, alive, runs, no_orders]}, "samples": [{boat, topic, sample}]}

`now_ms` is the console's monotonic clock, `ahead_ms` a boat's minus it (null: nothing was heard of it yet): so the page
knows how old a sample is, and goes on counting when no frame comes; `runs`: programs that call themselves by that name
at present; `no_orders`: why this console can give it none. `missed`: samples that a slow browser was spared since the
last frame.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping

import msgspec

from companion.shore.console.store import BoatRecord, Sample

OVERVIEW = ("about", "state", "mode")
"""Topics of boats that were not chosen, of each the newest in a frame."""
QUEUE = 2000
"""Queue for a slow browser; beyond it the oldest samples are dropped (assumed)."""
QUIET_MS = 1000.0
"""A frame without samples goes out this often, so that the page knows that the console lives."""
_ENCODER = msgspec.json.Encoder()


Clock = tuple[float | None, bool, int, str]


def clocks(boats: Mapping[str, BoatRecord], now_ms: float) -> dict[str, Clock]:
    """Boat -> (its clock minus ours [ms], whether its token is there, programs of that name, why it gets no orders)."""
    now_ns = round(now_ms * 1e6)
    ahead_ms = {name: round(b.ahead_ns * 1e-6, 1) if b.run else None for name, b in boats.items()}
    return {name: (ahead_ms[name], b.alive, len(b.runs(now_ns)), b.no_orders) for name, b in boats.items()}


def entry(sample: Sample) -> dict[str, object]:
    """One sample as the page reads it."""
    return {"boat": sample.boat, "topic": sample.topic, "sample": msgspec.Raw(sample.data)}


class Watcher:
    """One browser. `chosen`: the boat that it looks at closely."""

    def __init__(self) -> None:
        self.chosen: str | None = None
        self._all: deque[Sample] = deque(maxlen=QUEUE)
        self._history: list[Sample] = []
        self._newest: dict[tuple[str, str], Sample] = {}
        self._missed = 0
        self._sent_clocks: dict[str, Clock] = {}
        self._last_ms = float("-inf")

    def note(self, sample: Sample) -> None:
        """One new sample of any boat."""
        if sample.boat == self.chosen or sample.topic == "alert":
            self._missed += len(self._all) == QUEUE
            self._all.append(sample)
        elif sample.topic in OVERVIEW:
            key = sample.boat, sample.topic
            known = self._newest.get(key)
            if known is None or known.t_ns <= sample.t_ns:
                self._newest[key] = sample

    def choose(self, boats: Mapping[str, BoatRecord], boat: str) -> None:
        """Look at `boat` from now on: everything that is kept of it becomes due, however slow the browser is."""
        self.chosen = boat
        self._history = list(known.samples()) if (known := boats.get(boat)) else []

    def turn(self, boat: BoatRecord) -> None:
        """Another run of a boat is shown from now on."""
        self._all = deque((s for s in self._all if s.boat != boat.name), maxlen=QUEUE)
        self._newest = {key: s for key, s in self._newest.items() if s.boat != boat.name}
        if boat.name == self.chosen:
            self.choose({boat.name: boat}, boat.name)
        else:
            self.begin([boat])

    def begin(self, boats: Iterable[BoatRecord]) -> None:
        """A new browser: of each boat what the list needs, and its alerts."""
        for boat in boats:
            for topic in OVERVIEW:
                if newest := boat.newest(topic):
                    self.note(newest)
            for alert in boat.kept.get("alert", ()):
                self.note(alert)

    def frame(self, boats: Mapping[str, BoatRecord], now_ms: float) -> bytes | None:
        """The frame that is due, or None."""
        new = {name: clock for name, clock in clocks(boats, now_ms).items() if self._sent_clocks.get(name) != clock}
        samples = [*self._newest.values(), *self._history, *self._all]
        if not samples and not new and now_ms - self._last_ms < QUIET_MS:
            return None
        entry_update = {
            "type": "samples",
            "now_ms": round(now_ms, 1),
            "missed": self._missed,
            "clocks": new,
            "samples": [entry(s) for s in samples],
        }
        self._sent_clocks.update(new)
        self._all.clear()
        self._history.clear()
        self._newest.clear()
        self._missed, self._last_ms = 0, now_ms
        return _ENCODER.encode(entry_update)
