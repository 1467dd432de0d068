"""Heading against yaw rate: what the heading turned over one and over five seconds is what the gyro adds up to.

    e = (psi_2 - psi_1) - integral r dt      |e| > 0.12 rad + 5 % of the turn, three ticks in a row: they contradict

Which of the two is wrong is asked of a third: the yaw rate that the commanded moment makes of the model alone.
A heading that jumps farther than any boat turns is left out at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from msgspec.structs import replace as struct_replace

from companion.core.configuration.sensors import Sensors
from companion.core.estimation.filter_state import Tilt
from companion.core.estimation.tilt import yaw_rate
from companion.core.geometry.frames import ssa
from companion.core.messages import Alert, Attitude, OperatorCommand
from companion.core.pilot.monitors.monitor import NOTHING, Monitor, MonitorReport, TickView
from companion.core.pilot.trust.verdict import Finding
from companion.core.sensors.inertial import AttitudeSensor

LIMIT_RAD, SHARE = 0.12, 0.05
"""Four sigma of heading noise (0.005) and wander (0.012 rad) and a yaw reset of 3 degrees; a gyro's gain. Assumed."""
WINDOWS_S = (1.0, 5.0)
TICKS = 3
JUMP_RAD = 0.35
"""From one message to the next beyond what the gyro says: no boat; assumed."""
UNCHANGED_RAD = 1e-6
"""A heading that turned by less has not been measured at all."""
GAP_NS = 500_000_000


@dataclass(frozen=True)
class Turn:
    """Sums since switch-on at `t_ns`: heading unwrapped, yaw rate and the model's yaw rate added up [rad]."""

    t_ns: int
    psi_rad: float
    gyro_rad: float
    model_rad: float


@dataclass(frozen=True)
class HeadingState:
    """`now`: the sums; `past`: at the last ticks; `contradicted`: ticks in a row; `jumped`: heading is left out."""

    now: Turn | None = None
    past: tuple[Turn, ...] = ()
    contradicted: int = 0
    jumped: bool = False
    findings: tuple[Finding, ...] = ()


class HeadingMonitor(Monitor[HeadingState]):
    """Condition `untrusted` while heading and yaw rate contradict each other."""

    hears = (Attitude, OperatorCommand)
    screens = True
    initial = HeadingState()

    def __init__(self, sensors: Sensors, rotation_rad: float):
        """`rotation_rad`: of the site's axes, in which what the file knows of the compass counts."""
        self._sensor, self._rotation_rad = AttitudeSensor(sensors.imu), rotation_rad

    def on_message(
        self, state: HeadingState, message: Attitude | OperatorCommand, t_ns: int
    ) -> tuple[HeadingState, MonitorReport]:
        """Add up one attitude; a new start forgets what was found."""
        if isinstance(message, OperatorCommand):
            return (HeadingState() if state.findings and message.command != "stop" else state), NOTHING
        if self._sensor.screen(message)[0] is None or math.isnan(message.psi_rad):
            return state, NOTHING
        before, alerts = state.now, ()
        in_site = struct_replace(message, psi_rad=ssa(message.psi_rad - self._rotation_rad))
        sensed = self._sensor.correct(in_site)  # what the file knows of the sensors contradicts nothing
        if before is None or sensed.t_ns - before.t_ns > GAP_NS or sensed.t_ns <= before.t_ns:
            return replace(state, now=Turn(sensed.t_ns, sensed.psi_rad, 0.0, 0.0), past=(), contradicted=0), NOTHING
        dt_s = (sensed.t_ns - before.t_ns) * 1e-9
        tilt = Tilt(sensed.phi_rad, sensed.theta_rad)
        turn, by_gyro = ssa(sensed.psi_rad - before.psi_rad), yaw_rate(tilt, sensed.q_rad_s, sensed.r_rad_s) * dt_s
        now = Turn(sensed.t_ns, before.psi_rad + turn, before.gyro_rad + by_gyro, before.model_rad)
        if not state.jumped and abs(turn - by_gyro) > JUMP_RAD:
            text = f"heading jumped by {math.degrees(turn):.0f} degrees: left out until the next start (compass?)"
            alerts = (Alert(t_ns=t_ns, level="error", text=text),)
            finding = Finding("sensor", "heading", text, t_ns)
            state = replace(state, jumped=True, past=(), findings=(*state.findings, finding))
        instead = struct_replace(message, psi_rad=math.nan) if state.jumped else None
        return replace(state, now=now), MonitorReport(alerts=alerts, instead=instead)

    def on_tick(self, state: HeadingState, view: TickView) -> tuple[HeadingState, MonitorReport]:
        """Compare over the windows."""
        if state.now is None or view.belief is None:
            return state, NOTHING
        model = state.now.model_rad + view.period_s * view.model_nu[2]
        now = replace(state.now, model_rad=model)
        past = tuple(t for t in (*state.past, now) if now.t_ns - t.t_ns <= (WINDOWS_S[-1] + 0.05) * 1e9)
        state = replace(state, now=now, past=past)
        if state.jumped or state.findings:
            return state, self._report(state)
        worst = max((_contradiction(now, past, w) for w in WINDOWS_S), key=lambda c: c[0], default=(0.0, now))
        state = replace(state, contradicted=state.contradicted + 1 if worst[0] > 0 else 0)
        if state.contradicted < TICKS:
            return state, NOTHING
        what, text = _name(now, worst[1])
        state = replace(state, findings=(Finding("sensor", what, text, view.t_ns),))
        alert = Alert(t_ns=view.t_ns, level="error", text=text)
        return state, MonitorReport(self._report(state).events, (alert,))

    @staticmethod
    def _report(state: HeadingState) -> MonitorReport:
        if state.jumped or not state.findings:
            return NOTHING
        return MonitorReport({"untrusted": state.findings[0].text})


def _contradiction(now: Turn, past: tuple[Turn, ...], window_s: float) -> tuple[float, Turn]:
    """By how much more than allowed they disagree since `window_s` ago [rad], and the sums then."""
    then = next((t for t in past if now.t_ns - t.t_ns <= window_s * 1e9), now)
    gyro = now.gyro_rad - then.gyro_rad
    return abs(now.psi_rad - then.psi_rad - gyro) - LIMIT_RAD - SHARE * abs(gyro), then


def _name(now: Turn, then: Turn) -> tuple[str, str]:
    """Which one is wrong, by the model's own turn."""
    psi, gyro, model = now.psi_rad - then.psi_rad, now.gyro_rad - then.gyro_rad, now.model_rad - then.model_rad
    wrong = "heading" if abs(psi - model) > abs(gyro - model) else "gyro"
    if abs(psi) < UNCHANGED_RAD:
        wrong = "heading"
    elif abs(psi + gyro) < 0.5 * abs(psi):  # as large, with the other sign
        wrong = "gyro"
    seconds = (now.t_ns - then.t_ns) * 1e-9
    text = (
        f"heading turned by {math.degrees(psi):.0f} degrees in {seconds:.0f} s, the gyro says {math.degrees(gyro):.0f},"
        f" the thrust {math.degrees(model):.0f}: the {wrong} is wrong"
    )
    return wrong, text
