"""Telemetry of all boats, validated: newest values, bounded history, age of each boat's last sample. Pure.

Samples come in any order (history and what was missed arrive beside what is new), from runs that ended, from boats
that started anew, and from strangers; what is not a sample of docs/telemetry.md is counted and left out.
"""

from __future__ import annotations

import re
from collections import Counter, deque
from collections.abc import Iterator
from typing import NamedTuple

from companion.core.telemetry import structs as shore

KEPT = {"state": 1200, "thrusters": 1200, "reference": 600, "timing": 300, "battery": 300, "mode": 200, "alert": 200}
"""Topic -> samples kept: two minutes of those with a rate (assumed). Of the others the newest."""
BOATS = 200
"""More names than that are a mistake or an attack (assumed)."""
RUNS = 16
"""Former runs of a boat that are remembered, to leave out what still arrives from them."""
LATE_NS, TWIN_NS = 5_000_000_000, 3_000_000_000
"""Samples of a former run may arrive so late; one that still sends counts as a twin for so long (assumed)."""
MAX_BYTES = 65_536
DRIFT = 1e-3
"""More than two clocks run apart: what a boat's clock was thought to show is doubted in time (assumed)."""
NAME = r"^[A-Za-z0-9_.-]{1,40}\Z"
"""Names of boats, as in the run file."""


class Sample(NamedTuple):
    """One valid telemetry struct; `data`: its JSON, encoded anew."""

    boat: str
    topic: str
    t_ns: int
    data: bytes


class BoatRecord:
    """One boat: its present run, its samples and its clock.

    `ahead_ns`: its clock minus ours, estimated by the sample with the least transit time: no sample arrives before it
    was sent, so the largest difference is nearest to the truth; its error is the least transit time.
    """

    def __init__(self, name: str) -> None:
        self.name, self.run, self.alive = name, "", False
        self.kept: dict[str, deque[Sample]] = {}
        self._newest_ns: dict[str, int] = {}
        self.newest_ns = self.ahead_ns = self._heard_ns = self._began_ns = 0
        self.twin_ns: int | None = None
        self.malformed = 0
        self._former: deque[str] = deque(maxlen=RUNS)

    def take(self, topic: str, message: shore.ShoreMessage, heard_ns: int) -> Sample | None:
        """Note one sample; None: of a former run."""
        if message.run in self._former:
            if heard_ns - self._began_ns > LATE_NS:
                self.twin_ns = heard_ns
            return None
        if message.run != self.run:
            self._begin(message.run, message.t_ns - heard_ns, heard_ns)
        drifted_ns = self.ahead_ns - round(DRIFT * (heard_ns - self._heard_ns))
        self.ahead_ns, self._heard_ns = max(message.t_ns - heard_ns, drifted_ns), heard_ns
        self.newest_ns = max(self.newest_ns, message.t_ns)
        sample = Sample(self.name, topic, message.t_ns, shore.encode(message))
        kept = self.kept.setdefault(topic, deque(maxlen=KEPT.get(topic, 1)))
        self._newest_ns[topic] = max(message.t_ns, self._newest_ns.get(topic, -1))
        if kept.maxlen != 1 or not kept or kept[-1].t_ns <= message.t_ns:
            kept.append(sample)
        return sample

    def knows(self, topic: str, message: shore.ShoreMessage) -> bool:
        """Whether this sample is kept already: samples of the boat's cache may arrive twice."""
        if message.run != self.run or message.t_ns > self._newest_ns.get(topic, -1):
            return False
        return Sample(self.name, topic, message.t_ns, shore.encode(message)) in self.kept[topic]

    def newest(self, topic: str) -> Sample | None:
        """The newest sample of a topic."""
        return max(self.kept.get(topic, ()), key=lambda s: s.t_ns, default=None)

    def samples(self) -> Iterator[Sample]:
        """Everything kept."""
        for kept in self.kept.values():
            yield from kept

    def twin(self, now_ns: int) -> bool:
        """Whether a former run still sends: two programs use this name."""
        return self.twin_ns is not None and now_ns - self.twin_ns < TWIN_NS

    def _begin(self, run: str, ahead_ns: int, heard_ns: int) -> None:
        if self.run:
            self._former.append(self.run)
        self.run, self.newest_ns, self.ahead_ns = run, 0, ahead_ns
        self._began_ns, self.twin_ns = heard_ns, None
        self.kept.clear()
        self._newest_ns.clear()


class BoatStore:
    """All boats. `refused`: why samples were left out, counted."""

    def __init__(self) -> None:
        self.boats: dict[str, BoatRecord] = {}
        self.refused: Counter[str] = Counter()

    def take(self, boat: str, topic: str, data: bytes, heard_ns: int) -> Sample | None:
        """One sample from the wire, received at `heard_ns` of our clock; None: known, or refused and counted."""
        if len(data) > MAX_BYTES:
            return self._refuse("too long", boat)
        try:
            message = shore.decode(topic, data)
        except (ValueError, RecursionError):
            return self._refuse("not understood", boat)
        known = self._boat(boat)
        if known is None:
            return self._refuse("too many boats, or a strange name", boat)
        if known.knows(topic, message):
            return None
        return known.take(topic, message, heard_ns) or self._refuse("of a former run", boat)

    def alive(self, boat: str, is_alive: bool) -> None:
        """The boat's liveliness token appeared or disappeared."""
        if known := self._boat(boat):
            known.alive = is_alive

    def _boat(self, name: str) -> BoatRecord | None:
        if name not in self.boats and (len(self.boats) >= BOATS or not re.match(NAME, name)):
            return None
        return self.boats.setdefault(name, BoatRecord(name))

    def _refuse(self, why: str, boat: str) -> None:
        self.refused[why] += 1
        if known := self.boats.get(boat):
            known.malformed += 1
