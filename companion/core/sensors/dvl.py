"""Doppler velocity log: velocity over ground of its place in the hull, in its own axes.

z = R(azimuth)^T (nu + omega x l)        l: lever arm in level axes; roll and pitch small
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from companion.core.configuration.sensors import Dvl
from companion.core.geometry.frames import unrotate
from companion.core.messages.sensors import DvlVelocity
from companion.core.sensors.sensor import (
    BodyMotion,
    ChannelReading,
    Sensor,
    SensorChannel,
    SensorCheck,
    rate_check,
    velocity_gate,
    velocity_of,
    verdict,
    within,
)

FASTEST_M_S = 15.0
"""Beyond what such logs measure; assumed."""


class DopplerLog(Sensor):
    """The log of a vessel file."""

    key, label, messages = "dvl", "DVL", (DvlVelocity,)

    def __init__(self, spec: Dvl):
        self._arm_m, self._azimuth_rad = (spec.x_m, spec.y_m, spec.z_m), math.radians(spec.azimuth_deg)
        self.rate_Hz, self.latency_s = spec.rate_Hz, spec.latency_s
        sigma, axes = spec.velocity_sigma_m_s, ("ahead", "starboard")
        self.channels = (SensorChannel("speed", axes, "velocity", self._speed, sigma, velocity_gate(sigma)),)

    def _speed(self, motion: BodyMotion, errors: Sequence[Any]) -> tuple[Any, ...]:
        return unrotate(self._azimuth_rad, *velocity_of(motion, self._arm_m))

    @staticmethod
    def screen(m: DvlVelocity) -> tuple[DvlVelocity | None, str]:
        """Bottom in sight, and a speed that can be."""
        if not m.valid:
            return None, "dvl: no bottom"
        return verdict(m, within(FASTEST_M_S, m.x_m_s, m.y_m_s), "dvl")

    @staticmethod
    def repeatable(m: DvlVelocity) -> tuple[str, tuple[float, ...]] | None:
        """Both components, while it sees the bottom."""
        return ("DVL", (m.x_m_s, m.y_m_s)) if m.valid else None

    def readings(self, m: DvlVelocity) -> tuple[ChannelReading, ...]:
        """The velocity."""
        return (ChannelReading("speed", (m.x_m_s, m.y_m_s)),)

    def message(self, values: Mapping[str, Sequence[float]], t_ns: int) -> DvlVelocity:
        """A report over ground three metres below (assumed)."""
        x, y = values["speed"]
        return DvlVelocity(t_ns=t_ns, t_rx_ns=t_ns, x_m_s=x, y_m_s=y, valid=True, altitude_m=3.0, fom_m_s=0.01)

    def figure(self, m: DvlVelocity) -> str:
        """Whether it sees the bottom, and how far below."""
        depth = "" if m.altitude_m is None else f", {m.altitude_m:.1f} m above it"
        return f"sees the bottom{depth}" if m.valid else "does not see the bottom"

    def checks(self, heard: Sequence[DvlVelocity], rate_Hz: float) -> Iterator[SensorCheck]:
        """Bottom in sight, and how often it reports. The boat drives without it, by its position alone."""
        seen = sum(m.valid for m in heard) > len(heard) / 2
        found = self.figure(heard[-1]) if heard else "no report"
        fix = "" if seen else "devices.dvl.url of the run file, power; deep enough water, no air below the transducers"
        yield SensorCheck(
            "ok" if seen else "warning", "bottom", found, "the bottom in sight", "it holds the speed", fix
        )
        fix = "its own settings (range mode); sensors.dvl.rate_Hz of the vessel file"
        yield rate_check(rate_Hz, self.rate_Hz, "how often the speed is renewed", fix)
