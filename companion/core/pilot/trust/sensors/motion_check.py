"""Position against motion: four tests of what the filter is told against how the boat is driven.

    slip      mean over 2 s of R(psi) (nu_filter - nu_model): what moves the boat besides its thrusters. A current of
              0.15 m/s, gusts, and a model that is off by a fifth make up to 0.55 m/s; anchors that stand elsewhere
              than in the file, or a compass that is off by 60 degrees, more.
    force     the lasting latent force beyond what water, wind and thrusters that are off can do
    ranges    cumulative sum of what the second best range of each cycle says (d^2 = nu^2 / S): two bad anchors of four,
              one of three, count for nothing; of a position the mean of both coordinates
    anchors   off by metres since ranges moved the boat against its motion, so that fewer than three, or no more than
              those, agree: they may be the ones that are right

Each ends in `untrusted`: position and motion contradict each other, and nobody can tell which of them is right. Not in
an excitation, which is flown because the model is not known.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from statistics import fmean
from typing import NamedTuple

import msgspec
import numpy as np
from msgspec.structs import replace

from companion.core.configuration.vessel_file import VesselFile
from companion.core.estimation.filter_state import B_RANGE, FilterState
from companion.core.estimation.health import DISPLACED_S
from companion.core.geometry.frames import rotate
from companion.core.messages import Alert, Innovation, OperatorCommand
from companion.core.model.actuators.propulsion import ActuatorSet
from companion.core.model.manoeuvring import coefficients, damping_force
from companion.core.pilot.monitors.monitor import NOTHING, Monitor, MonitorReport, TickView
from companion.core.pilot.trust.verdict import Finding, is_forgotten
from companion.core.sensors.sensor import POSITION_INNOVATIONS, PositionWords
from companion.core.sensors.table import position_kind

BEGINS_NS = 3_000_000_000
"""After a start, or a gap in all sensors, the filter finds its speed; assumed."""
MEAN_S, SLIP_TICKS = 2.0, 5
SLIP_SIGMA_M_S, SPEED_SHARE, SIGMAS = 0.18, 0.25, 3.1
"""Sigma of what water and wind do to a boat of this size, and of the model's speed; assumed: in 24 h of weather, with
hull and thrusters off by 20 %, the largest slip was 3.0."""
FLOW_M_S, TURN_RAD_S, THRUST_SHARE = 0.5, 0.5, 0.1
"""The latent force may be the drag of so much flow and turn, and so much of full thrust; assumed."""
FORCE_TICKS = 15
CAP, SLACK, LIMIT, SOUND = 15.0, 2.5, 24.0, 0.5
"""Of the cumulative sum: a cycle counts 15 at most, 2.5 is normal, `SOUND` a sound filter's median: two cycles that are
far off suffice, before their gates re-open. Assumed. Faster ones count for less (`PositionWords.counts_Hz`)."""
UNSETTLED = 2.0
"""So much more must speak against the ranges of a filter that has not settled; its speed is not known well then, so
that slip says nothing yet. Of 300 starts in gusts and waves, 2 ended in `untrusted` otherwise."""
LEAST_ANCHORS, OFF_M = 3, 1.5
"""Fewer agree on a wrong place as well as on the right one; a wall makes ranges longer by less, as a rule. Assumed."""
SUSPECT = 8.0
"""Sum from which ranges and filter disagree too much to blame a thruster."""


class Cycle(NamedTuple):
    """d^2 of a tag's ranges, or of a position's coordinates, by the name of each, `CAP` at most; none twice."""

    d2: Mapping[str, float]

    @property
    def are_ranges(self) -> bool:
        """Not coordinates."""
        return any(name.startswith("range") for name in self.d2)

    @property
    def is_whole(self) -> bool:
        """Whether it can be judged; else it may go on: tags may say their ranges one by one, or lose some."""
        return len(self.d2) >= 3 or not self.are_ranges

    def surprise(self) -> float:
        """What it adds up to; of three ranges, those that are missing are as good as others."""
        if not self.are_ranges:
            return fmean(self.d2.values())
        missing = [SOUND] * (3 - len(self.d2))
        return sorted((*self.d2.values(), *missing))[1]


NO_CYCLE = Cycle({})


class MotionState(msgspec.Struct, frozen=True):
    """`slip_m_s`: mean, north and east; `beyond`, `forced`: ticks in a row with too much slip, too much force; `sum`:
    of the ranges' surprise; `cycle`: the one at hand; `doubted`: anchors that may have moved the boat, by number.
    """

    slip_m_s: tuple[float, float] = (0.0, 0.0)
    beyond: int = 0
    forced: int = 0
    sum: float = 0.0
    cycle: Cycle = NO_CYCLE
    doubted: tuple[int, ...] = ()
    findings: tuple[Finding, ...] = ()

    @property
    def is_suspect(self) -> bool:
        """Whether ranges disagree with the filter, perhaps not enough to say so."""
        return self.sum >= SUSPECT or bool(self.findings)


class MotionMonitor(Monitor[MotionState]):
    """Condition `untrusted` while position and motion contradict each other; latched until the next start."""

    hears = (Innovation, OperatorCommand)
    initial = MotionState()

    def __init__(self, vessel: VesselFile):
        kind, rate_Hz = position_kind(vessel.sensors), vessel.sensors.position.rate_Hz
        self._words, self._has_anchors = kind.words, vessel.sensors.uwb is not None
        self._weight = kind.words.weight(rate_Hz)
        along_each = np.diag([FLOW_M_S, FLOW_M_S, TURN_RAD_S])
        flow = [float(damping_force(coefficients(vessel), nu)[axis]) for axis, nu in enumerate(along_each)]
        actuators = ActuatorSet.of(vessel)
        most = np.abs(actuators.directions) @ np.maximum(*np.abs(actuators.limits(None)))
        self._force_n = np.array(flow) + THRUST_SHARE * most

    def on_message(
        self, state: MotionState, message: Innovation | OperatorCommand, t_ns: int
    ) -> tuple[MotionState, MonitorReport]:
        """One innovation of a range or coordinate; a new start forgets what was found."""
        if isinstance(message, OperatorCommand):
            anew = replace(self.initial, doubted=state.doubted)
            return (anew if is_forgotten(state.findings, message) else state), NOTHING
        if not message.sensor.startswith(POSITION_INNOVATIONS):
            return state, NOTHING
        if message.sensor in state.cycle.d2:
            state = self._counted(state)
        return replace(state, cycle=Cycle({**state.cycle.d2, message.sensor: min(message.d2, CAP)})), NOTHING

    def _counted(self, state: MotionState) -> MotionState:
        """With the cycle at hand in the sum."""
        total = max(0.0, state.sum + self._weight * (state.cycle.surprise() - SLACK))
        return replace(state, sum=min(total, 2 * UNSETTLED * LIMIT), cycle=NO_CYCLE)

    def on_tick(self, state: MotionState, view: TickView) -> tuple[MotionState, MonitorReport]:
        """Judge slip, force and ranges."""
        belief = view.belief
        if state.cycle.d2 and state.cycle.is_whole:
            state = self._counted(state)
        if belief is None or view.learning or view.t_ns - belief.since_ns < BEGINS_NS:
            return replace(state, slip_m_s=(0.0, 0.0), beyond=0, forced=0, sum=0.0), _report(state)
        nu, modelled = belief.x[3:5], view.model_nu
        slip = rotate(float(belief.x[2]), float(nu[0]) - modelled[0], float(nu[1]) - modelled[1])
        gain = min(1.0, view.period_s / MEAN_S)
        north, east = (mean + gain * (now - mean) for mean, now in zip(state.slip_m_s, slip, strict=True))
        sigma = math.hypot(SLIP_SIGMA_M_S, SPEED_SHARE * math.hypot(modelled[0], modelled[1]))
        is_known = belief.settled
        beyond = state.beyond + 1 if is_known and math.hypot(north, east) > SIGMAS * sigma else 0
        lasting = belief.latent_means.lasting
        forced = state.forced + 1 if (np.abs(lasting) > self._force_n).any() else 0
        doubted, anchors = _anchors_off(belief, state.doubted, view.t_ns) if self._has_anchors else ((), "")
        state = replace(state, slip_m_s=(north, east), beyond=beyond, forced=forced, doubted=doubted)
        if state.findings:
            return state, _report(state)
        text = _sentence(state, lasting, self._words, LIMIT if is_known else UNSETTLED * LIMIT)
        if not (text := text or anchors):
            return state, NOTHING
        if view.thrusters_suspected:
            text += f"; suspected before: {view.thrusters_suspected}"
        state = replace(state, findings=(Finding("sensor", "position", text, view.t_ns),))
        return state, MonitorReport(_report(state).events, (Alert(t_ns=view.t_ns, level="error", text=text),))


def _sentence(state: MotionState, lasting: tuple[float, float, float], words: PositionWords, limit: float) -> str:
    """What is wrong; empty: nothing."""
    if state.beyond >= SLIP_TICKS:
        speed = math.hypot(*state.slip_m_s)
        return (
            f"the boat moves by {speed:.1f} m/s otherwise than it is driven: {words.astray}, a"
            " compass that is off, thrusters that do not obey, or a current"
        )
    if state.forced >= FORCE_TICKS:
        X, Y, N = lasting
        return (
            f"a force that nothing explains ({X:.0f} N ahead, {Y:.0f} N to starboard, {N:.0f} N m): compass,"
            f" accelerometer or {words.source} are wrong, thrusters do not obey, or the boat is held"
        )
    if state.sum >= limit:
        return f"{words.readings} contradict the motion of the boat: they, heading or accelerometer are wrong"
    return ""


def _anchors_off(belief: FilterState, doubted: tuple[int, ...], t_ns: int) -> tuple[tuple[int, ...], str]:
    """Anchors, of those heard, that may have moved the boat, and what is wrong; empty: enough of them agree."""
    heard = [i for i, seen in enumerate(belief.latest) if seen is not None]
    off = [i for i in heard if abs(belief.x[B_RANGE + i]) > OFF_M]
    is_new = belief.was_displaced(t_ns, DISPLACED_S)
    doubted = tuple(i for i in off if is_new or i in doubted)
    if not doubted or len(heard) - len(off) >= max(LEAST_ANCHORS, len(off) + 1):
        return (), ""
    sizes = " and ".join(f"{belief.x[B_RANGE + i]:+.1f}" for i in off)
    return doubted, (
        f"ranges of {len(off)} of {len(heard)} anchors are off by {sizes} m since they moved the boat, and nobody can"
        " tell which are right: anchors elsewhere than in the site file, or ranges of another scale; put that right and"
        " restart the boat's program, which finds its place anew"
    )


def _report(state: MotionState) -> MonitorReport:
    return MonitorReport({"untrusted": state.findings[0].text}) if state.findings else NOTHING
