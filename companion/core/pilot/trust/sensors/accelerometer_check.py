"""An accelerometer that shakes as no boat does, or that stands still while the gyro beside it says that the boat turns.

    s' = s + dt / 2 s (e - s)      e = min(max(0, (|da_x| + |da_y|) / 2 - 10 m/s^3 dt), 2 m/s^2)      shakes: s > 0.5

da: from one sample to the next. One that shakes is told; the filter counts it for as little as its noise says
(`estimation.inertial`). One that stands still is left out until the next start: the filter misses it as one that is
silent.
"""

from __future__ import annotations

import msgspec
from msgspec.structs import replace

from companion.core.configuration.sensors import Imu
from companion.core.messages import Alert, ImuSample, OperatorCommand
from companion.core.pilot.monitors.monitor import NOTHING, Monitor, MonitorReport
from companion.core.pilot.trust.verdict import Finding, is_forgotten

JERK_M_S3, JOLT_M_S2, MEAN_S = 10.0, 2.0, 2.0
"""Thrusters with their lag, and waves, change the specific force of a small boat by less than the first. A blow against
a pier lasts some samples, each of which counts for `JOLT_M_S2` at most. Assumed."""
SHAKES_M_S2, SIGMAS = 0.5, 4.0
"""What is left of 0.6 m/s^2 of noise; of an IMU whose file says more, so many sigma. Assumed."""
SAME_NS, TURNED_RAD_S, LIVELY = 1_000_000_000, 0.02, 0.8
"""So long the same to the last digit while the gyro changes by 20 of its own, of an accelerometer that had changed with
so many of its samples until then (noise alone is five digits; that of a simulator may be less than one). Assumed."""
GAP_NS = 500_000_000
"""Two samples farther apart have nothing to do with each other; assumed."""


class AccelerometerState(msgspec.Struct, frozen=True):
    """`last`: the latest sample; `shakes_m_s2`: mean change beyond what a boat does; `first`: of samples whose specific
    force is the same as that of the last one; `life`: share of samples that were not the same as the one before.
    """

    last: ImuSample | None = None
    first: ImuSample | None = None
    shakes_m_s2: float = 0.0
    life: float = 0.0
    findings: tuple[Finding, ...] = ()

    @property
    def left_out(self) -> bool:
        """Whether it stands still."""
        return any(not f.bearable for f in self.findings)


class AccelerometerMonitor(Monitor[AccelerometerState]):
    """Withholds the samples of an accelerometer that stands still; each fault is told once."""

    hears = (ImuSample, OperatorCommand)
    screens = True
    initial = AccelerometerState()

    def __init__(self, imu: Imu):
        self._limit_m_s2 = max(SHAKES_M_S2, SIGMAS * imu.accel_sigma_m_s2)

    def on_message(
        self, state: AccelerometerState, message: ImuSample | OperatorCommand, t_ns: int
    ) -> tuple[AccelerometerState, MonitorReport]:
        """One sample; a new start forgets what was found."""
        if isinstance(message, OperatorCommand):
            return (self.initial if is_forgotten(state.findings, message) else state), NOTHING
        if state.left_out:
            return state, MonitorReport(withhold=True)
        last, first = state.last, state.first
        if last is None or first is None or not 0 < (dt_ns := message.t_ns - last.t_ns) < GAP_NS:
            return replace(state, last=message, first=message), NOTHING
        state = replace(state, last=message, shakes_m_s2=_shaken(state.shakes_m_s2, last, message))
        if _force(message) != _force(last):
            state = replace(state, first=message, life=_lived(state.life, message.t_ns - first.t_ns, dt_ns))
            first = message
        if state.life >= LIVELY and _hangs(first, message):
            said = "the same reading for 1 s though the boat turns"
            text = f"the accelerometer is wrong ({said}): left out until the next start"
            state = replace(state, findings=(*state.findings, Finding("sensor", "accel", text, t_ns)))
            return state, MonitorReport(alerts=(Alert(t_ns=t_ns, level="error", text=text),), withhold=True)
        if state.shakes_m_s2 > self._limit_m_s2 and not state.findings:
            said = f"it shakes by {state.shakes_m_s2:.1f} m/s^2 from sample to sample as no boat does"
            text = f"the accelerometer is wrong ({said}): it counts for less; is the autopilot mounted firmly?"
            state = replace(state, findings=(Finding("sensor", "accel", text, t_ns, bearable=True),))
            return state, MonitorReport(alerts=(Alert(t_ns=t_ns, level="warning", text=text),))
        return state, NOTHING


def _shaken(before_m_s2: float, last: ImuSample, now: ImuSample) -> float:
    """The mean after one more sample."""
    dt_s = (now.t_ns - last.t_ns) * 1e-9
    change = (abs(now.ax_m_s2 - last.ax_m_s2) + abs(now.ay_m_s2 - last.ay_m_s2)) / 2
    beyond = min(max(0.0, change - JERK_M_S3 * dt_s), JOLT_M_S2)
    return before_m_s2 + min(1.0, dt_s / MEAN_S) * (beyond - before_m_s2)


def _force(m: ImuSample) -> tuple[float, float, float]:
    return m.ax_m_s2, m.ay_m_s2, m.az_m_s2


def _lived(before: float, same_ns: int, dt_ns: int) -> float:
    """The share after a sample that differs from those of the last `same_ns`; mean over `MEAN_S`."""
    gain = min(1.0, same_ns * 1e-9 / MEAN_S)
    return before + gain * (dt_ns / same_ns - before)


def _hangs(first: ImuSample, now: ImuSample) -> bool:
    """Whether the specific force, the same since `first`, should have changed: the gyro beside it did."""
    turned = (now.p_rad_s - first.p_rad_s, now.q_rad_s - first.q_rad_s, now.r_rad_s - first.r_rad_s)
    return now.t_ns - first.t_ns >= SAME_NS and max(map(abs, turned)) >= TURNED_RAD_S
