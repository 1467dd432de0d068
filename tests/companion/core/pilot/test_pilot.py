"""The pilot under any history of messages: one sound lease a tick, pure steps. Seeds by hypothesis."""

from __future__ import annotations

import math
import pickle

import msgspec
import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from companion.core import messages as m
from tests.companion.core.pilot.pilot_shell import (
    INF,
    NAN,
    N,
    at_the_start,
    heartbeat,
    on_the_leg,
    operator,
    plan,
)
from tests.support.drive_fixture import pilot

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
