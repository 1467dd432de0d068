"""Every mode with every event through the real `Pilot.step`: the table's mode, and no motion after neutral was due."""

from dataclasses import replace as with_settings
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from msgspec.structs import replace

from companion.boat.load_run import setup_of
from companion.core import messages as m
from companion.core.excitation.file import Steps, excitation_toml
from companion.core.excitation.flight import FlightState
from companion.core.pilot.annunciator import AnnunciatorState
from companion.core.pilot.autopilot_state import AutopilotState
from companion.core.pilot.manual_control import Sticks
from companion.core.pilot.modes import EVENTS, MODES, NEEDS, OVER, TABLE, THRUSTERS, WANTED, ModeState
from companion.core.pilot.monitors.battery import BatteryState
from companion.core.pilot.monitors.link_latency import NO_ANSWER
from companion.core.pilot.monitors.loop_lag import LATE_TICKS, LoopLag
from companion.core.pilot.monitors.override_monitor import OverrideState
from companion.core.pilot.monitors.plan_gap import ControllerTime
from companion.core.pilot.pilot import Pilot
from tests.companion.core.pilot.pilot_shell import Shell, attitude, heartbeat, operator, plan, sensors, stick
from tests.companion.core.pilot.trust_fixture import in_trouble
from tests.support.drive_fixture import setup, under_way
from tests.support.excitation_fixture import of

S, MS = 1_000_000_000, 1_000_000
OPERATOR = ("stop", "start", "hold", "excite", "manual")
PLAN = of(Steps(name="ahead", X=0.15, levels=(1.0, -1.0), hold_s=30.0))
FAR = ((100.0, 100.0), (110.0, 100.0), (110.0, 110.0))
SENT = {**dict.fromkeys(range(1, 17), 0), **dict.fromkeys((1, 2, 3, 4, 9, 10, 11, 12), 1500)}


@cache
def minds() -> tuple[Pilot, Pilot]:
    """With the basin's fence, and with one that the boat is beyond."""
    told = setup()
    texts = {**told.files, "excitation.toml": excitation_toml(PLAN)}
    settings = setup_of(texts, {name: name for name in texts}).pilot
    return Pilot(settings), Pilot(with_settings(settings, excitation=None, site=replace(settings.site, fence=FAR)))


class Boat(Shell):
    """A shell whose pilot can be changed, and that keeps all but the tested thing as it should be."""

    def __init__(self, mode, *, held=0.5):
        state, t_ns = under_way()
        self.mind, self.sticks, self.heartbeats = minds()[0], held, True
        at_hand = Sticks(stick(t_ns, held), rested=mode == "manual")
        helm = ModeState(mode, "hold", "because")
        beat = heartbeat(t_ns)
        flying = FlightState(phase="fly", t_ns=t_ns, f_n=(0.0,) * 4)
        autopilot = replace(state.monitor(AutopilotState), heartbeat=beat)
        state = state.with_monitors(autopilot, at_hand, ControllerTime(since_ns=t_ns))
        state = replace(state, helm=helm, last_status=(mode, t_ns), flight=flying, plan=None, asked=(),
                        guidance=type(state.guidance)(), plan_ns=t_ns, open_tick=None)  # fmt: skip
        super().__init__(state, t_ns, index=5000)

    def feed(self, *inputs):
        self.state, outputs = self.mind.step(self.state, inputs, self.t_ns)
        self.outputs += outputs
        self.leases += [o for o in outputs if isinstance(o, m.OverrideLease)]
        return outputs

    def tick(self, lateness_ms=0):
        """One period: heartbeat, sensors of a boat at rest, sticks, tick, and the plan or its deadline."""
        self.t_ns += 100 * MS
        self.index += 1
        if self.heartbeats:
            self.feed(replace(self.state.monitor(AutopilotState).heartbeat, t_ns=self.t_ns))
        if self.sticks is not None:
            self.feed(stick(self.t_ns, self.sticks))
        before = len(self.leases)
        self.feed(m.Tick(t_ns=self.t_ns, index=self.index, lateness_ns=lateness_ms * MS))
        if self.state.open_tick is not None:
            self.feed(plan(self.index, self.t_ns))
        assert len(self.leases) == before + 1 and self.leases[-1].index == self.index

    @property
    def mode(self):
        return self.state.helm.mode

    @property
    def moves(self):
        return self.leases[-1].pwm_us != (1500,) * 8


def change(boat, **fields):
    boat.state = replace(boat.state, **fields)


def monitors(boat, *states):
    boat.state = boat.state.with_monitors(*states)


def lasting(boat, condition):
    change(boat, helm=replace(boat.state.helm, lasting=boat.state.helm.lasting | {condition}))


def cause(boat, event):  # noqa: PLR0912, PLR0915
    """Bring the event about, by messages where there are any, else by what the next tick looks at."""
    t_ns, state = boat.t_ns, boat.state
    match event:
        case "stop" | "start" | "hold" | "excite" | "manual":
            boat.feed(operator(event, t_ns))
        case "disarmed":
            boat.feed(heartbeat(t_ns, armed=False))
        case "mode_changed":
            boat.feed(heartbeat(t_ns, mode=4))
        case "rc_takeover":
            for pwm in (1500, 1800):
                boat.feed(m.RcChannels(t_ns=t_ns, pwm_us=tuple({**SENT, 6: pwm}.values())))
        case "link_lost" | "expired":
            boat.heartbeats, silent_s = False, 4 if event == "link_lost" else 11
            monitors(boat, replace(state.monitor(AutopilotState), heartbeat=heartbeat(t_ns - silent_s * S)))
        case "unfit":
            change(boat, estimator=boat.mind.initial(0).estimator)
        case "degraded":
            monitors(boat, replace(state.monitor(AnnunciatorState), degraded_ns=None))
            sensors(boat, 4000)
            monitors(boat, ControllerTime(since_ns=boat.t_ns))
            change(boat, plan_ns=boat.t_ns, flight=replace(state.flight, t_ns=boat.t_ns))
            boat.feed(heartbeat(boat.t_ns), stick(boat.t_ns, boat.sticks))
            monitors(boat, replace(boat.state.monitor(Sticks), rested=state.monitor(Sticks).rested))
        case "fence_breached":
            boat.mind = minds()[1]
        case "battery_low":
            monitors(boat, BatteryState(13.9, low=True, low_ns=0))
        case "battery_critical":
            monitors(boat, BatteryState(13.0, critical=True, critical_ns=0))
        case "override_ignored":
            monitors(boat, replace(state.monitor(OverrideState), rc_ignored=True, rc_why="not taken"))
        case "outputs_cut":
            boat.feed(m.MotorOutputs(t_ns=t_ns, enabled=False))
        case "outputs_still":
            boat.feed(m.StatusText(t_ns=t_ns, severity=2, text="Scripting: stopped"))
        case "interlock_trip":
            boat.feed(m.InterlockTrip(t_ns=t_ns, why="the autopilot's parameter SERVO1_FUNCTION is 59 now"))
        case "solver_failing":
            monitors(boat, ControllerTime(since_ns=t_ns - 10 * S))
            change(boat, plan_ns=0)
        case "loop_lag":
            monitors(boat, LoopLag(late_ticks=LATE_TICKS))
        case "link_late":
            monitors(boat, NO_ANSWER)
            heard = [t_ns - k * 250 * MS for k in (4, 3, 2, 1, 0)]
            boat.feed(*(m.TimeSync(t_ns=rx_ns, tc1_ns=1, ts1_ns=rx_ns - S) for rx_ns in heard))
        case "untrusted" | "crippled":
            monitors(boat, in_trouble(state, event, t_ns))
        case "sticks_lost":
            boat.sticks = None
            monitors(boat, replace(state.monitor(Sticks), last=stick(t_ns - S, 0.5)))
        case "ready":
            boat.sticks = 0.0
        case "finished":
            change(boat, flight=FlightState(phase="done", t_ns=t_ns))
        case _:
            (begun,) = (b for b, o in OVER.items() if o == event)
            lasting(boat, begun)


POSSIBLE = {
    "solver_failing": ["auto", "hold"],
    "ready": ["starting", "locked"],
    "expired": ["starting"],
    "finished": ["excitation"],
    "sticks_lost": ["manual"],
}
"""Events that only some modes can meet in the pilot: without a controller no solver fails. The table has them all."""


@pytest.mark.parametrize(("mode", "event"), [(mode, event) for mode in MODES for event in EVENTS])
def test_every_pair_through_the_pilot(mode, event):
    if mode not in POSSIBLE.get(event, MODES):
        assert TABLE[mode, event].next == mode
        return
    boat = Boat(mode)
    if mode == "paused" and event != "healthy":
        lasting(boat, "degraded")
    if event == "excite":
        change(boat, flight=FlightState())
    cause(boat, event)
    at_once = boat.mode
    told = TABLE[mode, event].next
    expected = boat.state.helm.wanted if told == "wanted" else told
    boat.tick(100 if event == "loop_lag" else 0)
    after = boat.mode
    if mode == "paused" and event not in ("healthy", "degraded") and expected == "paused":
        expected = "excitation"  # the boat of this test is healthy: the tick says so itself
    if event in (*OPERATOR, "disarmed", "mode_changed", "rc_takeover", "outputs_still", "interlock_trip"):
        assert at_once == (TABLE[mode, event].next if mode != "paused" else at_once)
    if expected == "starting" and at_once in ("starting", mode):
        waits = event in (NEEDS["auto"] | {"mode_changed"}) - {"fence_breached", "battery_critical", "outputs_cut"}
        assert after == ("starting" if waits else boat.state.helm.wanted), "all else is ready in this test"
        assert event not in WANTED or after == WANTED[event]
    else:
        assert after == expected
    assert boat.moves <= (THRUSTERS[after] != "neutral"), "motion in a mode that does not drive"
    assert (boat.leases[-1].source == "neutral") == (THRUSTERS[after] == "neutral")
    statuses = [o for o in boat.outputs if isinstance(o, m.ModeStatus)]
    assert (mode == after or bool(statuses)) and all(s.driving == (THRUSTERS[s.mode] != "neutral") for s in statuses)
    if after in ("safe", "idle", "locked"):
        rests(boat, after)


def rests(boat, mode):
    """Two seconds of good links, fresh plans and held sticks: nothing moves, nothing is asked of the autopilot."""
    boat.heartbeats, boat.sticks, boat.mind = True, 0.5, minds()[0]
    asked = len(boat.outputs)
    for _ in range(20):
        boat.tick()
        boat.feed(heartbeat(boat.t_ns), plan(boat.index, boat.t_ns))
        assert boat.mode == mode and not boat.moves
    later = boat.outputs[asked:]
    assert not [o for o in later if isinstance(o, (m.SolveRequest, m.GuidanceReference))]
    if mode != "locked":
        assert not [o for o in later if isinstance(o, m.VehicleRequest)]


# --- by hand --------------------------------------------------------------------------------------------


def test_by_hand_from_idle_to_motion_and_back():
    boat = Boat("idle", held=0.0)
    boat.feed(operator("manual", boat.t_ns))
    assert boat.mode == "locked"
    boat.tick()
    assert boat.mode == "manual" and not boat.moves, "at rest it is free, and at rest it stays"
    boat.sticks = 0.5
    for _ in range(8):
        boat.tick()
    forces = [lease.f_command_n for lease in boat.leases[-8:]]
    assert boat.leases[-1].source == "manual" and boat.leases[-1].reason == "pad"
    assert forces[-1] == pytest.approx((0.5 * 38,) * 4, abs=0.1)
    steps = np.diff([(0.0,) * 4, *forces], axis=0)
    assert abs(steps).max() <= 12.0 + 1e-9, "120 N/s, a tenth of a second"
    boat.sticks = None
    for _ in range(5):
        boat.tick()
    assert boat.mode == "manual", "0.5 s are not over"
    boat.tick()
    assert boat.mode == "locked" and not boat.moves
    boat.sticks = 0.5
    for _ in range(5):
        boat.tick()
        assert boat.mode == "locked" and not boat.moves
    for boat.sticks in (0.0, 0.5):
        boat.tick()
    assert boat.mode == "manual" and boat.moves


def test_sticks_that_are_held_as_manual_is_asked_for_do_not_count():
    boat = Boat("auto", held=0.0)
    boat.tick()
    boat.sticks = 0.9
    boat.tick()
    boat.feed(operator("manual", boat.t_ns))
    for _ in range(10):
        boat.tick()
        assert boat.mode == "locked" and not boat.moves


def test_by_hand_no_plan_is_asked_for_and_a_late_one_is_not_sent():
    boat = Boat("manual")
    boat.tick()
    boat.feed(plan(boat.index, boat.t_ns))
    assert boat.leases[-1].source == "manual"
    assert not [o for o in boat.outputs if isinstance(o, (m.SolveRequest, m.GuidanceReference))]


def test_the_open_tick_of_the_mission_ends_in_neutral_when_the_sticks_take_over():
    boat = Boat("auto", held=0.0)
    boat.t_ns += 100 * MS
    boat.feed(heartbeat(boat.t_ns), m.Tick(t_ns=boat.t_ns, index=1))
    boat.feed(operator("manual", boat.t_ns))
    boat.feed(plan(1, boat.t_ns))
    assert boat.leases[-1].index == 1 and not boat.moves


def test_the_mode_is_told_at_every_change_and_once_a_second():
    boat = Boat("auto")
    for _ in range(35):
        boat.feed(attitude(boat))
        boat.tick()
    told = [o for o in boat.outputs if isinstance(o, m.ModeStatus)]
    assert [s.mode for s in told] == ["auto"] * 3 and all(b.t_ns - a.t_ns == S for a, b in pairwise(told))
    boat.feed(operator("stop", boat.t_ns))
    (last,) = [o for o in boat.outputs if isinstance(o, m.ModeStatus)][3:]
    assert (last.mode, last.driving, last.why) == ("idle", False, "stopped by the operator")
