"""The estimator under values that are not finite, and messages that are not for it."""

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.core.estimation.estimator import Estimator
from companion.core.estimation.filter_state import SPEED
from companion.core.messages import AnchorRange, Attitude, Battery, ImuSample, UwbPosition, UwbRanges
from tests.companion.core.estimation.changed_runs import S, between, changed
from tests.companion.core.estimation.estimator_world import basin, estimate, step_all
from tests.support.vessel_fixtures import boat


def test_numbers_that_are_not_finite_start_the_filter_afresh(run, estimator) -> None:
    """No input is known to bring this about, so the fault is put into the remembered belief."""
    state = estimator.initial()
    for m in run.messages[:800]:
        state, _ = estimator.step(state, m)
    entry = state.history[-1]
    poison = msgspec.structs.replace(entry.belief, x=entry.belief.x * math.nan)
    state = msgspec.structs.replace(state, history=(*state.history[:-1], entry._replace(belief=poison)))
    later = next(m for m in run.messages[800:] if isinstance(m, ImuSample) and m.t_ns > entry.t_ns)
    state, _ = estimator.step(state, later)
    assert state.restarts == 1
    e = estimator.estimate(state, later.t_ns)
    assert e.health == "initialising"
    assert "no longer finite" in e.reason


def test_a_prediction_that_is_no_number_is_lost(running, estimator) -> None:
    """A finite state may overflow on the way to the tick."""
    entry = running.history[-1]
    wild = msgspec.structs.replace(entry.belief, x=np.where(np.arange(len(entry.belief.x)) == 3, 1e80, entry.belief.x))
    state = msgspec.structs.replace(running, history=(*running.history[:-1], entry._replace(belief=wild)))
    e = estimator.estimate(state, entry.t_ns + S // 10)
    assert e.health == "lost" and "not finite" in e.reason


def test_a_heading_that_is_left_out_starts_nothing(run, estimator) -> None:
    """It waits for the next one, and does not begin without one time and again."""
    state, cut = estimator.initial(), 800
    for m in run.messages[:cut]:
        state, _ = estimator.step(state, msgspec.structs.replace(m, psi_rad=math.nan) if isinstance(m, Attitude) else m)
    e = estimator.estimate(state, run.messages[cut].t_ns)
    assert e.health == "initialising" and e.reason == "no heading from the autopilot" and state.restarts == 0
    for m in run.messages[cut : 2 * cut]:
        state, _ = estimator.step(state, m)
    assert estimator.estimate(state, m.t_ns).health != "initialising" and state.restarts == 0


@pytest.mark.long
@pytest.mark.parametrize("change_rad_s", [1.0, 60.0, 1e4, math.nan])
def test_one_wrong_rate_of_roll_or_pitch_does_not_become_speed(run, estimator, change_rad_s) -> None:
    """A wrong tilt takes gravity for an acceleration, and its own variance is small."""
    wrong = next(m for m in run.messages if isinstance(m, Attitude) and between(m, 20, 99))

    def glitch(m):
        if m is not wrong:
            return m
        return msgspec.structs.replace(m, p_rad_s=m.p_rad_s + change_rad_s, q_rad_s=m.q_rad_s - change_rad_s)

    for e in estimate(changed(run, glitch), estimator).estimates:
        if e.t_ns > 20 * S:
            off = np.subtract((e.u_m_s, e.v_m_s), run.truth(e.t_ns / S)[SPEED])
            assert e.health == "healthy" and np.hypot(*off) < 0.2


def test_one_range_before_the_start_does_not_keep_positions_out(run, estimator) -> None:
    """Of a tag that sends now these and now those."""
    state, sent = estimator.initial(), 0
    for m in run.messages:
        if isinstance(m, UwbRanges) and not sent:
            state, _ = estimator.step(state, msgspec.structs.replace(m, ranges=m.ranges[:1]))
            sent = m.t_rx_ns
        elif isinstance(m, UwbRanges):
            x = run.truth(m.t_rx_ns / S - 0.08)
            position = UwbPosition(t_ns=m.t_ns, t_rx_ns=m.t_rx_ns, tag="t", x_m=x[1], y_m=x[0], z_m=0.4)
            state, _ = estimator.step(state, position)
        else:
            state, _ = estimator.step(state, m)
        if m.t_rx_ns > sent + 8 * S > 8 * S:
            break
    assert estimator.estimate(state, m.t_rx_ns).health != "initialising"


def test_ranges_that_come_late_start_on_the_heading_of_now(run) -> None:
    vessel = boat("aritra")
    uwb = msgspec.structs.replace(vessel.sensors.uwb, latency_s=0.7)
    late = Estimator(msgspec.structs.replace(vessel, sensors=msgspec.structs.replace(vessel.sensors, uwb=uwb)), basin())
    state = step_all(run, late, 8.0, lambda state, m: late.step(state, m)[0])
    assert late.estimate(state, 8 * S).health != "initialising"


def test_an_old_heading_starts_nothing(run, estimator) -> None:
    first = next(m for m in run.messages if isinstance(m, Attitude))
    state, _ = estimator.step(estimator.initial(), first)
    for m in run.messages:
        if isinstance(m, UwbRanges) and between(m, 10, 15):
            state, _ = estimator.step(state, m)
    e = estimator.estimate(state, 15 * S)
    assert e.health == "initialising" and e.reason == "no heading from the autopilot"


def test_duplicates_and_the_very_late_are_counted_and_change_nothing(run, estimator) -> None:
    state = estimator.initial()
    for m in run.messages[:1200]:
        state, _ = estimator.step(state, m)
    again, _ = estimator.step(state, run.messages[1199])
    assert again.refused == {"duplicate": 1}
    assert again.history == state.history
    again, _ = estimator.step(again, run.messages[300])
    assert again.refused == {"duplicate": 1, "too late": 1}
    assert again.history == state.history


def test_other_messages_pass_by(estimator) -> None:
    state = estimator.initial()
    assert estimator.step(state, Battery(t_ns=0, voltage_v=15.0)) == (state, ())


wild = st.one_of(st.floats(), st.sampled_from([0.0, 1.0, -9.81, 3.1, math.nan, math.inf, 1e308]))
stamp = st.integers(-2 * S, 60 * S)
names = st.sampled_from(["1151", "0CA8", "111C", "1150", "stranger"])
ranges = st.lists(st.builds(AnchorRange, anchor=names, range_m=wild), max_size=6).map(tuple)
both = {"t_ns": stamp, "t_rx_ns": stamp}
rates = {"p_rad_s": wild, "q_rad_s": wild, "r_rad_s": wild}
accels = {"ax_m_s2": wild, "ay_m_s2": wild, "az_m_s2": wild}
angles = {"phi_rad": wild, "theta_rad": wild, "psi_rad": wild}
messages = st.one_of(
    st.builds(ImuSample, source=st.sampled_from("ab"), **both, **rates, **accels),
    st.builds(Attitude, **both, **rates, **angles),
    st.builds(UwbPosition, tag=st.just("t"), x_m=wild, y_m=wild, z_m=wild, **both),
    st.builds(UwbRanges, tag=st.just("t"), ranges=ranges, **both),
)


@settings(max_examples=60, deadline=None)
@given(st.lists(messages, max_size=25), st.integers(0, 60 * S))
def test_nonsense_never_raises_and_never_yields_nan(running, estimator, nonsense, t_ns: int) -> None:
    """Nonsense before the start, and in the midst of a healthy run."""
    for begin in (estimator.initial(), running):
        state = begin
        for m in nonsense:
            state, innovations = estimator.step(state, m)
            assert all(math.isfinite(v) for i in innovations for v in (*i.innovation, *i.S, i.d2))
        e = estimator.estimate(state, t_ns)
        numbers = [e.north_m, e.east_m, e.psi_rad, e.u_m_s, e.v_m_s, e.r_rad_s, *e.covariance]
        numbers += [*e.accel_bias_m_s2, e.gyro_bias_rad_s, *e.anchor_bias_m.values(), *e.disturbance_n]
        assert all(map(math.isfinite, numbers))


def test_a_command_that_is_not_finite_is_refused(estimator) -> None:
    state = estimator.command(estimator.initial(), 0, (math.nan, 0.0, 0.0, 0.0))
    assert state.refused == {"command: not finite": 1}
    assert len(state.commands) == 1


def test_commands_before_the_start_do_not_pile_up(estimator) -> None:
    state = estimator.initial()
    for k in range(100):
        state = estimator.command(state, k * S // 10, (1.0, 0.0, 0.0, float(k)))
    assert len(state.commands) <= 3
