"""GNSS: positions and velocities of an antenna.

    position   p + R(psi) l + e        e: error of the fix that wanders over minutes (satellites, troposphere, paths)
    velocity   R(psi) (nu + omega x l)

in site axes, l: lever arm in level axes. Velocity comes from Doppler shifts, so that it has no part in e. A receiver
on its own errs by metres that change slowly, one with RTK by centimetres: the same equations with other numbers.
What the file does not promise is not fused: a position of a lesser fix than `fix`, or one whose own word on its error
is `WORSE` times what the file says.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from statistics import median
from typing import Any

from companion.core.configuration.sensors import FIX_TYPES, Gnss
from companion.core.geometry.frames import Origin, geodetic_from_site, rotate, site_from_geodetic, unrotate
from companion.core.messages.sensors import GnssFix
from companion.core.sensors.sensor import (
    BodyMotion,
    ChannelReading,
    ErrorState,
    GateRule,
    PositionHealth,
    PositionWords,
    Sensor,
    SensorChannel,
    SensorCheck,
    place_of,
    rate_check,
    velocity_gate,
    velocity_of,
    within,
)

FIX_3D = 3
FASTEST_M_S = 50.0
"""No surface vessel of this kind; assumed."""
WORSE = 3.0
"""Of the error that the receiver states over that of the file; assumed: three sigma."""
FAR_M = 10_000.0
"""Places of a site file end there (`site_file.Metres`)."""
STEADY = 0.9
"""Share of the messages that have a good fix, at least; assumed."""
FIX_NAMES = {0: "no receiver", 1: "no fix", 2: "2D", 3: "3D", 4: "DGPS", 5: "RTK float", 6: "RTK fixed"}


class GnssReceiver(Sensor):
    """The receiver of a vessel file at a site with this origin."""

    key, label, messages = "gnss", "GNSS", (GnssFix,)
    words = PositionWords("GNSS led astray (reflections, jamming)", "GNSS", "GNSS positions", counts_Hz=1.0)

    def __init__(self, spec: Gnss, origin: Origin):
        self._spec, self._origin = spec, origin
        self._arm_m = spec.x_m, spec.y_m, spec.z_m
        self.rate_Hz, self.latency_s = spec.rate_Hz, spec.latency_s
        white, wander, speed = spec.position_sigma_m, spec.position_wander_sigma_m, spec.velocity_sigma_m_s
        total_m = math.hypot(white, wander)
        self._worst_m = WORSE * total_m
        self.error_states = (ErrorState(wander, wander, spec.position_wander_time_s),) * 2 if wander else ()
        # Outliers beyond the ceiling are none of a good fix; what lasts for 3 s is a new solution of the receiver.
        place = GateRule(
            limit=3.72, floor=white, ceiling=max(0.5, 6 * white, total_m), reopen_count=8, reopen_span_s=3.0,
            agreement=max(0.5, 6 * white),
        )  # fmt: skip
        self.channels = (
            SensorChannel("position", ("north", "east"), "position", self._position, white, place),
            SensorChannel("velocity", ("north", "east"), "velocity", self._velocity, speed, velocity_gate(speed)),
        )
        self.health = PositionHealth("GNSS position", 3.0, max(0.5, 2 * total_m), max(3.0, 4 * total_m))

    def _position(self, motion: BodyMotion, errors: Sequence[Any]) -> tuple[Any, ...]:
        north, east = place_of(motion, self._arm_m)
        return (north + errors[0], east + errors[1]) if errors else (north, east)

    def _velocity(self, motion: BodyMotion, errors: Sequence[Any]) -> tuple[Any, ...]:
        return rotate(motion.eta[2], *velocity_of(motion, self._arm_m))

    @staticmethod
    def screen(m: GnssFix) -> tuple[GnssFix | None, str]:
        """A fix of three dimensions with numbers that can be; a velocity beyond any boat's is left out."""
        if m.fix_type < FIX_3D:
            return None, "gnss: no fix"
        if not (within(90.0, m.lat_deg) and within(180.0, m.lon_deg)):
            return None, "gnss: not finite or absurd"
        return m, ""

    @staticmethod
    def repeatable(m: GnssFix) -> tuple[str, tuple[float, ...]] | None:
        """Position and velocity; without a fix nothing is said."""
        if m.fix_type < FIX_3D:
            return None
        return "GNSS", (m.lat_deg, m.lon_deg, m.v_north_m_s or 0.0, m.v_east_m_s or 0.0)

    def place(self, m: GnssFix) -> tuple[float, float] | None:
        """North and east of the antenna [m], if the fix is as good as the file says."""
        if m.fix_type < FIX_TYPES[self._spec.fix] or (m.h_acc_m is not None and m.h_acc_m > self._worst_m):
            return None
        return site_from_geodetic(self._origin, m.lat_deg, m.lon_deg)

    def figure(self, m: GnssFix) -> str:
        """Fix, satellites, and the receiver's own word on its error."""
        parts = [FIX_NAMES.get(m.fix_type, f"fix type {m.fix_type}")]
        parts += [] if m.satellites is None else [f"{m.satellites} satellites"]
        parts += [] if m.h_acc_m is None else [f"{m.h_acc_m:.2f} m by its own word"]
        return ", ".join(parts)

    def readings(self, m: GnssFix) -> tuple[ChannelReading, ...]:
        """Position and velocity, as far as they are fit to be fused."""
        at, north, east = self.place(m), m.v_north_m_s, m.v_east_m_s
        readings = [ChannelReading("position", at)] if at else []
        if north is not None and east is not None and within(FASTEST_M_S, north, east):
            readings.append(ChannelReading("velocity", unrotate(self._origin.rotation_rad, north, east)))
        return tuple(readings)

    def message(self, values: Mapping[str, Sequence[float]], t_ns: int) -> GnssFix:
        """A fix of the quality that the file promises."""
        spec, (n, e) = self._spec, values["position"]
        lat, lon = geodetic_from_site(self._origin, n, e)
        v_n, v_e = rotate(self._origin.rotation_rad, *values["velocity"])
        accuracy_m = math.hypot(spec.position_sigma_m, spec.position_wander_sigma_m)
        return GnssFix(
            t_ns=t_ns, t_rx_ns=t_ns, fix_type=FIX_TYPES[spec.fix], lat_deg=lat, lon_deg=lon, v_north_m_s=v_n,
            v_east_m_s=v_e, satellites=14, h_acc_m=accuracy_m, v_acc_m_s=spec.velocity_sigma_m_s,
        )  # fmt: skip

    def checks(self, heard: Sequence[GnssFix], rate_Hz: float) -> Iterator[SensorCheck]:
        """Fix, how far the antenna is from the site, how often fixes come."""
        needed, why = self._spec.fix, "there is no other position"
        if not heard:
            fix = "GPS1_TYPE of the autopilot, the receiver's cable and power; see docs/autopilot.md"
            yield SensorCheck("refuse", "fix", "no GPS_RAW_INT with a receiver", needed, why, fix)
            return
        found = self.figure(heard[-1])
        good = [m for m in heard if self.screen(m)[0] and self.place(m)]
        now, steady = bool(good) and good[-1] is heard[-1], len(good) >= STEADY * len(heard)
        found += "" if steady or not now else f"; so good in {len(good)} of {len(heard)} messages"
        fix = "open sky, time, corrections for RTK; sensors.gnss (fix, sigmas) of the vessel file"
        fix = "" if now and steady else fix
        needed = f"{needed}, at most {self._worst_m:.2f} m"
        yield SensorCheck("refuse" if not now else "ok" if steady else "warning", "fix", found, needed, why, fix)
        if now:
            north, east = (median(axis) for axis in zip(*(self.place(m) or () for m in good), strict=True))
            near = math.hypot(north, east) <= FAR_M
            yield SensorCheck(
                "ok" if near else "refuse", "place", f"north {north:.1f} m, east {east:.1f} m",
                f"within {FAR_M:g} m of the site's origin", "fence and mission are drawn about lat_deg, lon_deg",
                "" if near else "lat_deg and lon_deg of the site file: this is another water",
            )  # fmt: skip
        fix = "GPS_RATE_MS of the autopilot; sensors.gnss.rate_Hz of the vessel file"
        yield rate_check(rate_Hz, self.rate_Hz, "how often the position is renewed", fix)
