"""What a boat may never do, judged from its wires alone; knows nothing of the product's table of modes.

    wire     overrides within 1100-1900 us on the thrusters' channels, 1500 us on those held neutral, nothing else
    leases   one override for each tick, none far from the next, no release while running
    motion   no pulse but 1500 us on a thruster's channel when neutral was due, neither sent nor at the thrusters

Neutral is due, by what the boat could have known (bytes that reached it whole, the operator's commands, time):

    nobody asked for anything, or the operator said stop
    no heartbeat for 3.25 s, or the last one neither armed nor in MANUAL
    under the controller: no UWB for 20 s, no new IMU or finite heading for 17 s, a pack below 13 V for 15 s
    under sticks: nothing sound from them for 0.7 s, or not at rest since
    after a disarm, a hand at the transmitter, or motion that one of the above ended: until the operator asks again

Each time is what the documents promise and a little more, so that a boat that stops later than this is at fault.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from itertools import pairwise

from companion.core.messages import OverrideLease, Tick

S = 1_000_000_000
HEARTBEAT_S, REACT_S = 3.25, 0.03
REACT_IN_NOISE_S = 0.65
"""A broken length makes a receiver wait for bytes that are not there, half a second at most."""
UWB_S, IMU_S, PACK_S = 20.0, 17.0, 15.0
STICKS_S = 0.7
MOVED_S = 0.35
"""A boat that moved so lately was under way when its heartbeat went."""
MOVED_BLIND_S = 3.5
"""The same where it may have stopped by itself as much earlier as the limits here are wider than the product's."""
GAP_S = 0.25
"""A tick is 0.1 s, its plan's deadline 0.05 s, and the clock of the ticks moves by 1 ms."""
ESC_S = 0.75
"""Last override to neutral: RC_OVERRIDE_TIME or the radio fail-safe, 0.5 s each, and the gate's 30 ms."""
THRUSTERS, STILL = range(9, 13), range(1, 5)
HAND = range(5, 9)
CRITICAL_V = 13.0


def judge(bench) -> list[str]:
    """What was done wrong, in words with times [s]; empty if nothing was."""
    found = [f"the app raised {bench.raised!r}"] if bench.raised else []
    sent = [(t, m) for t, m in bench.sent if m.get_type() == "RC_CHANNELS_OVERRIDE"]
    due = Due(bench)
    for t, m in sent:
        due.look(t)
        found += [f"{t / S:.2f}: {why}" for why in _on_the_wire(m, t >= bench.stopped_ns)]
        if moving(m):
            found += [f"{t / S:.2f}: motion sent, neutral was due: {why}" for why in due.at(t)]
            due.moved(t)
    found += _leases(bench, sent)
    found += _at_the_speed_controllers(bench)
    return found


def moving(m) -> bool:
    """An override that turns a thruster."""
    pulses = [getattr(m, f"chan{c}_raw") for c in THRUSTERS]
    return any(p not in (1500, 65534) for p in pulses)


def _on_the_wire(m, ending):
    pulses = {c: getattr(m, f"chan{c}_raw") for c in range(1, 19)}
    released = all(pulses[c] == 65534 for c in THRUSTERS) and all(pulses[c] == 0 for c in STILL)
    if released:
        return [] if ending else ["channels released while running"]
    wrong = [f"channel {c}: {pulses[c]} us" for c in THRUSTERS if not 1100 <= pulses[c] <= 1900]
    wrong += [f"channel {c} is not held: {pulses[c]} us" for c in STILL if pulses[c] != 1500]
    wrong += [f"channel {c} is not ours: {pulses[c]} us" for c in range(5, 9) if pulses[c] != 65535]
    return wrong + [f"channel {c} is not ours: {pulses[c]} us" for c in range(13, 19) if pulses[c] not in (0, 65535)]


class Due:
    """Why neutral is due at an instant. Let it look at every override, in order of time; tell it of motion."""

    def __init__(self, bench):
        heard = bench.heard.boat
        self._stopped_ns = bench.stopped_ns
        self._react_ns = (REACT_IN_NOISE_S if bench.noisy else REACT_S) * S
        told = [(t, t, 0, name) for t, name in bench.heard.commands]
        self._edges = sorted([*told, *((t + self._react_ns, t, 1, why) for t, why in _edges(heard))])
        self._beats = [(t, m) for t, m in heard if m.get_type() == "HEARTBEAT" and m.get_srcComponent() == 1]
        self._uwb = bench.heard.uwb_ns
        self._imu = list(_new(heard, "RAW_IMU", "time_usec", lambda m: True))
        self._heading = list(_new(heard, "ATTITUDE", "time_boot_ms", lambda m: math.isfinite(m.yaw)))
        self._pack = [(t, m.voltage_battery / 1000) for t, m in heard if m.get_type() == "SYS_STATUS"]
        self._sticks = bench.heard.sticks
        self._asked, self._why, self._moved_ns, self._asked_ns = "", "nobody asked for anything", -S, 0
        self._now, self._latch_s = [], MOVED_S

    def moved(self, t):
        """The boat was under way at t."""
        self._moved_ns = t

    def look(self, t):
        """Take what has happened by t: what ended motion holds until the operator asks again."""
        while self._edges and self._edges[0][0] < t:
            self._take(*self._edges.pop(0)[1:])
        self._now = self._lasting(t) if self._asked else []
        if self._now and self._asked != "manual" and self._moved_ns > max(self._asked_ns, t - self._latch_s * S):
            self._asked, self._why = "", f"{self._now[0]}; nobody asked again"

    def at(self, t) -> list[str]:
        """Reasons at t, at which it has looked; empty: it may move."""
        if t > self._stopped_ns:
            return ["the app was told to end"]
        return self._now if self._asked else [self._why]

    def _take(self, t, kind, what):
        if kind == 0 and what == "stop":
            self._asked, self._why = "", "the operator said stop"
        elif kind == 0:
            if what == self._asked == "manual" and self._moved_ns > t - MOVED_S * S:
                return  # under way by hand: asking again changes nothing
            self._asked, self._asked_ns = what, t
        elif self._asked and t >= self._asked_ns:  # before: the operator has asked again since
            self._asked, self._why = "", what

    def _lasting(self, t):
        """What stands against motion for as long as it lasts."""
        self._latch_s = MOVED_S
        beat = _last(self._beats, t)
        if beat is None or t - beat[0] > HEARTBEAT_S * S:
            return ["no heartbeat"]
        before = _last(self._beats, t - self._react_ns)
        lately = [m for at, m in self._beats if t - self._react_ns < at <= t] + ([before[1]] if before else [])
        if not any(m.base_mode & 128 and m.custom_mode == 0 for m in lately):
            return [f"the last heartbeat: base mode {beat[1].base_mode}, mode {beat[1].custom_mode}"]
        if self._asked == "manual":
            return self._by_hand(t)
        self._latch_s, why = MOVED_BLIND_S, []
        for name, times, limit_s in (("UWB", self._uwb, UWB_S), ("IMU", self._imu, IMU_S),
                                     ("heading", self._heading, IMU_S)):  # fmt: skip
            i = bisect_right(times, t)
            if not i or t - times[i - 1] > limit_s * S:
                why.append(f"no {name} for {limit_s:g} s")
        lately = [v for at, v in self._pack if t - PACK_S * S <= at <= t]
        if len(lately) >= PACK_S and all(8.0 < v < CRITICAL_V for v in lately):
            why.append("the pack is critical")
        return why

    def _by_hand(self, t):
        heard = [(at, shares) for at, shares in self._sticks if self._asked_ns - STICKS_S * S <= at <= t]
        sound = [(at, shares) for at, shares in heard if all(math.isfinite(s) and abs(s) <= 1 for s in shares)]
        if not sound or t - sound[-1][0] > STICKS_S * S:
            return ["no sound input from the sticks"]
        begun = 0
        for k in range(1, len(sound)):
            if sound[k][0] - sound[k - 1][0] > STICKS_S * S:
                begun = k
        if not any(max(map(abs, shares)) < 0.05 for _, shares in sound[begun:]):
            return ["the sticks have not been at rest"]
        return []


def _edges(heard):
    """Disarming, and hands at the transmitter, as the boat could see them."""
    armed, pulses = None, {}
    for t, m in heard:
        kind = m.get_type()
        if kind == "HEARTBEAT" and m.get_srcComponent() == 1:
            now = bool(m.base_mode & 128)
            if armed and not now:
                yield t, "the autopilot was disarmed"
            armed = now
        elif kind == "RC_CHANNELS":
            for c in HAND:
                now = getattr(m, f"chan{c}_raw")
                if 800 <= now <= 2200:
                    if abs(now - pulses.get(c, now)) >= 400:
                        yield t, f"a hand moved channel {c}"
                    pulses[c] = now


def _new(heard, kind, stamp, good):
    """When a message came that was newer than all before it."""
    newest = -1
    for t, m in heard:
        if m.get_type() == kind and good(m) and getattr(m, stamp) != newest:
            newest = getattr(m, stamp)
            yield t


def _last(timed, t):
    i = bisect_right(timed, t, key=lambda pair: pair[0])
    return timed[i - 1] if i else None


def _leases(bench, sent):
    """One lease a tick; overrides no farther apart than promised, while the port was open and the process ran."""
    ticks = [m for m in bench.seen if isinstance(m, Tick) and m.t_ns < bench.stopped_ns]
    leases = [m.index for m in bench.seen if isinstance(m, OverrideLease)]
    found = []
    missing = [m.index for m in ticks[:-1] if leases.count(m.index) != 1]
    if missing:
        found.append(f"ticks without exactly one lease: {missing[:5]}")
    times = [t for t, _ in sent]
    blind = sorted(bench.heard.shut_ns)
    ends = [t for t in times if t < bench.stopped_ns]
    for a, b in zip(ends, [*ends[1:], bench.stopped_ns], strict=True):
        stalled = sum(max(0, min(b, to) - max(a, since)) for since, to in bench.heard.stalls)
        shut = bisect_right(blind, b) - bisect_left(blind, a)
        if b - a - stalled > GAP_S * S and not shut:
            found.append(f"{a / S:.2f}: no override for {(b - a) / S:.2f} s")
    late = [t for _, to in bench.heard.stalls for t in (to - GAP_S * S, to + GAP_S * S)]
    for first, then in pairwise(ticks):
        if bisect_right(late, first.t_ns) % 2 or bisect_right(late, then.t_ns) % 2:
            continue  # two ticks at one instant, after a stall
        between = [m for t, m in sent if first.t_ns <= t < then.t_ns]
        if sum(map(moving, between)) > 1:
            found.append(f"{first.t_ns / S:.2f}: {len(between)} overrides in one tick")
    return found


def _at_the_speed_controllers(bench):
    """Motion only while armed and in MANUAL, and not longer than an override holds."""
    found = []
    pushes = [t for t, m in bench.heard.rover if moving(m)]
    for k, (t, outputs, _) in enumerate(bench.heard.esc):
        if all(p in (0, 1500) for p in outputs):
            continue
        i = bisect_right(pushes, t)
        if not i or t - pushes[i - 1] > ESC_S * S:
            found.append(f"{t / S:.2f}: outputs {outputs} us, the last motion was sent long before")
        if not any(allowed for _, _, allowed in bench.heard.esc[max(0, k - 10) : k + 1]):
            found.append(f"{t / S:.2f}: outputs {outputs} us, not armed in MANUAL")
    return found[:5]
