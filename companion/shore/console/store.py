"""Telemetry of all boats, validated: newest values, bounded history, age of each boat's last sample. Pure.

Samples come in any order (history and what was missed arrive beside what is new), from runs that ended, from boats
that started anew, from two programs of one name, and from strangers; what is not a sample of docs/telemetry.md is
counted and left out. Each run of a name is kept by itself. Shown is one of them, until it has been silent for 3 s: a
sample of another run takes nothing away from it, and a run that was away may come back.
"""

from __future__ import annotations

import re
from collections import Counter, deque
from collections.abc import Iterator
from typing import NamedTuple

from companion.core.telemetry import structs as shore
from companion.core.telemetry.order_sender import Place, RunClock

KEPT = {
    "state": 1200, "thrusters": 1200, "reference": 600, "attitude": 240, "timing": 600, "battery": 600, "mode": 200,
    "alert": 200,
}  # fmt: skip
"""Topic -> samples kept: two minutes of those with a rate, ten of what comes each second (assumed). Of the others the
newest."""
THINNED, THIN_NS, OLDER = ("state", "thrusters", "reference", "attitude"), 1_000_000_000, 480
"""Topics of which one sample a second is kept for so many seconds more: ten minutes for a page that opens (assumed)."""
BOATS = 200
"""More names than that are a mistake or an attack (assumed)."""
RUNS = 4
"""Runs of one name that are kept at a time (assumed)."""
SILENT_NS = 3_000_000_000
"""A run that was not heard for so long has ended, or is out of reach: another may be shown (assumed)."""
LATE_NS = 2_000_000_000
"""What arrives so long after another run began need not have been sent since (assumed)."""
MAX_BYTES = 65_536
NAME = r"^[A-Za-z0-9_.-]{1,40}\Z"
"""Names of boats, as in the run file."""


class Sample(NamedTuple):
    """One valid telemetry struct; `data`: its JSON, encoded anew."""

    boat: str
    topic: str
    t_ns: int
    data: bytes


class RunRecord:
    """One run of a boat's program: its samples and its clock. `first_ns`, `last_ns`: when it was heard, our clock."""

    def __init__(self, run: str, t_ns: int, heard_ns: int) -> None:
        self.run, self.clock = run, RunClock(t_ns, heard_ns)
        self.kept: dict[str, deque[Sample]] = {}
        self.older: dict[str, deque[Sample]] = {topic: deque(maxlen=OLDER) for topic in THINNED}
        self.newest_ns = 0
        self.first_ns = self.last_ns = heard_ns
        self._newest_ns: dict[str, int] = {}

    def take(self, boat: str, topic: str, message: shore.ShoreMessage, heard_ns: int) -> Sample | None:
        """Note one sample; None: it is kept already, for those of the boat's cache may arrive twice."""
        self.last_ns = heard_ns
        sample = Sample(boat, topic, message.t_ns, shore.encode(message))
        kept = self.kept.setdefault(topic, deque(maxlen=KEPT.get(topic, 1)))
        if message.t_ns <= self._newest_ns.get(topic, -1) and sample in kept:
            return None
        self.clock.hear(message.t_ns, heard_ns)
        self.newest_ns = max(self.newest_ns, message.t_ns)
        self._newest_ns[topic] = max(message.t_ns, self._newest_ns.get(topic, -1))
        if kept.maxlen != 1 or not kept or kept[-1].t_ns <= message.t_ns:
            self._thin(topic, kept)
            kept.append(sample)
        return sample

    def _thin(self, topic: str, kept: deque[Sample]) -> None:
        """Before the oldest sample goes: one a second stays."""
        if topic in self.older and len(kept) == kept.maxlen:
            older = self.older[topic]
            if not older or kept[0].t_ns - older[-1].t_ns >= THIN_NS:
                older.append(kept[0])

    def overlaps(self, other: RunRecord) -> bool:
        """Whether both were heard at one time: the one that began first still sent when the other had begun."""
        first, second = sorted((self, other), key=lambda r: r.first_ns)
        return first.last_ns - second.first_ns >= LATE_NS


class BoatRecord:
    """One boat's name: the runs heard under it, of which one is shown.

    `problem`: what is wrong with its key file; `no_orders`: why it can be given no orders, a missing key included.
    """

    def __init__(self, name: str, heard_ns: int = 0) -> None:
        self.name, self.alive, self.malformed = name, False, 0
        self.problem = self.no_orders = ""
        self.heard_ns = heard_ns
        self._runs: dict[str, RunRecord] = {}
        self._shown = RunRecord("", 0, 0)

    @property
    def run(self) -> str:
        """The run that is shown; empty: none was heard."""
        return self._shown.run

    @property
    def kept(self) -> dict[str, deque[Sample]]:
        """Samples of the run that is shown, by topic."""
        return self._shown.kept

    @property
    def newest_ns(self) -> int:
        """The newest stamp of the run that is shown."""
        return self._shown.newest_ns

    @property
    def ahead_ns(self) -> int:
        """Its clock minus ours; its error is the least transit time."""
        return self._shown.clock.ahead_ns

    def take(self, topic: str, message: shore.ShoreMessage, heard_ns: int) -> Sample | None:
        """Note one sample; None: known, or not of the run that is shown."""
        self.heard_ns = heard_ns
        record = self._runs.get(message.run)
        if record is None:
            self._make_room()
            record = self._runs[message.run] = RunRecord(message.run, message.t_ns, heard_ns)
        silent = record is not self._shown and heard_ns - self._shown.last_ns > SILENT_NS
        if silent or not self._shown.run:
            self._shown = record
        sample = record.take(self.name, topic, message, heard_ns)
        return sample if record is self._shown else None

    def newest(self, topic: str) -> Sample | None:
        """The newest sample of a topic."""
        return max(self.kept.get(topic, ()), key=lambda s: s.t_ns, default=None)

    def samples(self) -> Iterator[Sample]:
        """Everything kept of the run that is shown; of each topic the older ones first."""
        for kept in (*self._shown.older.values(), *self.kept.values()):
            yield from kept

    def runs(self, now_ns: int) -> tuple[str, ...]:
        """Runs that speak at present: that which is shown, and any beside it. More than one share the name."""
        shown = self._shown
        if not shown.run or now_ns - shown.last_ns >= SILENT_NS:
            return ()
        others = (r for r in self._runs.values() if r is not shown and now_ns - r.last_ns < SILENT_NS)
        return (shown.run, *(r.run for r in others if r.overlaps(shown)))

    def place(self, now_ns: int) -> Place | None:
        """What a stop is made out for at first; None: nothing was heard, or it is not known of whom."""
        return Place(self.run, now_ns + self.ahead_ns) if self.run and len(self.runs(now_ns)) < 2 else None

    def _make_room(self) -> None:
        if len(self._runs) >= RUNS:
            others = (r for r in self._runs.values() if r is not self._shown)
            del self._runs[min(others, key=lambda r: r.last_ns).run]


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
        known = self._boat(boat, heard_ns)
        if known is None:
            return self._refuse("a strange name", boat)
        sample = known.take(topic, message, heard_ns)
        if sample is None and message.run != known.run:
            return self._refuse("of another run", boat)
        return sample

    def alive(self, boat: str, is_alive: bool, heard_ns: int = 0) -> None:
        """The boat's liveliness token appeared or disappeared."""
        if known := self._boat(boat, heard_ns):
            known.alive = is_alive

    def _boat(self, name: str, heard_ns: int) -> BoatRecord | None:
        """Where there are too many, the one that was silent longest is forgotten."""
        if name not in self.boats:
            if not re.match(NAME, name):
                return None
            if len(self.boats) >= BOATS:
                del self.boats[min(self.boats.values(), key=lambda b: b.heard_ns).name]
            self.boats[name] = BoatRecord(name, heard_ns)
        return self.boats[name]

    def _refuse(self, why: str, boat: str) -> None:
        self.refused[why] += 1
        if known := self.boats.get(boat):
            known.malformed += 1
