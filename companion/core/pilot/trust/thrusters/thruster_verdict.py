"""What the thruster bank has found out: which hypothesis is believed, what follows for allocation, and the sentence for
the operator."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import msgspec
import numpy as np
from msgspec.structs import replace

from companion.core.configuration.vessel_file import VesselFile
from companion.core.estimation.filter_state import FilterState
from companion.core.estimation.health import DISPLACED_S
from companion.core.messages import Alert
from companion.core.pilot.monitors.monitor import NOTHING, MonitorReport, TickView
from companion.core.pilot.trust.thrusters.hypothesis_bank import BankState, ThrusterBank, ThrustHypothesis
from companion.core.pilot.trust.thrusters.remaining_thrust import ThrusterHealth, gain_words
from companion.core.pilot.trust.thrusters.stuck_force import NO_FORCE_SHARE, another_force
from companion.core.pilot.trust.verdict import Finding

SURE_NATS, AHEAD_NATS = 15.0, 5.0
"""So much for a hypothesis against `sound`, and against the next one; assumed: beyond 1 in a million by chance."""
ROUGH_NATS = 20.0
"""So much for one that is stuck, in waves that were larger than the noise before it began to look so: gusts may push as
steadily for some seconds. Assumed: in 24 h of weather, with hull and thrusters off by 20 %, a sound boat reached 17."""
PUSH_NATS = 10.0
"""So much ahead of a push a thruster must be: one that pushes along a thruster, with its lever, looks like it until the
commands change. Assumed: such pushes were up to 9 behind; thrusters that are wrong are ahead by 10 as soon as by 5.
`AHEAD_NATS` suffice for one that sticks at more than can be borne: it drives the boat out meanwhile, and either way
ends in neutral."""
FALLEN_NATS = 3.0
"""A hypothesis that has lost so much since its best is no longer what happens: a push that is over leaves some behind.
Assumed."""
ASK_NATS = 5.0
"""From so much on forces that cancel each other are commanded, which tell one thruster from the others; assumed."""
FINE_GAIN, SPARED_GAIN, DEAD_GAIN, REVERSED_GAIN = 0.75, 0.3, 0.2, -0.25
"""A gain above the first is fine; below the second a thruster that can be spared is dead, for it would take three times
its pulse; below the third any is; below the last it is reversed. Assumed."""
LEAST_TICKS = 10
"""A bank that begins has not seen how much residuals change; assumed."""
WAVE_TICKS, PUSHED_NATS = 30, 40.0
"""A push, or a bad accelerometer, needs so many residuals and nats, which tell it from waves: those of 0.2 m make up to
25 nats within their first periods."""
DOUBT_NS = 2_000_000_000
"""So long after sensors contradicted each other the sums forget what came of that; assumed."""
QUIET_NS = 1_000_000_000
"""Dead time, lag and filters together; assumed."""
BEARABLE_SHARE = 0.3
"""A thruster that is stuck at more than this share of its limit cannot be held against without great effort."""


class TickMotion(NamedTuple):
    """What a tick leaves to the bank: the filter at the last tick and at this one, mean specific force between [m/s^2],
    and the slope of the yaw rate.
    """

    before: FilterState
    now: FilterState
    force_m_s2: np.ndarray
    r_dot_rad_s2: float
    view: TickView


class ThrusterState(msgspec.Struct, frozen=True, eq=False):
    """`bank`; what has come since the last tick: `force`, `count` of samples, `rates` (instant, r) of the attitudes;
    `before`: the filter at the last tick, and its yaw rate; `health`: what is known; `probing`: forces that cancel
    each other are commanded, to tell one thruster from another; `quiet_until_ns`: commands of before the latest
    change are still under way; `suspected`: hypotheses that explain it alike, in words, since they were told of;
    `doubted_ns`: when sensors last may have contradicted each other;
    `accel_off`: the accelerometer is left out until the next start; `pending`: of the last tick, not yet in the bank.
    """

    bank: BankState
    health: ThrusterHealth
    force: tuple[float, float, float] = (0.0, 0.0, 0.0)
    count: int = 0
    rate: tuple[int, float] | None = None
    rate_before: tuple[int, float] | None = None
    before: FilterState | None = None
    findings: tuple[Finding, ...] = ()
    hopeless: str = ""
    probing: bool = False
    quiet_until_ns: int = 0
    suspected: str = ""
    doubted_ns: int | None = None
    accel_off: bool = False
    pending: TickMotion | None = None

    def has_changed(self, t_ns: int) -> bool:
        """Whether one has just been found: commands of before are still under way."""
        return 0 < self.quiet_until_ns - t_ns <= QUIET_NS


class ThrusterVerdicts:
    """The judge of a bank's filters: believes, asks, or waits."""

    def __init__(self, vessel: VesselFile, bank: ThrusterBank):
        self._vessel, self._bank = vessel, bank
        self._knowing = lru_cache(maxsize=8)(lambda sticks: ThrusterBank(bank.B, bank.M, sticks))
        self._names = [t.name for t in vessel.thrusters]
        rank, n = np.linalg.matrix_rank(bank.B), bank.B.shape[1]
        self._spared = [np.linalg.matrix_rank(np.delete(bank.B, i, axis=1)) == rank for i in range(n)]
        self._sound, self._pushed = (bank.hypotheses.index(ThrustHypothesis(kind)) for kind in ("sound", "pushed"))

    def bank(self, health: ThrusterHealth) -> ThrusterBank:
        """The bank that knows which thrusters stick."""
        sticks = tuple(i for i, force_n in enumerate(health.stuck_n) if force_n is not None)
        return self._knowing(sticks) if sticks else self._bank

    def initial(self, health: ThrusterHealth) -> BankState:
        """That bank, where nothing has been seen yet."""
        return self.bank(health).initial(health.stuck_n)

    def is_bearable(self, i: int, stuck_n: float | None) -> bool:
        """Whether the others can hold against thruster `i`, stuck at this force (None: not stuck)."""
        return stuck_n is None or abs(stuck_n) <= BEARABLE_SHARE * self._vessel.thrusters[i].most_N

    def may_be_speed(self, bank: BankState) -> bool:
        """Whether the best explanation is one that the error of a speed looks like: a push, or the accelerometer."""
        best = int(np.argmax(bank.nats))
        return bool(bank.nats[best] >= ASK_NATS) and not self._bank.hypotheses[best].blames_thrust

    def judge(self, state: ThrusterState, view: TickView) -> tuple[ThrusterState, MonitorReport]:
        """What the bank says now, whose latest residual is of this tick."""
        nats, kinds = state.bank.nats, self._bank.hypotheses
        order = np.argsort(nats)[::-1]
        best = order[0]
        report = report_of(state)
        near = [k for k in order if nats[k] > nats[best] - AHEAD_NATS]
        asks = any(nats[k] >= ASK_NATS and kinds[k].is_thruster for k in near) and not view.suspect
        state = replace(state, probing=asks, doubted_ns=view.t_ns if view.suspect else state.doubted_ns)
        if nats[best] < SURE_NATS or state.bank.count < LEAST_TICKS:
            return (state, report) if nats[best] >= ASK_NATS else self._refined(state, view)
        dead = [k for k in near if kinds[k].i == kinds[best].i and self._says_dead(state, k)]
        if best in dead:  # to give nothing of what is asked for, and to be stuck at nothing, is the same
            near = [k for k in near if k not in dead]
            best = min(k for k in dead if nats[k] >= SURE_NATS)  # gains stand before what sticks
        elif kinds[best].kind == "stuck" and nats[best] < ROUGH_NATS and state.bank.rough_s > state.bank.age_s[best]:
            return state, report
        if kinds[best].blames_thrust and nats[best] < state.bank.peak[best] - FALLEN_NATS:
            return state, report
        best, rivals = self._rivals(state, best, [k for k in near if k != best])
        is_settled = view.belief is not None and view.belief.settled
        may_be_waves_or_speed = state.bank.count < WAVE_TICKS or nats[best] < PUSHED_NATS or not is_settled
        if not rivals and not kinds[best].blames_thrust and may_be_waves_or_speed:
            return state, report
        sensors = self._may_be_sensors(state, view, best)
        if rivals or sensors:
            return self._undecided(state, [kinds[best], *rivals], view, sensors=sensors)
        return self.found(state, int(best), view)

    def _may_be_sensors(self, state: ThrusterState, view: TickView, best: int) -> bool:
        """Whether what speaks for `best` may have come of sensors. A thruster that nobody can hold against is named as
        the speed that a displaced position left behind is still doubtful: it would push the boat out meanwhile.
        """
        if state.doubted_ns is not None and 0 <= view.t_ns - state.doubted_ns < DOUBT_NS:
            return True
        h, force_n = self._bank.hypotheses[best], float(state.bank.mean[best, -1])
        displaced = view.belief is not None and view.belief.was_displaced(view.t_ns, DISPLACED_S)
        return displaced and not (h.kind == "stuck" and not self.is_bearable(h.i, force_n))

    def _rivals(self, state: ThrusterState, best: int, near: list[int]) -> tuple[int, list[ThrustHypothesis]]:
        """What to believe, and what explains it as well, of the `best` and those that are near it."""
        nats, kinds, h = state.bank.nats, self._bank.hypotheses, self._bank.hypotheses[best]
        rivals = [kinds[k] for k in near if k != self._pushed]
        is_unbearable = h.kind == "stuck" and not self.is_bearable(h.i, float(state.bank.mean[best, -1]))
        ahead = AHEAD_NATS if is_unbearable else PUSH_NATS
        if h.blames_thrust and 0.0 < nats[self._pushed] > nats[best] - ahead:
            rivals.append(kinds[self._pushed])
        if h.kind == "pushed" and rivals and all(r.blames_accelerometer for r in rivals):
            return kinds.index(rivals[0]), []  # without the accelerometer the filter follows a push as well
        if h.blames_accelerometer:  # however it is wrong, it is left out
            rivals = [r for r in rivals if not r.blames_accelerometer]
        return best, rivals

    def _says_dead(self, state: ThrusterState, k: int) -> bool:
        """Whether by hypothesis `k` a thruster gives nothing."""
        h, mean = self._bank.hypotheses[k], state.bank.mean[k]
        if h.kind == "gain":
            return self._is_dead(h.i, abs(state.health.gains[h.i]) * (1.0 + float(mean[3 + h.i])))
        if h.kind != "stuck":
            return False
        force_n, most_n = abs(float(mean[-1])), self._vessel.thrusters[h.i].most_N
        at_least_n = force_n - 2.0 * float(np.sqrt(state.bank.P[k, -1, -1]))
        return at_least_n < NO_FORCE_SHARE * most_n and force_n < BEARABLE_SHARE / 2 * most_n

    def _is_dead(self, i: int, gain: float) -> bool:
        return REVERSED_GAIN < gain < (SPARED_GAIN if self._spared[i] else DEAD_GAIN)

    def _undecided(
        self, state: ThrusterState, rivals: list[ThrustHypothesis], view: TickView, *, sensors: bool = False
    ) -> tuple[ThrusterState, MonitorReport]:
        """Several explain it alike, or sensors may."""
        if state.suspected:
            return state, report_of(state)
        words = [_words(h, self._names) for h in rivals[:3]] + ["sensors contradict each other"] * sensors
        suspected = " or ".join(words)
        alert = Alert(t_ns=view.t_ns, level="warning", text=f"the boat does not do what it is told: {suspected}")
        return replace(state, suspected=suspected), report_of(state, alert)

    def found(self, state: ThrusterState, k: int, view: TickView) -> tuple[ThrusterState, MonitorReport]:
        """Hypothesis `k` explains it."""
        h, mean, health = self._bank.hypotheses[k], state.bank.mean[k], state.health
        nats = float(state.bank.nats[k])
        gains, stuck, order = list(health.gains), list(health.stuck_n), list(health.order)
        hopeless, cause, what, text = state.hopeless, "thruster", h.kind, _words(h, self._names)
        if h.kind == "gain":
            gain, what = 1.0 + float(mean[3 + h.i]), self._names[h.i]
            if gain > FINE_GAIN and (gain < 1 / FINE_GAIN or abs(gains[h.i]) > FINE_GAIN):
                return state, NOTHING
            gain = 0.0 if self._is_dead(h.i, abs(gains[h.i]) * gain) else max(-1.0, gain)
            gains[h.i] *= -1.0 if gain < 0 else gain
            if gain > 1.0:  # one that was weak has come to its force again
                share = 1.0 if abs(gains[h.i]) > FINE_GAIN else abs(gains[h.i])
                gains[h.i] = math.copysign(share, gains[h.i])
                text = f"thruster {what} gives {100 * share:.0f} % of its force again"
            else:
                words = gain_words(-1.0 if gain < 0 else abs(gains[h.i]))
                text = f"thruster {what} {words}; the others take over{'' if self._spared[h.i] else ' what they can'}"
        elif h.kind == "stuck":
            what = self._names[h.i]
            stuck[h.i] = force = float(mean[-1])
            text = f"thruster {what} is stuck at {force:.0f} N whatever it is told"
            hopeless = hopeless if self.is_bearable(h.i, force) else f"{text}; cut its power"
        elif h.kind == "swap":
            order = [{h.i: h.j, h.j: h.i}.get(k, k) for k in order]
            text = f"{text}: each gets the other's pulse"
        elif h.kind == "reversed":
            gains = [-g for g in gains]
            text = "all thrusters push the wrong way; their pulses are turned round"
        elif h.blames_accelerometer:
            cause, what, text = "sensor", "accel", f"{text}: left out until the next start"
        else:
            cause, text = "surroundings", "something pushes the boat harder than water and wind usually do"
        if cause != "thruster":
            return self._elsewhere(state, Finding(cause, what, text, view.t_ns, nats), view)
        finding = Finding("thruster", what, text, view.t_ns, nats)
        alert = Alert(t_ns=view.t_ns, level="error", text=f"{text} ({nats:.0f} nats)")
        state = replace(state, findings=(*state.findings, finding), hopeless=hopeless, suspected="")
        health = ThrusterHealth(tuple(gains), tuple(stuck), tuple(order))
        return self._known(state, health, self.initial(health), alert, view)

    def _refined(self, state: ThrusterState, view: TickView) -> tuple[ThrusterState, MonitorReport]:
        """With the force of a thruster that is known to stick, where that is another one than was believed. Every
        hypothesis has it already: the bank need not begin anew.
        """
        another = another_force(state.bank, state.health, self._vessel)
        if another is None or state.bank.count < LEAST_TICKS or self._may_be_sensors(state, view, self._sound):
            return state, report_of(state)
        (i, force_n), stuck = another, list(state.health.stuck_n)
        is_bearable, text = self.is_bearable(i, force_n), f"thruster {self._names[i]} is stuck at {round(force_n)} N"
        level, told = "warning" if is_bearable else "error", f"{text}, not {round(stuck[i] or 0.0)} N"
        stuck[i] = force_n
        state = replace(state, hopeless=state.hopeless if is_bearable else f"{text}; cut its power")
        health = replace(state.health, stuck_n=tuple(stuck))
        return self._known(state, health, state.bank, Alert(t_ns=view.t_ns, level=level, text=told), view)

    def _known(
        self, state: ThrusterState, health: ThrusterHealth, bank: BankState, alert: Alert, view: TickView
    ) -> tuple[ThrusterState, MonitorReport]:
        """From now on with this health."""
        stuck = health.stuck_n
        state = replace(
            state, bank=bank, health=health, probing=False, quiet_until_ns=view.t_ns + QUIET_NS,
            hopeless="" if all(map(self.is_bearable, range(len(stuck)), stuck)) else state.hopeless,
        )  # fmt: skip
        return state, report_of(state, alert)

    def _elsewhere(self, state: ThrusterState, finding: Finding, view: TickView) -> tuple[ThrusterState, MonitorReport]:
        """Not a thruster: told once."""
        if any(f.what == finding.what for f in state.findings):
            return state, NOTHING
        alert = Alert(t_ns=view.t_ns, level="warning", text=f"{finding.text} ({finding.nats:.0f} nats)")
        state = replace(state, accel_off=state.accel_off or finding.cause == "sensor")
        return replace(state, findings=(*state.findings, finding)), MonitorReport(alerts=(alert,))


def report_of(state: ThrusterState, *alerts: Alert) -> MonitorReport:
    """The condition that holds, and alerts."""
    return MonitorReport({"crippled": state.hopeless} if state.hopeless else {}, alerts)


def _words(h: ThrustHypothesis, names: list[str]) -> str:
    """A hypothesis in words."""
    one, other = (names[h.i], names[h.j]) if h.is_thruster else ("", "")
    return {
        "gain": f"thruster {one} gives another force",
        "stuck": f"thruster {one} is stuck",
        "swap": f"thrusters {one} and {other} have changed places",
        "reversed": "all thrusters are reversed",
        "pushed": "something pushes it",
        "accel": "the accelerometer is wrong",
        "askew": "the accelerometer is wrong (its axes are turned or exchanged)",
    }[h.kind]
