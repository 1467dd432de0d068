"""Ranges against the boat's path: UWB that comes later than the file says, anchors that stand elsewhere, a compass.

    z_i = |a_i - p_tag(t)|      p_tag(t) = c + w t + a t^2 / 2 + e^(i phi) (b g(t - tau) + p(t - tau))
                                tau = phi = 0, or tau 0.5 to 2 s, or phi 60 to 300 degrees

Plane vectors are complex numbers here, north + i east. p is the tag's path by two witnesses that know nothing of
ranges: the model's speed under the commanded thrust, added up (b: scale and rotation of g = p, what a hull and
thrusters that are off do to it; w: a current, a: gusts), and the specific force, added up twice (b: bias, g = double
integral of the heading; w: the speed at first). Ranges are late, or turned against the heading, if that explains a
window of them better than all these, by both: the model alone is too early where the boat is heavier than its file
says, or thrusters are reversed; the specific force alone misleads where its levelling is wrong.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterable
from operator import attrgetter
from statistics import fmean
from typing import NamedTuple

import msgspec
import numpy as np
from msgspec.structs import replace

from companion.core.configuration.sensors import Sensors, Uwb
from companion.core.configuration.site_file import Site
from companion.core.estimation.filter_state import FilterState
from companion.core.estimation.ranging.ranges import line_of_sight
from companion.core.geometry.frames import to_level
from companion.core.messages import Alert, ImuSample, OperatorCommand, UwbRanges
from companion.core.pilot.monitors.monitor import NOTHING, Monitor, MonitorReport, TickView
from companion.core.pilot.trust.sensors.range_window import HYPOTHESES, PathHypothesis, RangeWindow, SeenRange
from companion.core.pilot.trust.verdict import Finding, is_forgotten
from companion.core.sensors.inertial import InertialSensor
from companion.core.sensors.uwb import RangingSensor

LONGEST_S = max(h.delay_s for h in HYPOTHESES)
WINDOW_S, PERIOD_NS, GAP_S = 12.0, 500_000_000, 0.5
"""What is looked at, and how often; without an IMU for longer it begins anew. Assumed."""
LATE_WAY_M, LATE_RANGES = 3.0, 16
"""A boat that has hardly moved says nothing about time; assumed."""
WAY_M, LEAST_RANGES = 0.5, 8
"""Nor, with less than this, of anything."""
FLOW_M_S, SHARE, BIAS_M_S2 = 0.3, 0.15, 0.15
"""Sigmas of a current, of scale and rotation [rad] of the model's path, and of the specific force's bias and level;
assumed."""
GUSTS_M_S2, STEADY_M_S2 = 0.01, 1e-4
"""Sigmas of how the drift changes in gusts, which the model does not know, and the specific force feels; assumed."""
LATE_NATS, TURNED_NATS, COUNTS_HZ = (12.0, 6.0), (5.0, 2.5), 4.0
"""By model and by specific force. Assumed. Of 80 boats that were up to half as heavy or strong again as
their file says, or half of that, and 100 in gusts and waves with reflections, none had more than 9 and 4.5 at once for
a delay, and 4.1 and 3.6 for a turn. Ranges that come more often than `COUNTS_HZ` share their errors."""
SUSPECT_NATS = 2.5, 0.4
"""From so much on no thruster is blamed for what may be a turn, until the first falls short; assumed."""


class PathEvidence(NamedTuple):
    """What explains the ranges best: by the model's path so many nats, and by the specific force's, if that agrees."""

    best: PathHypothesis
    by_model: float
    by_force: float

    def exceeds(self, by_model: float, by_force: float) -> bool:
        """Whether both say as much."""
        return self.by_model >= by_model and self.by_force >= by_force


FORCE_OF = attrgetter("ax_m_s2", "ay_m_s2", "az_m_s2")
NO_EVIDENCE = PathEvidence(PathHypothesis(), 0.0, 0.0)


class PathPoint(NamedTuple):
    """A tick: e^(i psi), the model's speed [m/s] and the specific force [m/s^2], both in north and east."""

    t_s: float
    heading: complex
    speed: complex
    force: complex


class PathState(msgspec.Struct, frozen=True):
    """`path`, `ranges`: of the window; `forces`, `cycles`: arrived since the last tick; `judged_ns`: the last tick
    after which a verdict was due, `is_due`: it still is; `blamed`: thrusters were suspected then; `is_suspect`: ranges
    are turned, perhaps; `untrusted`: that was found.
    """

    path: tuple[PathPoint, ...] = ()
    ranges: tuple[SeenRange, ...] = ()
    forces: tuple[ImuSample, ...] = ()
    cycles: tuple[UwbRanges, ...] = ()
    judged_ns: int = 0
    is_due: bool = False
    blamed: bool = False
    is_suspect: bool = False
    untrusted: bool = False
    findings: tuple[Finding, ...] = ()


class PathMonitor(Monitor[PathState]):
    """Says that ranges come late: the estimate is no longer healthy (`verdict.vet`); or that the way by them is turned
    against the heading: condition `untrusted`; until the next start.
    """

    hears = (UwbRanges, ImuSample, OperatorCommand)
    initial = PathState()

    def __init__(self, sensors: Sensors, site: Site):
        self._uwb, self._imu, self._inertial = sensors.uwb, sensors.imu, InertialSensor(sensors.imu)
        self._anchors_m = {a.id: np.array([a.north_m, a.east_m, a.down_m]) for a in site.anchors}

    def on_message(
        self, state: PathState, message: UwbRanges | ImuSample | OperatorCommand, t_ns: int
    ) -> tuple[PathState, MonitorReport]:
        """Keep what comes until the tick; a new start forgets what was found."""
        if isinstance(message, OperatorCommand):
            return (self.initial if is_forgotten(state.findings, message) else state), NOTHING
        if state.findings or (uwb := self._uwb) is None:
            return state, NOTHING
        if isinstance(message, UwbRanges):
            ranges, _ = RangingSensor.screen(message)
            return (replace(state, cycles=(*state.cycles, ranges)) if ranges else state), NOTHING
        if self._inertial.screen(message)[0] is None:
            return state, NOTHING
        state = replace(state, forces=(*state.forces, self._inertial.correct(message)))
        return self._judged(replace(state, is_due=False), uwb, t_ns) if state.is_due else (state, NOTHING)

    def on_tick(self, state: PathState, view: TickView) -> tuple[PathState, MonitorReport]:
        """One more point of the path; twice a second a verdict is due, which no tick waits for."""
        if state.findings or (uwb := self._uwb) is None:
            return state, _report(state)
        if view.belief is None or view.learning or view.thrusters_changed:
            return self.initial, NOTHING
        state = self._moved(state, view, view.belief, uwb)
        if view.t_ns - state.judged_ns < PERIOD_NS or not view.driving:
            return state, NOTHING
        return replace(state, judged_ns=view.t_ns, is_due=True, blamed=bool(view.thrusters_suspected)), NOTHING

    def _judged(self, state: PathState, uwb: Uwb, t_ns: int) -> tuple[PathState, MonitorReport]:
        """The verdict."""
        evidence = self._evidence(state, uwb)
        found, is_late = evidence.best, evidence.best.delay_s > 0
        is_suspect = bool(found.turn_rad) and (state.is_suspect or evidence.exceeds(*SUSPECT_NATS))
        state = replace(state, is_suspect=is_suspect)
        enough = LATE_NATS if is_late else TURNED_NATS
        if (is_late and state.blamed) or not evidence.exceeds(*enough):
            return state, NOTHING
        if is_late:
            text = (
                f"UWB ranges come about {found.delay_s:g} s late: they tell where the boat was (latency_s of"
                " sensors.uwb in the vessel file, or a slow link to the tag?)"
            )
        else:
            text = (
                f"by UWB the boat goes about {math.degrees(abs(found.turn_rad)):.0f} degrees to"
                f" {'starboard' if found.turn_rad > 0 else 'port'} of where it is driven: anchors elsewhere than in the"
                " site file (mirrored, turned?), or a compass that is off"
            )
        state = replace(state, untrusted=not is_late, findings=(Finding("sensor", "position", text, t_ns),))
        return state, MonitorReport(_report(state).events, (Alert(t_ns=t_ns, level="error", text=text),))

    def _moved(self, state: PathState, view: TickView, belief: FilterState, uwb: Uwb) -> PathState:
        """With the tick's motion, and the ranges that came before it."""
        if not state.forces:
            is_gap = not state.path or view.t_ns * 1e-9 - state.path[-1].t_s > GAP_S
            waiting = tuple(m for m in state.cycles if view.t_ns * 1e-9 - m.t_ns * 1e-9 <= WINDOW_S)
            return replace(self.initial, cycles=waiting) if is_gap else state
        mean = map(fmean, zip(*map(FORCE_OF, state.forces), strict=True))
        ahead, starboard, _ = to_level(*belief.tilt, *mean)
        t_s, heading, (u, v, _) = view.t_ns * 1e-9, cmath.rect(1.0, float(belief.x[2])), view.model_nu
        force = complex(ahead, starboard)
        tag = complex(*belief.x[:2]) + heading * complex(uwb.x_m, uwb.y_m)
        tag_m = np.array([tag.real, tag.imag, uwb.z_m])
        point = PathPoint(t_s, heading, heading * complex(u, v), heading * force)
        seen = [r for m in state.cycles for r in self._projected(m, tag_m)]
        return replace(
            state, forces=(), cycles=(), path=_since(t_s - WINDOW_S - LONGEST_S, (*state.path, point)),
            ranges=_since(t_s - WINDOW_S, (*state.ranges, *seen)),
        )  # fmt: skip

    def _projected(self, m: UwbRanges, tag_m: np.ndarray) -> Iterable[SeenRange]:
        """Ranges of known anchors, linear about `tag_m`: u . p_tag = z - |tag_m - a| + u . tag_m."""
        for r in m.ranges:
            if r.anchor in self._anchors_m:
                distance, e = line_of_sight(tag_m, self._anchors_m[r.anchor])
                yield SeenRange(m.t_ns * 1e-9, complex(e[0], e[1]), r.range_m - distance + float(e[:2] @ tag_m[:2]))

    def _evidence(self, state: PathState, uwb: Uwb) -> PathEvidence:
        """What the ranges of the window say by both witnesses."""
        seen = state.ranges
        if len(seen) < LEAST_RANGES:
            return NO_EVIDENCE
        t_s, heading, speed, force = (np.array(column) for column in zip(*state.path, strict=True))
        dt_s = np.diff(t_s, prepend=t_s[0])
        way = np.cumsum(dt_s * speed)
        if (way_m := np.abs(np.diff(way)).sum()) < WAY_M:
            return NO_EVIDENCE
        weight = min(1.0, COUNTS_HZ * len(self._anchors_m) * (seen[-1].t_s - seen[0].t_s) / len(seen))
        tag, imu = complex(uwb.x_m, uwb.y_m), complex(self._imu.x_m, self._imu.y_m)
        by_model = way + heading * tag
        by_force = np.cumsum(dt_s * np.cumsum(dt_s * force)) + heading * (tag - imu)
        window, bias = RangeWindow(seen, uwb.range_sigma_m), np.cumsum(dt_s * np.cumsum(dt_s * heading))
        best, nats = window.best(t_s, by_model, by_model - by_model.mean(), (FLOW_M_S, SHARE, GUSTS_M_S2))
        if nats * weight < SUSPECT_NATS[0] or (best.delay_s and (way_m < LATE_WAY_M or len(seen) < LATE_RANGES)):
            return NO_EVIDENCE
        other, by_it = window.best(t_s, by_force, bias, (np.inf, BIAS_M_S2, STEADY_M_S2))
        return PathEvidence(best, nats * weight, by_it * weight if best.agrees(other) else 0.0)


def _report(state: PathState) -> MonitorReport:
    return MonitorReport({"untrusted": state.findings[0].text}) if state.untrusted else NOTHING


def _since(t_s: float, items: tuple) -> tuple:
    """Those not older."""
    return items[next((i for i, item in enumerate(items) if item.t_s >= t_s), len(items)) :]
