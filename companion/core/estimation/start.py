"""Initialisation of the filter: heading from the autopilot; position from the boat's sensor of positions, of ranges by
multilateration.

Ranges of several cycles must agree on one place, the boat drifting, so that reflections start nothing; two fixes in a
row of a sensor of positions. Where anchors on a line leave two places, the one within the fence is taken; where that
does not decide, the filter waits and gives the reason.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import zip_longest

import msgspec
import numpy as np

from companion.core.configuration.sensors import Sensors
from companion.core.configuration.site_file import Site
from companion.core.estimation.filter_state import (
    B_ACCEL,
    B_GYRO_XYZ,
    B_PSI,
    B_RANGE,
    GYRO_DRIFT,
    LATENT,
    LATENT_INDICES,
    NU_INDICES,
    TILT,
    FilterState,
    Tilt,
)
from companion.core.estimation.gates import OPEN, Gate
from companion.core.estimation.ranging.multilateration import multilaterate
from companion.core.estimation.ranging.ranges import (
    FIX_SIGMA_M,
    PLACE_SIGMA_M,
    AnchorHistory,
    decorrelate,
)
from companion.core.estimation.tuning import EstimatorTuning
from companion.core.geometry.frames import origin_position, to_level
from companion.core.messages import Attitude, Measured, UwbRanges
from companion.core.model.sensor_errors import correct_uwb_scale
from companion.core.sensors.table import SensorTable

MIRROR_COST = 6.0
"""A second position that costs so much more than the best is discarded; assumed (log of weights)."""
READINGS, READINGS_NS = 5, 6_000_000_000
"""So many ranges of an anchor, none older, are compared; assumed."""
ENOUGH, SHARE = 8, 0.6
"""Of so many ranges, of three anchors, so large a share must agree on a place: two cycles of four anchors. Assumed."""


@dataclass(frozen=True, slots=True)
class FilterStart:
    """What is known before the filter runs. `readings`: the last ranges of each anchor, the newest first; `heading`:
    None if it is left out; `fix`: (t_ns, north, east) of the body origin by a sensor of positions; `imu_ns`: the last
    IMU sample before a gap that ended the filter before this one.
    """

    readings: tuple[tuple[AnchorHistory, ...], ...]
    heading: Attitude | None = None
    fix: tuple[int, float, float] | None = None
    reason: str = ""
    imu_ns: int | None = None


class Starter:
    """Constant parts of the start; `take` is pure."""

    def __init__(self, site: Site, sensors: Sensors, tuning: EstimatorTuning, table: SensorTable):
        self._site, self._sensors, self._tuning, self._table = site, sensors, tuning, table
        self._errors = [error for sensor in table for error in sensor.error_states]
        self._label = table.position.label
        self._number = {a.id: i for i, a in enumerate(site.anchors)}
        self._anchors_m = site.anchors_m

    def initial(self, imu_ns: int | None = None) -> FilterStart:
        """Nothing known, but for when the filter before had its last IMU sample."""
        return FilterStart(((),) * len(self._number), reason=f"waiting for heading and {self._label}", imu_ns=imu_ns)

    def take(
        self, start: FilterStart, t_ns: int, m: Measured, f_n: np.ndarray
    ) -> tuple[FilterStart, FilterState | None]:
        """What is known after a message, and the first belief once there is enough."""
        if isinstance(m, Attitude):
            return replace(start, heading=None if math.isnan(m.psi_rad) else m), None
        recent = (tuple(r for r in each if t_ns - r.t_ns <= READINGS_NS) for each in start.readings)
        start = replace(start, readings=tuple(recent))
        if isinstance(m, UwbRanges):
            readings = list(start.readings)
            for i, range_m in ((self._number[r.anchor], r.range_m) for r in m.ranges if r.anchor in self._number):
                readings[i] = (AnchorHistory(t_ns, range_m), *readings[i])[:READINGS]
            start = replace(start, readings=tuple(readings))
            place = self._place(start, t_ns)
            if isinstance(place, str):
                return replace(start, reason=place), None
            return self._begin(start, t_ns, place, FIX_SIGMA_M, f_n)
        place = sensor.place(m) if (sensor := self._table.of(m)) else None
        if place and not any(start.readings):
            return self._begin(start, t_ns, place, PLACE_SIGMA_M, f_n)
        return start, None

    def _place(self, start: FilterStart, t_ns: int) -> tuple[float, float] | str:
        """The tag's place [m], or why there is none."""
        recent = [
            (i, (t_ns - seen.t_ns) * 1e-9, seen.range_m)
            for each in zip_longest(*start.readings)
            for i, seen in enumerate(each)
            if seen
        ]
        if (anchors := len({i for i, _, _ in recent})) < 3:
            return f"{anchors} of the 3 anchors that a start needs are in range"
        if len(recent) < ENOUGH:
            return f"{len(recent)} of the {ENOUGH} ranges that a start needs have come"
        use, age_s, ranges_m = (np.array(column) for column in zip(*recent, strict=True))
        fixes = multilaterate(
            self._anchors_m[use], ranges_m, self._sensors.tag.z_m, self._tuning.fix_spread_m, age_s=age_s
        )
        good = [
            f
            for f in fixes
            if f.inliers.mean() >= SHARE and len(set(use[f.inliers])) >= 3 and f.cost <= fixes[0].cost + MIRROR_COST
        ]
        if len(good) > 1:
            good = [f for f in good if self._site.inside(f.north_m, f.east_m)]
        if len(good) != 1:
            return f"{len(good)} places explain the ranges"
        return correct_uwb_scale(self._sensors.tag, good[0].north_m, good[0].east_m)

    def _begin(
        self, start: FilterStart, t_ns: int, place: tuple[float, float], sigma_m: float, f_n: np.ndarray
    ) -> tuple[FilterStart, FilterState | None]:
        """The first belief at a place, if there is a heading; of a sensor of positions, if a fix before agrees."""
        heading = start.heading
        if heading is None or t_ns - heading.t_ns > self._tuning.imu_timeout_s * 1e9:
            return replace(start, reason="no heading from the autopilot"), None
        turned = (t_ns - heading.t_ns) * 1e-9 * heading.r_rad_s
        heading = msgspec.structs.replace(heading, psi_rad=heading.psi_rad + turned)
        u, tilt = self._sensors.position, Tilt(heading.phi_rad, heading.theta_rad)
        arm = to_level(*tilt, u.x_m, u.y_m, u.z_m)
        north, east = origin_position(place, heading.psi_rad, (arm[0], arm[1]))
        if not any(start.readings):
            before, start = start.fix, replace(start, fix=(t_ns, north, east), reason="waiting for a second fix")
            if before is None or t_ns <= before[0]:
                return start, None
            if np.hypot(north - before[1], east - before[2]) > self._tuning.start_agreement_m:
                return replace(start, reason=f"two fixes of {self._label} in a row disagree"), None
        return start, self._belief(t_ns, (north, east), sigma_m, heading, tilt, f_n, start.imu_ns)

    def _belief(
        self, t_ns: int, origin_m: tuple[float, float], sigma_m: float, heading: Attitude, tilt: Tilt, f_n: np.ndarray,
        imu_ns: int | None,
    ) -> FilterState:  # fmt: skip
        """First belief: at the fix, at rest; heading and its wander correlated as one reading leaves them."""
        imu, tuning, m = self._sensors.imu, self._tuning, len(self._number)
        errors = np.array([error.sigma for error in self._errors])
        x, sigma = np.zeros(B_RANGE + len(errors)), np.zeros(B_RANGE + len(errors))
        x[:2], x[2], x[5], x[TILT] = origin_m, heading.psi_rad, heading.r_rad_s, tilt
        sigma[:2] = max(sigma_m, 2 * errors.max(initial=0.0))
        sigma[2] = np.hypot(imu.heading_sigma_rad, imu.heading_wander_sigma_rad)
        sigma[3:5], sigma[5] = tuning.start_velocity_sigma_m_s, tuning.start_rate_sigma_rad_s
        sigma[LATENT] = tuning.latent_sigma
        sigma[B_ACCEL], sigma[TILT] = imu.accel_bias_sigma_m_s2, tuning.start_tilt_sigma_rad
        sigma[B_GYRO_XYZ], sigma[GYRO_DRIFT] = imu.gyro_bias_sigma_rad_s, tuning.gyro_drift_sigma_rad_s2
        sigma[B_PSI], sigma[B_RANGE:] = imu.heading_wander_sigma_rad, errors
        P = np.diag(sigma**2)
        P[2, B_PSI] = P[B_PSI, 2] = -(imu.heading_wander_sigma_rad**2)
        rates = (heading.p_rad_s, heading.q_rad_s, heading.r_rad_s)
        return FilterState(
            t_ns=t_ns, x=x, P=P, f_n=f_n, rates_rad_s=rates, rates_ns=t_ns, anchor_gates=(Gate(),) * m,
            heading_gate=Gate(heading.t_ns), position_gates=(Gate(), Gate()), latest=(None,) * m, imu_ns=imu_ns,
            position_ns=t_ns, ranges_ns=None, since_ns=t_ns,
        )  # fmt: skip


def after_gap(belief: FilterState, tuning: EstimatorTuning) -> FilterState:
    """The filter state after a gap in all sensors: whatever drove or pushed the boat, its speed is that of any boat.

    Velocity is as unknown as at a start, and no more: a prediction over seconds gives it a sigma of up to 3 m/s, which
    no boat has, and over which no equation is linear.
    Where yaw is less certain than a heading's gate is wide, the next heading is believed.
    """
    sigma = tuning.start_velocity_sigma_m_s, tuning.start_velocity_sigma_m_s, tuning.start_rate_sigma_rad_s
    P = decorrelate(belief.P, (*NU_INDICES, *LATENT_INDICES))
    P[NU_INDICES, NU_INDICES] = np.square(sigma)
    gate = OPEN if P[2, 2] > tuning.heading_gate.ceiling**2 else belief.heading_gate
    return msgspec.structs.replace(belief, P=P, heading_gate=gate, since_ns=belief.t_ns, fixes=0, settled=False)


def counted(before: FilterState, after: FilterState, away_s: float) -> FilterState:
    """The filter state after a message that aids, its position counted if it was accepted.

    The first one after `away_s` without begins the count and the time anew, unless speed was known before: time alone
    tells nothing about it.
    """
    if after.position_ns != after.t_ns:
        return after
    if not before.settled and after.t_ns - before.position_ns > away_s * 1e9:
        return msgspec.structs.replace(after, since_ns=after.t_ns, fixes=1)
    return msgspec.structs.replace(after, fixes=after.fixes + 1)
