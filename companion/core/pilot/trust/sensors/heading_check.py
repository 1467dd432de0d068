"""Heading against yaw rate: what the heading turned over one to twenty seconds is what the gyro adds up to.

    e = (psi_2 - psi_1) - integral r dt      |e| > 0.12 rad + 5 % of the turn + 0.25 rad (s_max - s_min), three ticks in
                                             a row: they contradict; 0.04 rad where one repeats itself to the last digit

s: share of full thrust, lately; the thrusters' currents turn a compass.

One that repeats itself, which it never did before, hangs, whether the boat turns or not.
Which of the two is wrong is asked of a third: the yaw rate that the commanded moment makes of the model alone.
A heading that jumps farther than any boat turns is left out at once. Before the filter runs it may jump: an autopilot
that has just started finds its heading, and the filter begins with what it has found.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from operator import attrgetter

import msgspec
import numpy as np
from msgspec.structs import replace

from companion.core.configuration.vessel_file import VesselFile
from companion.core.estimation.filter_state import Tilt
from companion.core.estimation.tilt import yaw_rate
from companion.core.geometry.frames import ssa
from companion.core.messages import Alert, Attitude, OperatorCommand
from companion.core.pilot.monitors.monitor import NOTHING, Monitor, MonitorReport, TickView
from companion.core.pilot.trust.sensors.turn_readings import SCATTER_RAD_S, UNREAD, TurnReadings
from companion.core.pilot.trust.verdict import Finding, is_forgotten
from companion.core.sensors.inertial import AttitudeSensor

LIMIT_RAD, SHARE, BY_THRUST_RAD = 0.12, 0.05, 0.25
"""Four sigma of heading noise (0.005) and wander (0.012 rad) and a yaw reset of 3 degrees; a gyro's gain: assumed. What
full thrust does to a compass beside it: with this, 16 runs of a real catamaran (BlueBoat: github.com/jankristia/
BlueBoatSystemIdentification) stay below the limit, without it one that sets off at full thrust reaches 0.22."""
WINDOWS_S, LATELY_S = (1.0, 5.0, 10.0, 20.0), 25.0
"""An autopilot takes some seconds to follow a compass: thrust of before the window counts. Assumed."""
SUSPECT_SHARE = 0.35
"""Of the limit, eight sigma of heading noise: from there on no thruster is blamed for what may be one of the two;
assumed. Half of it is too late for a gyro that turns the other way: thrusters were exchanged 0.3 s before."""
TICKS = 3
JUMP_RAD = 0.35
"""From one message to the next beyond what the gyro says: no boat; assumed."""
GAP_NS, OLDER = 500_000_000, 3
"""An attitude that is so much later begins anew; one that is not newer is left out, unless more than so many in a row
are not: a clock that went back, or a queue that empties at once. Assumed."""
MODEL_RAD_S = 0.02
"""The model's own yaw rate decides between the two if they differ by more; else it is the compass, which more things
disturb. Assumed."""
FROZEN_LIMIT_RAD = 0.04
"""Where one of them repeats itself: if the other turns, it is not measured any more. Assumed."""


class Turn(msgspec.Struct, frozen=True):
    """Sums since switch-on at `t_ns`: heading unwrapped, yaw rate and the model's yaw rate added up [rad]; `share`: of
    full thrust at the tick; `rate_rad_s`: the yaw rate then.
    """

    t_ns: int
    psi_rad: float
    gyro_rad: float
    model_rad: float
    share: float = 0.0
    rate_rad_s: float = 0.0


class HeadingState(msgspec.Struct, frozen=True):
    """`now`: the sums; `past`: at the last ticks, none before the filter runs; `contradicted`: ticks in a row;
    `jumped`: heading is left out; `older`: attitudes in a row that were not newer than the one before; `drives_ns`:
    since when thrusters may turn; `is_suspect`: the two disagree over the shortest window, perhaps not enough to tell.
    """

    now: Turn | None = None
    readings: TurnReadings = UNREAD
    past: tuple[Turn, ...] = ()
    contradicted: int = 0
    jumped: bool = False
    older: int = 0
    drives_ns: int | None = None
    is_suspect: bool = False
    findings: tuple[Finding, ...] = ()


class HeadingMonitor(Monitor[HeadingState]):
    """Condition `untrusted` while heading and yaw rate contradict each other."""

    hears = (Attitude, OperatorCommand)
    screens = True
    initial = HeadingState()

    def __init__(self, vessel: VesselFile, rotation_rad: float):
        """`rotation_rad`: of the site's axes, in which what the file knows of the compass counts."""
        self._sensor, self._rotation_rad = AttitudeSensor(vessel.sensors.imu), rotation_rad
        most_n = np.array([t.most_N for t in vessel.thrusters])
        self._share_per_n = 1 / (len(most_n) * most_n)

    def on_message(
        self, state: HeadingState, message: Attitude | OperatorCommand, t_ns: int
    ) -> tuple[HeadingState, MonitorReport]:
        """Add up one attitude; a new start forgets what was found."""
        if isinstance(message, OperatorCommand):
            anew = replace(self.initial, readings=state.readings)
            return (anew if is_forgotten(state.findings, message) else state), NOTHING
        if self._sensor.screen(message)[0] is None or math.isnan(message.psi_rad):
            return state, NOTHING
        before, alerts = state.now, ()
        in_site = replace(message, psi_rad=ssa(message.psi_rad - self._rotation_rad))
        sensed = self._sensor.correct(in_site)  # what the file knows of the sensors contradicts nothing
        rate = yaw_rate(Tilt(sensed.phi_rad, sensed.theta_rad), sensed.q_rad_s, sensed.r_rad_s)
        is_newer = before is not None and 0 < sensed.t_ns - before.t_ns <= GAP_NS
        left_out = MonitorReport(instead=replace(message, psi_rad=math.nan)) if state.jumped else NOTHING
        if not is_newer and before is not None and abs(sensed.t_ns - before.t_ns) <= GAP_NS and state.older < OLDER:
            return replace(state, older=state.older + 1), left_out
        if before is None or not is_newer:
            now = Turn(sensed.t_ns, sensed.psi_rad, 0.0, 0.0, rate_rad_s=rate)
            return replace(state, now=now, past=(), contradicted=0), left_out
        dt_s = (sensed.t_ns - before.t_ns) * 1e-9
        turn, by_gyro = ssa(sensed.psi_rad - before.psi_rad), (before.rate_rad_s + rate) / 2 * dt_s
        now = Turn(
            sensed.t_ns, before.psi_rad + turn, before.gyro_rad + by_gyro, before.model_rad, rate_rad_s=rate
        )  # fmt: skip
        if state.past and not state.jumped and abs(turn - by_gyro) > JUMP_RAD:
            text = f"heading jumped by {math.degrees(turn):.0f} degrees: left out until the next start (compass?)"
            alerts = (Alert(t_ns=t_ns, level="error", text=text),)
            finding = Finding("sensor", "heading", text, t_ns)
            state = replace(state, jumped=True, past=(), findings=(*state.findings, finding))
        instead = replace(message, psi_rad=math.nan) if state.jumped else None
        readings = state.readings.take(message.psi_rad, message.r_rad_s, dt_s)
        return replace(state, now=now, readings=readings, older=0), MonitorReport(alerts=alerts, instead=instead)

    def on_tick(self, state: HeadingState, view: TickView) -> tuple[HeadingState, MonitorReport]:
        """Compare over the windows."""
        if state.now is None or view.belief is None:
            return state, NOTHING
        model = state.now.model_rad + view.period_s * view.model_nu[2]
        thrust_n = np.abs(view.belief.f_n[: len(self._share_per_n)])
        now = replace(state.now, model_rad=model, share=float(thrust_n @ self._share_per_n))
        first, last = _first(state.past, now.t_ns - round(LATELY_S * 1e9)), _first(state.past, now.t_ns)
        past = (*state.past[first:last], now)
        drives_ns = (view.t_ns if state.drives_ns is None else state.drives_ns) if view.driving else None
        state = replace(state, now=now, past=past, drives_ns=drives_ns)
        if state.jumped or state.findings:  # a heading that jumped is left out, and contradicts nothing
            return replace(state, is_suspect=not state.jumped), self._report(state)
        limit_rad = FROZEN_LIMIT_RAD if state.readings.frozen else LIMIT_RAD
        beyond = [_contradiction(now, past, window_s, limit_rad) for window_s in WINDOWS_S]
        worst = max(beyond, key=lambda c: c[0])
        is_beyond = worst[0] > 0 and (bool(state.readings.frozen) or worst[0] > _by_thrust_rad(past))
        is_suspect = beyond[0][0] > (SUSPECT_SHARE - 1) * limit_rad
        state = replace(state, contradicted=state.contradicted + 1 if is_beyond else 0, is_suspect=is_suspect)
        if state.readings.scatter_rad_s > SCATTER_RAD_S:
            what, text = "gyro", "the yaw rate jumps to and fro as no boat turns: the gyro is wrong"
        elif drives_ns is not None and 0.0 < state.readings.hung_s <= (view.t_ns - drives_ns) * 1e-9:
            what, same_s = state.readings.frozen, state.readings.hung_s
            text = (
                f"the {what} has said the same to the last digit for {same_s:.1f} s, as it never did before: it hangs"
            )
        elif state.contradicted >= TICKS:
            what, text = _name(now, worst[1], _last(now, past, WINDOWS_S[0]), state.readings.frozen)
        else:
            return state, NOTHING
        state = replace(state, findings=(Finding("sensor", what, text, view.t_ns),))
        alert = Alert(t_ns=view.t_ns, level="error", text=text)
        return state, MonitorReport(self._report(state).events, (alert,))

    @staticmethod
    def _report(state: HeadingState) -> MonitorReport:
        if state.jumped or not state.findings:
            return NOTHING
        return MonitorReport({"untrusted": state.findings[0].text})


def _contradiction(now: Turn, past: tuple[Turn, ...], window_s: float, limit_rad: float) -> tuple[float, Turn]:
    """By how much more than allowed they disagree since `window_s` ago [rad], and the sums then."""
    then = _last(now, past, window_s)
    gyro = now.gyro_rad - then.gyro_rad
    return abs(now.psi_rad - then.psi_rad - gyro) - limit_rad - SHARE * abs(gyro), then


def _by_thrust_rad(past: tuple[Turn, ...]) -> float:
    """So much the thrusters' currents may have turned a compass of late."""
    shares = [t.share for t in past]
    return BY_THRUST_RAD * (max(shares) - min(shares))


def _last(now: Turn, past: tuple[Turn, ...], window_s: float) -> Turn:
    """The sums `window_s` ago."""
    return past[_first(past, now.t_ns - round(window_s * 1e9))]


def _first(past: tuple[Turn, ...], t_ns: int) -> int:
    """Place of the first that is no older."""
    return bisect_left(past, t_ns, key=attrgetter("t_ns"))


def _turned(now: Turn, then: Turn) -> tuple[float, float, float]:
    """By heading, gyro and model, from then to now [rad]."""
    return now.psi_rad - then.psi_rad, now.gyro_rad - then.gyro_rad, now.model_rad - then.model_rad


def _name(now: Turn, then: Turn, of_late: Turn, frozen: str) -> tuple[str, str]:
    """Which one is wrong: what is frozen, a gyro that turns the other way; else by the model's own turn."""
    psi, gyro, model = _turned(now, then)
    seconds = (now.t_ns - then.t_ns) * 1e-9
    is_opposite = any(abs(a + b) < 0.5 * abs(a) for a, b, _ in (_turned(now, of_late), (psi, gyro, model)))
    is_gyro = is_opposite or abs(gyro - model) - abs(psi - model) >= MODEL_RAD_S * seconds
    wrong = frozen or ("gyro" if is_gyro else "heading")
    text = (
        f"heading turned by {math.degrees(psi):.0f} degrees in {seconds:.0f} s, the gyro says {math.degrees(gyro):.0f},"
        f" the thrust {math.degrees(model):.0f}: the {wrong} is wrong"
    )
    return wrong, text
