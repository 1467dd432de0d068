"""Water Linked DVL (A50, A125): `velocity` reports of its JSON protocol json_v3.1, one a line, over TCP port 16171.

    {"type":"velocity","vx":0.51,"vy":0.01,"vz":0.0,"fom":0.002,"altitude":3.2,"velocity_valid":true,
     "time_of_validity":1638191471563017,"time_of_transmission":1638191471752336, ...}

Speeds in m/s, x forward, y starboard, z down; times in us of its own clock, whose difference is the report's age.
Reports of other types (dead reckoning, answers to commands) hold no measurement. Source:
https://docs.waterlinked.com/dvl/dvl-protocol
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import msgspec

from companion.core.messages import Message
from companion.core.messages.sensors import DvlVelocity
from drivers.uwb.lines import LineSplitter

MAX_AGE_US = 1_000_000
"""A report that says it is older is not believed, and counts as of its arrival; assumed."""
LINE_LIMIT = 4096
"""[bytes]; a report with four transducers has about 700."""


class DvlReport(msgspec.Struct):
    """What is read of a report; a value may be of any type, as null where there is none."""

    type: str
    vx: Any = None
    vy: Any = None
    fom: Any = None
    altitude: Any = None
    velocity_valid: Any = False
    time_of_validity: Any = 0
    time_of_transmission: Any = 0


class DvlCodec:
    """Sans-I/O. `counters`: lines by what became of them."""

    def __init__(self) -> None:
        self.counters: Counter[str] = Counter()
        self._splitter = LineSplitter(LINE_LIMIT)

    @property
    def understood(self) -> int:
        """Reports so far, of whatever type."""
        return self.counters.total() - self.counters["garbage"]

    def start_bytes(self) -> list[bytes]:
        """Forget half a line. It reports unasked."""
        self._splitter.clear()
        return []

    def step(self, t_ns: int) -> list[bytes]:
        """Nothing has to be said to it."""
        return []

    def feed(self, data: bytes, t_ns: int) -> list[Message]:
        """DvlVelocity messages completed by bytes that arrived at `t_ns`. Never raises."""
        messages: list[Message] = []
        for line in self._splitter.push(data):
            try:
                report = msgspec.json.decode(line or b"", type=DvlReport)
            except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
                self.counters["garbage"] += 1
                continue
            self.counters[report.type if report.type == "velocity" else "ignored"] += 1
            if report.type == "velocity":
                messages.append(_message(report, t_ns))
        return messages


def _message(report: DvlReport, t_rx_ns: int) -> DvlVelocity:
    sent_us, valid_us = _number(report.time_of_transmission), _number(report.time_of_validity)
    age_us = 0.0 if sent_us is None or valid_us is None else sent_us - valid_us
    x_m_s, y_m_s = _number(report.vx), _number(report.vy)
    return DvlVelocity(
        t_ns=t_rx_ns - round(1000 * age_us) if 0 <= age_us <= MAX_AGE_US else t_rx_ns, t_rx_ns=t_rx_ns,
        x_m_s=x_m_s or 0.0, y_m_s=y_m_s or 0.0,
        valid=report.velocity_valid is True and x_m_s is not None and y_m_s is not None,
        altitude_m=_number(report.altitude), fom_m_s=_number(report.fom),
    )  # fmt: skip


def _number(value: object) -> float | None:
    """A number of JSON that is not beyond all measure; times in us are exact until the year 2255."""
    if isinstance(value, bool) or not isinstance(value, int | float) or abs(value) >= 2**63:
        return None
    return float(value)


def encode_report(m: DvlVelocity) -> bytes:
    """The report that a log sends for a message (simulator)."""
    report = DvlReport(
        type="velocity", vx=m.x_m_s, vy=m.y_m_s, fom=m.fom_m_s, altitude=m.altitude_m, velocity_valid=m.valid,
        time_of_validity=m.t_ns // 1000, time_of_transmission=m.t_rx_ns // 1000,
    )  # fmt: skip
    return msgspec.json.encode(report) + b"\r\n"
