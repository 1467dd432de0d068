"""Message rates: ask for them, measure what comes, ask again with back-off, and say why it may be too little.

ArduPilot streams at most 80 % of SCHED_LOOP_RATE (default 50 Hz, so 40 Hz); 4.6 caps silently, 4.7 denies
(observed). So from the third request on 80 % of the wanted rate is asked for, which both grant at a loop as
fast as the stream.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from companion.core.configuration.sensors import Sensors

WANTED_HZ: dict[str, float] = {
    "ATTITUDE": 50.0,
    "RAW_IMU": 50.0,
    "AHRS": 10.0,
    "SERVO_OUTPUT_RAW": 10.0,
    "RC_CHANNELS": 6.5,  # no divisor of the control period: a second sender between two of our overrides shows
    "SYS_STATUS": 2.0,
}
"""Message type -> rate that the companion lives on (architecture: estimator at 30-50 Hz)."""


def wanted_hz(sensors: Sensors) -> dict[str, float]:
    """`WANTED_HZ`, and what the sensors behind the autopilot of this boat need."""
    return {**WANTED_HZ, **({"GPS_RAW_INT": sensors.gnss.rate_Hz} if sensors.gnss else {})}


LOOP_SHARE = 0.8
ENOUGH = 0.65
"""Share of the wanted rate that is good enough: a parameter download slows 50 to 34 Hz (observed)."""
WINDOW_NS = 3_000_000_000
MAX_WINDOW_NS = 30_000_000_000


class Request(NamedTuple):
    """Ask for message type `name` at `rate_hz`."""

    name: str
    rate_hz: float


@dataclass(slots=True)
class _Stream:
    wanted_hz: float
    asked: int = 0
    since_ns: int = 0
    count: int = 0
    window_ns: int = 0


class Streams:
    """Keeps every wanted stream at its rate. `wanted_hz`: message type -> rate."""

    def __init__(self, wanted_hz: Mapping[str, float] = WANTED_HZ) -> None:
        self._streams = {name: _Stream(rate_hz) for name, rate_hz in wanted_hz.items()}

    def restart(self) -> None:
        """The autopilot has forgotten everything: ask for all at the next `step`."""
        self._streams = {name: _Stream(s.wanted_hz) for name, s in self._streams.items()}

    def step(self, received: Callable[[str], int], t_ns: int) -> tuple[list[Request], list[str]]:
        """Requests due at `t_ns` and warnings. `received`: message type -> how many have come so far."""
        requests: list[Request] = []
        warnings: list[str] = []
        for name, s in self._streams.items():
            elapsed_ns = t_ns - s.since_ns
            if s.asked and elapsed_ns < s.window_ns:
                continue
            count = received(name)
            if not s.asked:
                s.asked, s.window_ns = 1, WINDOW_NS
                requests.append(Request(name, s.wanted_hz))
            else:
                elapsed_s = elapsed_ns * 1e-9
                enough = ENOUGH * s.wanted_hz * elapsed_s - 1  # of a slow stream one is on its way
                if count - s.count >= max(1, enough):
                    s.asked, s.window_ns = 1, WINDOW_NS
                else:
                    if s.asked > 1:
                        warnings.append(_warning(name, (count - s.count) / elapsed_s, s.wanted_hz))
                    s.asked += 1
                    s.window_ns = min(2 * s.window_ns, MAX_WINDOW_NS)
                    share = LOOP_SHARE if s.asked > 2 else 1.0
                    requests.append(Request(name, share * s.wanted_hz))
            s.count, s.since_ns = count, t_ns
        return requests, warnings


def _warning(name: str, rate_hz: float, wanted_hz: float) -> str:
    loop_hz = math.ceil(wanted_hz / LOOP_SHARE)
    return (
        f"{name} comes at {rate_hz:.1f} Hz, {wanted_hz:g} Hz wanted: asking again. If it stays so, set the "
        f"autopilot's SCHED_LOOP_RATE to 200 (it streams at most 80 % of it, so {loop_hz} is the least), "
        "or the link is too slow"
    )
