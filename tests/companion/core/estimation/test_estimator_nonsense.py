"""The estimator under values that are not finite, and messages that are not for it."""

import math

import msgspec
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.core.messages import AnchorRange, Attitude, Battery, ImuSample, UwbPosition, UwbRanges
from tests.companion.core.estimation.changed_runs import S


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
