"""The pilot under histories that nobody planned: one lease a tick, neutral unless driving, nothing remembered aside."""

from __future__ import annotations

import math
import pickle

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from companion.core import messages as m
from companion.core.pilot.monitors.battery import BatteryState
from tests.support.drive_fixture import pilot, setup, under_way

S, MS = 1_000_000_000, 1_000_000
VESSEL = setup().pilot.vessel
CHANNELS = (9, 10, 11, 12, 1, 2, 3, 4)
N = len(VESSEL.thrusters)
NAN, INF = math.nan, math.inf


def heartbeat(t_ns, armed=True, mode=0):
    return m.Heartbeat(t_ns=t_ns, system=1, component=1, vehicle_type=11, autopilot=3, base_mode=0, custom_mode=mode,
                       system_status=4, armed=armed)  # fmt: skip


def plan(index, t_ns=0, status="ok", f_n=None):
    rows = tuple((float(k + 1),) * N for k in range(20)) if f_n is None else f_n
    return m.PlanResult(t_ns=t_ns, index=index, status=status, reason="because", solve_time_s=0.001, iterations=1,
                        cost=0.0, f_n=rows, x=())  # fmt: skip


def operator(command, t_ns=0):
    return m.OperatorCommand(t_ns=t_ns, command=command)


class Shell:
    """Feeds a pilot as a shell would, and holds every history to the rules."""

    def __init__(self, state, t_ns, index=0):
        self.state, self.t_ns, self.index = state, t_ns, index
        self.ticks, self.leases, self.outputs = [], [], []

    def feed(self, *inputs):
        self.state, outputs = pilot().step(self.state, inputs, self.t_ns)
        self.outputs += outputs
        self.ticks += [i.index for i in inputs if isinstance(i, m.Tick)]
        for lease in (o for o in outputs if isinstance(o, m.OverrideLease)):
            self.check(lease, inputs)
            self.leases.append(lease)
        indexes = [lease.index for lease in self.leases]
        waiting = [] if self.state.open_tick is None else [self.state.open_tick]
        assert indexes + waiting == self.ticks, "a tick without a lease, or with two"
        msgspec.json.encode(outputs)
        return outputs

    def check(self, lease, inputs):
        assert lease.channels == CHANNELS
        assert all(1100 <= pwm <= 1900 and type(pwm) is int for pwm in lease.pwm_us)
        assert lease.pwm_us[N:] == (1500,) * 4
        assert np.isfinite(lease.f_command_n).all() and lease.valid_for_s == 0.3
        if lease.source == "neutral":
            assert lease.reason and lease.pwm_us == (1500,) * 8
        if len(inputs) == 1 and not self.state.helm.driving:
            assert lease.source == "neutral", "thrust without leave to drive"

    def tick(self):
        self.t_ns += 100 * MS
        self.index += 1
        return self.feed(m.Tick(t_ns=self.t_ns, index=self.index))

    def wait(self, ms):
        self.t_ns += ms * MS

    def deadline(self):
        return self.feed(m.PlanDeadline(t_ns=self.t_ns, index=self.index))

    @property
    def lease(self):
        return self.leases[-1]


def on_the_leg():
    return Shell(*under_way(), index=1000)


def at_the_start():
    return Shell(pilot().initial(0), 0)


# --- any history -----------------------------------------------------------------------------------

numbers = st.one_of(st.floats(-50, 50), st.sampled_from([0.0, NAN, INF, -INF, 1e300]))
rows = st.sampled_from(
    [None, (), ((),), ((NAN,) * N,) * 20, ((0.0, 0.0, INF, 0.0),) * 20, ((1e300,) * N,) * 20, ((5.0,) * (N - 1),) * 20]
)
EVENTS = st.one_of(
    st.just(("tick",)),
    st.tuples(st.just("plan"), st.sampled_from([-1, 0, 0, 0, 1, 500]), st.sampled_from(["ok", "ok", "failed"]), rows),
    st.tuples(st.just("deadline"), st.sampled_from([-1, 0, 0, 1])),
    st.tuples(st.just("heartbeat"), st.booleans(), st.sampled_from([0, 0, 0, 4])),
    st.tuples(st.just("operator"), st.sampled_from(["start", "stop", "hold", "manual"])),
    st.tuples(st.just("battery"), numbers),
    st.tuples(st.just("attitude"), numbers),
    st.tuples(st.just("imu"), numbers),
    st.tuples(st.just("ranges"), numbers),
    st.tuples(st.just("link"), st.sampled_from(["searching", "online", "stale", "lost"])),
    st.tuples(st.just("wait"), st.sampled_from([1, 10, 49, 300, 2000])),
)


def message(shell, event):  # noqa: PLR0911
    t_ns = shell.t_ns
    stamps = {"t_ns": t_ns, "t_rx_ns": t_ns}
    match event:
        case ("plan", ahead, status, f_n):
            return plan(shell.index + ahead, t_ns, status, f_n)
        case ("deadline", ahead):
            return m.PlanDeadline(t_ns=t_ns, index=shell.index + ahead)
        case ("heartbeat", armed, mode):
            return heartbeat(t_ns, armed, mode)
        case ("operator", command):
            return operator(command, t_ns)
        case ("battery", voltage_v):
            return m.Battery(t_ns=t_ns, voltage_v=voltage_v)
        case ("attitude", psi):
            return m.Attitude(**stamps, phi_rad=0.0, theta_rad=0.0, psi_rad=psi, p_rad_s=0.0, q_rad_s=0.0, r_rad_s=psi)
        case ("imu", a):
            return m.ImuSample(**stamps, ax_m_s2=a, ay_m_s2=0.0, az_m_s2=-9.8, p_rad_s=0.0, q_rad_s=0.0, r_rad_s=a,
                               source="RAW_IMU")  # fmt: skip
        case ("ranges", range_m):
            heard = tuple(m.AnchorRange(anchor=a, range_m=range_m) for a in ("1151", "0CA8", "unknown"))
            return m.UwbRanges(**stamps, tag="tag", ranges=heard)
        case ("link", state):
            return m.LinkStatus(t_ns=t_ns, link="uwb", state=state, reason="words")


def live_through(shell, events):
    for event in events:
        if event[0] == "tick":
            shell.tick()
        elif event[0] == "wait":
            shell.wait(event[1])
        else:
            shell.feed(message(shell, event))
    shell.tick()
    shell.tick()
    assert shell.index - 1 in [lease.index for lease in shell.leases]


ANY = settings(max_examples=120, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])


@ANY
@given(st.lists(EVENTS, max_size=40))
def test_every_tick_ends_in_exactly_one_sound_lease_from_the_middle_of_a_leg(events):
    live_through(on_the_leg(), events)


@settings(ANY, max_examples=60)
@given(st.lists(EVENTS, max_size=40))
def test_every_tick_ends_in_exactly_one_sound_lease_from_switch_on(events):
    live_through(at_the_start(), events)


@settings(ANY, max_examples=40)
@given(st.lists(st.tuples(EVENTS, EVENTS, EVENTS), max_size=8))
def test_it_does_not_matter_that_messages_come_in_one_call(groups):
    shell = on_the_leg()
    for group in groups:
        messages = [message(shell, event) for event in group if event[0] not in ("tick", "wait")]
        shell.wait(7)
        apart = shell.state
        for each in messages:
            apart, _ = pilot().step(apart, [each], shell.t_ns)
        shell.feed(*messages)
        assert same(apart, shell.state)


def same(a, b):
    """Equal to the last bit, arrays and all."""
    if isinstance(a, np.ndarray):
        return isinstance(b, np.ndarray) and a.dtype == b.dtype and a.tobytes() == b.tobytes()
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
    if isinstance(a, (tuple, list)):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, float):
        return a == b or (math.isnan(a) and math.isnan(b))
    names = getattr(a, "__struct_fields__", None) or getattr(a, "__dataclass_fields__", ())
    if names:
        return type(a) is type(b) and all(same(getattr(a, k), getattr(b, k)) for k in names)
    return a == b


@settings(ANY, max_examples=30)
@given(st.lists(EVENTS, min_size=1, max_size=10))
def test_a_step_is_pure(events):
    shell = on_the_leg()
    for event in events:
        inputs = [m.Tick(t_ns=shell.t_ns, index=shell.index)] if event[0] in ("tick", "wait") else []
        inputs = inputs or [message(shell, event)]
        shell.wait(13)
        before = pickle.dumps(shell.state)
        one, out_one = pilot().step(shell.state, inputs, shell.t_ns)
        two, out_two = pilot().step(shell.state, inputs, shell.t_ns)
        assert same(one, two)
        assert msgspec.json.encode(out_one) == msgspec.json.encode(out_two)
        assert same(pickle.loads(before), shell.state)
        shell.state = one


# --- plans and the ladder --------------------------------------------------------------------------


def test_a_plan_in_time_is_sent_as_it_is():
    shell = on_the_leg()
    shell.feed(heartbeat(shell.t_ns))
    (request,) = [o for o in shell.tick() if isinstance(o, m.SolveRequest)]
    assert request.index == shell.index and not shell.leases
    shell.wait(10)
    shell.feed(plan(shell.index))
    assert (shell.lease.source, shell.lease.reason, shell.lease.f_command_n) == ("plan", "", (1.0,) * N)
    assert shell.feed(plan(shell.index)) == [], "a duplicate is not sent again"


def test_as_plans_stay_away_the_ladder_goes_down_to_neutral():
    """Heartbeats stop as well: after 3 s the boat is stopped."""
    shell = on_the_leg()
    shell.feed(heartbeat(shell.t_ns))
    shell.tick()
    shell.feed(plan(shell.index))
    sources = []
    for _ in range(40):
        shell.tick()
        if shell.state.open_tick is not None:
            shell.wait(50)
            shell.deadline()
            shell.wait(-50)
        sources.append(shell.lease.source)
    order = [s for i, s in enumerate(sources) if i == 0 or s != sources[i - 1]]
    assert order == ["shifted_plan", "pd", "neutral"]
    assert 8 <= sources.count("shifted_plan") <= 10 and sources.count("pd") >= 15
    assert any(isinstance(o, m.Alert) and o.level == "error" for o in shell.outputs)


def test_a_late_plan_serves_from_its_own_age_on():
    """The plan of a tick that is over was made for that tick's instant, not for the one it arrives in."""
    shell = on_the_leg()
    shell.feed(heartbeat(shell.t_ns))
    shell.tick()
    first = shell.index
    shell.wait(50)
    shell.deadline()
    assert shell.lease.source in ("pd", "shifted_plan")
    shell.wait(-50)
    for _ in range(3):
        shell.tick()
        shell.wait(50)
        shell.deadline()
        shell.wait(-50)
    shell.feed(plan(first))
    shell.tick()
    shell.wait(50)
    shell.deadline()
    assert shell.lease.source == "shifted_plan" and shell.lease.f_command_n == (3.0,) * N, "0.45 s: its third row"


@pytest.mark.parametrize("ahead", [-30, -1, 1, 7])
def test_a_plan_with_a_wrong_index_does_not_close_the_tick(ahead):
    shell = on_the_leg()
    shell.feed(heartbeat(shell.t_ns))
    shell.tick()
    assert shell.feed(plan(shell.index + ahead)) == []
    shell.wait(50)
    shell.deadline()
    assert shell.lease.f_command_n != (1.0,) * N


@pytest.mark.parametrize("ahead", [-1, 1])
def test_a_deadline_of_another_tick_does_not_close_this_one(ahead):
    shell = on_the_leg()
    shell.feed(heartbeat(shell.t_ns))
    shell.tick()
    assert shell.feed(m.PlanDeadline(t_ns=shell.t_ns, index=shell.index + ahead)) == []
    shell.feed(plan(shell.index))
    assert shell.lease.source == "plan"


BAD_ROWS = [
    (),
    ((NAN,) * N,) * 20,
    ((1.0,) * N,) * 19 + ((NAN, 0.0, 0.0, 0.0),),
    ((0.0, 0.0, INF, 0.0),) * 20,
    ((1.0,) * (N - 1),) * 20,
]


@pytest.mark.parametrize("f_n", BAD_ROWS, ids=["empty", "nan", "nan late", "inf", "short"])
def test_an_unsound_plan_leaves_the_lease_to_the_one_before(f_n):
    shell = on_the_leg()
    shell.feed(heartbeat(shell.t_ns))
    shell.tick()
    shell.feed(plan(shell.index))
    shell.tick()
    shell.wait(10)
    shell.feed(plan(shell.index, f_n=f_n))
    assert shell.lease.source == "shifted_plan" and "not sound" in shell.lease.reason
    assert shell.lease.f_command_n == (1.0,) * N


def test_a_failed_plan_leaves_the_lease_to_the_one_before():
    shell = on_the_leg()
    shell.feed(heartbeat(shell.t_ns))
    shell.tick()
    shell.feed(plan(shell.index))
    shell.tick()
    shell.feed(plan(shell.index, status="failed", f_n=()))
    assert shell.lease.source == "shifted_plan" and "because" in shell.lease.reason


def test_a_plan_beyond_the_limits_is_clipped():
    shell = on_the_leg()
    shell.feed(heartbeat(shell.t_ns))
    shell.tick()
    shell.feed(plan(shell.index, f_n=((1e6, -1e6, 0.0, 0.0),) * 20))
    assert shell.lease.f_command_n == (38.0, -30.0, 0.0, 0.0)


# --- when not to drive -----------------------------------------------------------------------------


def going(shell):
    shell.feed(heartbeat(shell.t_ns))
    shell.tick()
    shell.feed(plan(shell.index))
    assert shell.lease.source == "plan"


@pytest.mark.parametrize(
    "end", [{"armed": False}, {"mode": 4}, {"mode": 15}, "stop"], ids=["disarmed", "hold", "guided", "operator"]
)
def test_taken_away_means_neutral_until_the_operator_starts(end):
    shell = on_the_leg()
    going(shell)
    shell.tick()
    shell.wait(5)
    shell.feed(operator("stop") if end == "stop" else heartbeat(shell.t_ns, **end))
    shell.wait(5)
    shell.feed(plan(shell.index))
    assert shell.lease.source == "neutral", "not even the plan that was under way is sent"
    for _ in range(30):
        shell.feed(heartbeat(shell.t_ns))
        shell.tick()
        assert shell.lease.source == "neutral" and shell.lease.index == shell.index
    assert not [o for o in shell.outputs if isinstance(o, m.VehicleRequest)], "nothing is asked of the autopilot"
    shell.feed(operator("start"))
    shell.tick()
    shell.feed(plan(shell.index))
    assert shell.lease.source == "plan"


def test_hold_keeps_station_where_the_boat_is():
    shell = on_the_leg()
    going(shell)
    shell.feed(operator("hold"))
    (reference,) = [o for o in shell.tick() if isinstance(o, m.GuidanceReference)]
    estimate = shell.state.estimate
    away = math.hypot(reference.north_ref_m - estimate.north_m, reference.east_ref_m - estimate.east_m)
    assert reference.phase == "station" and away < 0.8


def test_without_an_estimate_nothing_is_asked_for():
    shell = at_the_start()
    shell.feed(operator("start"), heartbeat(0, armed=False))
    for _ in range(20):
        shell.feed(heartbeat(shell.t_ns))
        outputs = shell.tick()
        assert not [o for o in outputs if isinstance(o, (m.VehicleRequest, m.SolveRequest))]
        assert "initialising" in shell.lease.reason


# --- battery, links --------------------------------------------------------------------------------


@pytest.mark.parametrize("voltage_v", [0.0, -1.0, 1.5, 7.4, 22.6, 65.535, NAN, INF])
def test_a_voltage_that_no_pack_has_changes_nothing(voltage_v):
    shell = on_the_leg()
    before = shell.state.monitor(BatteryState).voltage_v
    for _ in range(50):
        shell.feed(m.Battery(t_ns=shell.t_ns, voltage_v=voltage_v))
    assert shell.state.monitor(BatteryState).voltage_v == before


def test_a_sagging_pack_is_followed_and_gets_longer_pulses():
    shell, low = on_the_leg(), on_the_leg()
    for _ in range(50):
        low.feed(m.Battery(t_ns=low.t_ns, voltage_v=13.0))
    assert low.state.monitor(BatteryState).voltage_v == pytest.approx(13.0, abs=0.01)
    for each in (shell, low):
        going(each)
    assert low.lease.pwm_us[0] > shell.lease.pwm_us[0]


@pytest.mark.parametrize(
    ("state", "level"), [("searching", "info"), ("online", "info"), ("stale", "warning"), ("lost", "warning")]
)
def test_links_are_told_as_they_deserve(state, level):
    shell = on_the_leg()
    (alert,) = shell.feed(m.LinkStatus(t_ns=0, link="uwb", state=state, reason="words"))
    assert (alert.level, alert.text) == (level, f"uwb: {state}: words")
