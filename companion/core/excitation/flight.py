"""Flying an excitation: which forces now, given the estimated pose. Pure; never outside the pen.

    home --within return_m of the middle--> fly --segment over--> home --> ... --> done
    fly --could not be stopped within the margin any more--> home, until there is room again, then its rest
    home --no room to fly: margin, and what the position may be off--> home
    home --a fence of the mission stands between the boat and the middle--> failed
    without `homing`: no forces at home, which is wherever the boat is; too near to the fence: failed
    any --called again after a break--> home;    home --for longer than HOME_LIMIT_S--> failed

On the way home tau = M (nu_d - nu) / T + D(nu) nu in body axes, towards the middle at a speed that falls with the
distance; the nearer of bow and stern turns towards it, so that a boat that cannot push sideways comes home too.
Nothing in it needs a good model: how far the vessel file's numbers may be off is the file's `caution`.
"""

from __future__ import annotations

import math
from typing import Literal

import msgspec
import numpy as np
from msgspec.structs import replace

from companion.core.configuration.site_file import Site
from companion.core.configuration.vessel_file import VesselFile
from companion.core.control.allocation import allocate, force_limits
from companion.core.excitation.file import Excitation
from companion.core.excitation.pen import Pen, stopping_distance_m
from companion.core.excitation.signal import axis_reach, signals
from companion.core.geometry.fence import ANYWHERE, Fence
from companion.core.geometry.frames import rotate, ssa, unrotate
from companion.core.messages import ExcitationStatus
from companion.core.model.manoeuvring import mass_matrix
from companion.core.model.thrusters import configuration_matrix

BRAKE_SHARE = 0.5
"""Share of an axis' force counted on for stopping: the rest is for turning and wind; assumed."""
REACTION_S = 0.5
"""Until a braking force is there: a tick of `PERIOD_S`, dead time, lag, and growing thrust of the segment; assumed."""
LEAST_DAMPING = 0.01
"""Linear damping over mass [1/s] of a file that states none; assumed."""
PERIOD_S = 0.1
"""A tick, where nothing else is said: the default of `control.period_s`."""
GAP_S, GAP_TICKS = 0.5, 5
"""Calls further apart than either are a break; assumed."""
HOME_LIMIT_S = 90.0
"""Whoever is not home by then never will be: wind, current or a fault hold the boat; assumed."""
APPROACH_S = 2.5
"""Speed towards the middle is the distance over this; assumed."""
SURGE_TIME_S = 1.5
"""T above; assumed."""
YAW_RAD_S = 0.8
YAW_SHARE = 0.3
"""Double pole of the turn on the way home, and the share of the yaw moment that it may use; assumed."""
REST_M_S = 0.1
"""Slower than this at the end is at rest; assumed."""

Phase = Literal["home", "fly", "done", "failed"]


class FlightState(msgspec.Struct, frozen=True):
    """How far an excitation is. `elapsed_s`: flown of the segment; `side`, `psi_start`: of a zig-zag."""

    phase: Phase = "home"
    segment: int = 0
    elapsed_s: float = 0.0
    side: float = 1.0
    psi_start: float = 0.0
    home_s: float = 0.0
    t_ns: int | None = None
    f_n: tuple[float, ...] = ()


BEGINNING = FlightState()


class Flight:
    """One excitation for one vessel at one site. Raises ConfigError where they do not fit together.

    `name`: of the excitation file; `others`: the mission's fences; `period_s`: between two calls of `step`.
    """

    def __init__(
        self,
        excitation: Excitation,
        vessel: VesselFile,
        site: Site,
        *,
        name: str,
        others: Fence = ANYWHERE,
        period_s: float = PERIOD_S,
    ):
        self.excitation, self.pen, self._period_s = excitation, Pen(site, others), period_s
        self._gap_s, self._reaction_s = max(GAP_S, GAP_TICKS * period_s), REACTION_S + max(period_s - PERIOD_S, 0.0)
        self.pen.check(excitation.margin_m, excitation.return_m, name=name)
        self.signals = signals(excitation, vessel, name=name)
        self._vessel, self._M, self._limits = vessel, np.diag(mass_matrix(vessel)), force_limits(vessel)
        self._axes, self._B = axis_reach(vessel), configuration_matrix(vessel)
        d = vessel.damping
        self._linear = -np.array([d.X_u_N_s_m, d.Y_v_N_s_m, d.N_r_N_m_s])
        self._quadratic = -np.array([d.X_uu_N_s2_m2, d.Y_vv_N_s2_m2, d.N_rr_N_m_s2])

    def step(
        self, state: FlightState, eta: np.ndarray, nu: np.ndarray, t_ns: int, *, spread_m: float = 0.0
    ) -> tuple[FlightState, np.ndarray, str]:
        """State, thruster forces (n,) [N] and a note (empty: nothing new) at `t_ns`.

        `eta`, `nu`: pose and velocity over ground; `spread_m`: how far the boat may be from there.
        """
        dt = 0.0 if state.t_ns is None else (t_ns - state.t_ns) * 1e-9
        if not 0.0 <= dt <= self._gap_s:
            state, dt = replace(state, phase="home" if state.phase == "fly" else state.phase, f_n=(), home_s=0.0), 0.0
        state, note = self._advance(replace(state, t_ns=t_ns), eta, nu, dt, spread_m)
        if state.phase == "home" and not self.excitation.homing:
            wanted = np.zeros(len(self._vessel.thrusters))
        elif state.phase == "fly":
            wanted = self.signals[state.segment].force(state.elapsed_s, state.side)
        elif state.phase == "home":
            wanted = allocate(self._homeward(eta, nu), self._vessel)
        else:
            return replace(state, f_n=()), np.zeros(len(self._vessel.thrusters)), note
        f = self._within_limits(wanted, state.f_n, dt)
        return replace(state, f_n=tuple(map(float, f))), f, note

    def status(self, state: FlightState, t_ns: int) -> ExcitationStatus:
        """What to log of `state`."""
        at = min(state.segment, len(self.signals) - 1)
        return ExcitationStatus(
            t_ns=t_ns,
            phase=state.phase,
            segment=state.segment,
            segments=len(self.signals),
            name=self.excitation.segments[at].name,
            elapsed_s=state.elapsed_s,
        )

    def is_over(self, state: FlightState) -> bool:
        """Whether there is nothing left to fly."""
        return state.phase in ("done", "failed")

    def _advance(
        self, state: FlightState, eta: np.ndarray, nu: np.ndarray, dt: float, spread_m: float
    ) -> tuple[FlightState, str]:
        """The state after `dt` seconds, and what changed as text."""
        if state.phase == "fly":
            return self._fly(replace(state, elapsed_s=state.elapsed_s + dt), eta, nu, spread_m)
        if state.phase == "home":
            return self._go_home(replace(state, home_s=state.home_s + dt), eta, nu, spread_m)
        return state, ""

    def _fly(self, state: FlightState, eta: np.ndarray, nu: np.ndarray, spread_m: float) -> tuple[FlightState, str]:
        signal = self.signals[state.segment]
        if state.elapsed_s >= signal.duration_s - 1e-6:
            after = FlightState(segment=state.segment + 1, t_ns=state.t_ns, f_n=state.f_n)
            if after.segment < len(self.signals) and (self._is_near(eta) or not self.excitation.homing):
                return self._begin(after, eta)
            return after, ""
        if (room := self._room_to_spare_m(state, eta, nu, spread_m)) < self.excitation.margin_m:
            title = self.title(state.segment)
            if not self.excitation.homing:
                return replace(
                    state, phase="failed"
                ), f"{title}: ended {room:.1f} m from the fence: bring the boat back"
            note = f"{title}: {state.elapsed_s:.1f} s into it turned back, to stop {room:.1f} m inside the fence"
            return replace(state, phase="home", home_s=0.0), note
        if signal.switch_rad is not None:
            turned = ssa(float(eta[2]) - state.psi_start)
            if turned * state.side > signal.switch_rad:
                state = replace(state, side=-state.side)
        return state, ""

    def _go_home(self, state: FlightState, eta: np.ndarray, nu: np.ndarray, spread_m: float) -> tuple[FlightState, str]:
        if state.home_s > HOME_LIMIT_S:
            what = "not back at the middle" if not self._is_near(eta) else "at the middle no rest, or no room to fly,"
            return replace(state, phase="failed"), f"excitation ended: {what} after {HOME_LIMIT_S:g} s"
        if self.excitation.homing and not self._is_near(eta):
            if self.pen.way_back(eta[:2]) <= spread_m:
                north, east = self.pen.middle
                text = f"a fence of the mission is on the way to the middle (north {north:.1f}, east {east:.1f} m)"
                return replace(state, phase="failed"), f"excitation ended: {text}: bring the boat past it"
            return state, ""
        if not self._is_ready(state, eta, nu, spread_m):
            return state, ""
        if state.segment < len(self.signals):
            return self._begin(state, eta)
        return replace(state, phase="done"), "excitation done"

    def _is_ready(self, state: FlightState, eta: np.ndarray, nu: np.ndarray, spread_m: float) -> bool:
        """Whether a boat near the middle may fly what is next, or be done."""
        if not self.excitation.homing:
            return True
        if state.segment >= len(self.signals):
            return bool(np.hypot(nu[0], nu[1]) <= REST_M_S)
        least = self.excitation.margin_m
        # Whoever turned back goes on with half the room of the middle: with less, every other tick would fly outwards.
        if state.elapsed_s > 0.0:
            least = max(least, 0.5 * (least + self.pen.most_clearance_m - spread_m))
        return self._room_to_spare_m(state, eta, nu, spread_m) >= least

    def _begin(self, state: FlightState, eta: np.ndarray) -> tuple[FlightState, str]:
        verb = f"goes on at {state.elapsed_s:.1f} s" if state.elapsed_s else "begins"
        state = replace(state, phase="fly", psi_start=float(eta[2]), home_s=0.0)
        return state, f"{self.title(state.segment)} {verb}"

    def title(self, segment: int) -> str:
        """Description of a segment."""
        return f"segment {segment + 1} of {len(self.signals)}, {self.excitation.segments[segment].name},"

    def _room_to_spare_m(self, state: FlightState, eta: np.ndarray, nu: np.ndarray, spread_m: float) -> float:
        return self.room_m(eta, nu, np.array(state.f_n)) - spread_m

    def room_m(self, eta: np.ndarray, nu: np.ndarray, f_n: np.ndarray) -> float:
        """Clearance [m] that is left when the boat, now under forces `f_n`, is stopped; also on its way, and of the
        mission's fences on the way back.
        """
        push = (self._B @ f_n)[:2] if len(f_n) else np.zeros(2)
        soon = nu[:2] + self._reaction_s * push / self._M[:2]
        speed = np.where(np.abs(soon) > np.abs(nu[:2]), soon, nu[:2])
        ahead, side = (self._stop_m(i, float(w)) for i, w in enumerate(speed))
        place = np.asarray(eta[:2], dtype=float)
        stopped = place + rotate(float(eta[2]), ahead, side)
        room = self.pen.least_clearance(place, stopped)
        return min(room, self.pen.way_back(stopped)) if self.excitation.homing and not self._is_near(stopped) else room

    def _stop_m(self, axis: int, speed: float) -> float:
        """How far the boat goes along x (axis 0) or y (1) until it rests [m], with the sign of its speed."""
        caution = self.excitation.caution
        mass = caution * self._M[axis]
        damping = max(float(self._linear[axis]), LEAST_DAMPING * self._M[axis]) / caution
        force = BRAKE_SHARE * self._axes[axis].min() / caution
        return math.copysign(stopping_distance_m(speed, mass, damping, force, self._reaction_s), speed)

    def _is_near(self, eta: np.ndarray) -> bool:
        return float(np.linalg.norm(eta[:2] - self.pen.middle)) <= self.excitation.return_m

    def _homeward(self, eta: np.ndarray, nu: np.ndarray) -> np.ndarray:
        """tau [N, N, N m] towards the middle."""
        psi, away = float(eta[2]), self.pen.middle - eta[:2]
        far = float(np.linalg.norm(away))
        speed = min(self.excitation.return_speed_m_s, far / APPROACH_S)
        wanted = np.array(unrotate(psi, *(away * speed / max(far, 1e-6))))
        push = self._M[:2] * (wanted - nu[:2]) / SURGE_TIME_S
        push += (self._linear[:2] + self._quadratic[:2] * np.abs(nu[:2])) * nu[:2]
        off = ssa(psi - math.atan2(away[1], away[0]))
        off -= math.copysign(math.pi, off) if abs(off) > math.pi / 2 else 0.0
        if far < self.excitation.return_m:
            off = 0.0  # so near, the bearing swings round
        turn = -self._M[2] * (YAW_RAD_S**2 * off + 2 * YAW_RAD_S * nu[2])
        most = YAW_SHARE * self._axes[2].min()
        return np.array([push[0], push[1], np.clip(turn, -most, most)])

    def _within_limits(self, wanted: np.ndarray, before: tuple[float, ...], dt: float) -> np.ndarray:
        """Forces within the thrusters' limits, changing no faster than the vessel file allows."""
        last = np.array(before) if before else np.zeros(len(wanted))
        step = self._vessel.propulsion.rate_limit_N_s * (dt or self._period_s)
        return np.clip(np.clip(wanted, last - step, last + step), *self._limits)
