"""The estimator as a whole: lateness, spikes, outages, nonsense, starts. World: estimator_world."""

import math
from dataclasses import replace as data_replace

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.core.estimation.estimator import Estimator, EstimatorState
from companion.core.estimation.filter_state import B_RANGE
from companion.core.estimation.kalman import Algebra
from companion.core.estimation.ranging.uwb_fusion import UwbFusion
from companion.core.estimation.tuning import EstimatorTuning
from companion.core.geometry.frames import rotate
from companion.core.messages import (
    AnchorRange,
    Attitude,
    Battery,
    ImuSample,
    StateEstimate,
    UwbPosition,
    UwbRanges,
)
from tests.companion.core.estimation.estimator_world import Run, Score, basin, estimate, simulate, without
from tests.support.vessel_fixtures import boat

S = 1_000_000_000


@pytest.fixture(scope="module")
def estimator() -> Estimator:
    return Estimator(boat("aritra"), basin())


@pytest.fixture(scope="module")
def run() -> Run:
    return simulate(4, disturbed=True, seconds=40.0)


@pytest.fixture(scope="module")
def plain(run: Run, estimator: Estimator) -> Score:
    return estimate(run, estimator, settle_s=15.0)


@pytest.fixture(scope="module")
def running(run: Run, estimator: Estimator) -> EstimatorState:
    """The state 3.3 s into the run."""
    state = estimator.initial()
    for m in run.messages[:330]:
        state, _ = estimator.step(state, m)
    return state


def between(m, start_s: float, end_s: float) -> bool:
    return start_s * S <= m.t_rx_ns < end_s * S


def changed(run: Run, change) -> Run:
    return data_replace(run, messages=[change(m) for m in run.messages])


def with_range(m: UwbRanges, number: int, extra_m: float) -> UwbRanges:
    ranges = [
        msgspec.structs.replace(r, range_m=r.range_m + extra_m) if i == number else r for i, r in enumerate(m.ranges)
    ]
    return msgspec.structs.replace(m, ranges=tuple(ranges))


def away(a: StateEstimate, b: StateEstimate) -> float:
    return math.hypot(a.north_m - b.north_m, a.east_m - b.east_m)


def test_it_starts_by_itself_and_is_healthy_and_near_the_truth(run: Run, plain: Score) -> None:
    health = [e.health for e in plain.estimates]
    assert health[0] == "initialising"
    assert health[20:] == ["healthy"] * len(health[20:])
    rms = plain.rms()
    assert rms["position_m"] < 0.15
    assert max(rms["u_m_s"], rms["v_m_s"]) < 0.05
    assert rms["heading_deg"] < 2.0
    assert plain.state.refused == {}


def test_a_late_message_counts_as_if_it_had_come_in_time(run: Run, estimator: Estimator) -> None:
    """Oracle: the same messages sorted by the instant they speak of give the same numbers."""
    state = estimator.initial()
    for t_ns, f in run.commands:
        state = estimator.command(state, t_ns, f)
    for m in (m for m in run.messages if between(m, 0, 5)):
        state, _ = estimator.step(state, m)
    rest = [m for m in run.messages if between(m, 5, 12)]
    ends = []
    late_ns = np.random.default_rng(6).integers(0, 400_000_000, 1000)  # the same for one instant's messages
    jittered = sorted(rest, key=lambda m: m.t_rx_ns + late_ns[m.t_rx_ns // 5_000_000 % 1000])
    for order in (sorted(rest, key=estimator.instant_ns), rest, jittered):
        end = state
        for m in order:
            end, _ = estimator.step(end, m)
        assert end.refused == {}
        ends.append(end.history[-1].belief)
    for late in ends[1:]:
        np.testing.assert_allclose(late.x, ends[0].x, atol=1e-9)
        np.testing.assert_allclose(late.P, ends[0].P, atol=1e-9)


def test_steps_do_not_change_the_state_they_were_given(run: Run, estimator: Estimator) -> None:
    state = estimator.initial()
    for m in run.messages[:600]:
        state, _ = estimator.step(state, m)
    before = estimator.estimate(state, 8 * S)
    other = state
    for m in run.messages[600:900]:
        other, _ = estimator.step(other, m)
    assert estimator.estimate(state, 8 * S) == before
    assert other is not state


def test_spikes_of_one_range_do_not_move_the_estimate(run, estimator, plain) -> None:
    spikes = {22: (1, 15.0), 26: (3, -8.0), 30: (0, 1.0), 34: (2, 46.0)}

    def spike(m):
        at = m.t_rx_ns // S
        return with_range(m, *spikes[at]) if isinstance(m, UwbRanges) and at in spikes else m

    hit = estimate(changed(run, spike), estimator)
    assert max(away(a, b) for a, b in zip(hit.estimates, plain.estimates, strict=True)) < 0.1


def test_rejected_measurements_are_reported_too(run: Run, estimator: Estimator) -> None:
    state, seen = estimator.initial(), []
    for m in run.messages[:2000]:
        hit = with_range(m, 2, 15.0) if isinstance(m, UwbRanges) and between(m, 12, 13) else m
        state, innovations = estimator.step(state, hit)
        seen += [i for i in innovations if i.sensor == "range 111C" and between(hit, 12, 13)]
    assert [i.accepted for i in seen] == [False]
    assert seen[0].innovation[0] == pytest.approx(15.0, abs=0.5)
    assert seen[0].d2 == pytest.approx(seen[0].innovation[0] ** 2 / seen[0].S[0])


def test_a_lasting_offset_of_one_anchor_becomes_its_bias(run, estimator, plain) -> None:
    def offset(m):
        return with_range(m, 0, 3.0) if isinstance(m, UwbRanges) and between(m, 20, 99) else m

    hit = estimate(changed(run, offset), estimator)
    assert hit.estimates[-1].anchor_bias_m["1151"] == pytest.approx(3.0, abs=0.3)
    assert max(away(a, b) for a, b in zip(hit.estimates, plain.estimates, strict=True)) < 0.3


def test_outage_degrades_then_is_lost_then_recovers(run, estimator) -> None:
    tuning = msgspec.structs.replace(estimator.tuning, lost_position_sigma_m=0.5)
    strict = Estimator(boat("aritra"), basin(), tuning)
    gap = without(run, lambda m: isinstance(m, UwbRanges) and between(m, 12, 32))
    score = estimate(gap, strict, settle_s=38.0)
    health = {round(e.t_ns / S, 1): e for e in score.estimates}
    assert health[11.0].health == "healthy"
    assert health[15.5].health == "degraded"
    assert "no UWB accepted" in health[15.5].reason
    assert health[32.0].health == "lost"
    assert score.estimates[-1].health == "healthy"
    assert score.rms()["position_m"] < 0.3


def test_a_boat_put_down_elsewhere_is_found_again(run, estimator) -> None:
    """All ranges jump to those of a place 8 m away: the gate re-opens on their agreement, within 5 s."""
    anchors = np.array([(a.north_m, a.east_m, a.down_m) for a in basin().anchors])

    def moved(m):
        if not (isinstance(m, UwbRanges) and between(m, 20, 99)):
            return m
        eta = run.truth((m.t_rx_ns / S) - 0.08)
        tag = np.array([eta[0] - 0.2 * math.cos(eta[2]) - 8.0, eta[1] - 0.2 * math.sin(eta[2]), -0.4])
        d = np.sqrt(((tag - anchors) ** 2).sum(axis=1))
        spiky = [float(z) + (20.0 if i == 3 and between(m, 22, 23) else 0.0) for i, z in enumerate(d)]
        return msgspec.structs.replace(
            m,
            ranges=tuple(AnchorRange(anchor=r.anchor, range_m=z) for r, z in zip(m.ranges, spiky, strict=True)),
        )

    score = estimate(changed(run, moved), estimator)
    for e in score.estimates:
        if e.t_ns > 26 * S:
            truth = run.truth(e.t_ns / S)
            assert math.hypot(e.north_m - (truth[0] - 8.0), e.east_m - truth[1]) < 0.4
    assert score.estimates[-1].health == "healthy"


@pytest.mark.parametrize("arm_m", [(-1.5, 0.7), (1.0, -1.2)])
def test_a_place_found_anew_is_the_body_s_and_not_the_tag_s(running, estimator, arm_m) -> None:
    """The tag sits far out: exact ranges of a place 8 m away, until the filter goes there."""
    uwb = msgspec.structs.replace(boat("aritra").sensors.uwb, x_m=arm_m[0], y_m=arm_m[1])
    fusion = UwbFusion(basin(), uwb, EstimatorTuning(), Algebra(B_RANGE + len(basin().anchors)))
    before = belief = estimator.belief(running, 3_300_000_000)
    place = belief.x[:2] - [8.0, 0.0]
    tag = (*(place + rotate(belief.x[2], *arm_m)), fusion.arm(belief)[2])
    z = np.linalg.norm(tag - fusion.anchors_m, axis=1) + belief.x[B_RANGE:]
    ranges = tuple(AnchorRange(anchor=a.id, range_m=float(d)) for a, d in zip(basin().anchors, z, strict=True))
    for _ in range(60):
        belief = msgspec.structs.replace(belief, t_ns=belief.t_ns + S // 10)
        belief, seen = fusion.fuse_ranges(belief, UwbRanges(t_ns=0, t_rx_ns=0, tag="test", ranges=ranges))
        if any(one.accepted for one in seen):
            break
    assert math.dist(belief.x[:2], place) < 0.05 < math.dist(before.x[:2], place)


def test_positions_serve_where_no_ranges_exist(run, estimator) -> None:
    rng = np.random.default_rng(5)

    def as_position(m):
        if not isinstance(m, UwbRanges):
            return m
        x = run.truth(m.t_rx_ns / S - 0.08)
        north = x[0] - 0.2 * math.cos(x[2]) + rng.normal(0, 0.1)
        east = x[1] - 0.2 * math.sin(x[2]) + rng.normal(0, 0.1)
        east += 15.0 if between(m, 25, 26) else 0.0
        return UwbPosition(t_ns=m.t_ns, t_rx_ns=m.t_rx_ns, tag="t", x_m=east, y_m=north, z_m=0.4)

    score = estimate(changed(run, as_position), estimator)
    assert score.rms()["position_m"] < 0.15
    assert score.estimates[-1].health == "healthy"


def test_positions_are_left_out_while_ranges_come(run, estimator) -> None:
    state = estimator.initial()
    for m in run.messages[:1500]:
        state, _ = estimator.step(state, m)
        if isinstance(m, UwbRanges):
            wrong = UwbPosition(t_ns=m.t_ns, t_rx_ns=m.t_rx_ns, tag="t", x_m=0.0, y_m=0.0, z_m=0.0)
            state, innovations = estimator.step(state, wrong)
            assert innovations == ()
    assert estimator.estimate(state, state.history[-1].t_ns).health == "healthy"


def test_a_heading_glitch_is_rejected_and_a_heading_reset_is_followed(run, estimator) -> None:
    def turned(m):
        glitch = isinstance(m, Attitude) and (between(m, 20, 20.3) or between(m, 30, 99))
        return msgspec.structs.replace(m, psi_rad=m.psi_rad + 0.3) if glitch else m

    score = estimate(changed(run, turned), estimator)
    for e in score.estimates:
        error = (e.psi_rad - run.truth(e.t_ns / S)[2] + math.pi) % math.tau - math.pi
        if 15 * S < e.t_ns < 30 * S:
            assert abs(error) < 0.05
        if e.t_ns > 32 * S:
            assert abs(error - 0.3) < 0.1


def test_without_imu_it_says_so_and_goes_on(run, estimator) -> None:
    score = estimate(without(run, lambda m: isinstance(m, ImuSample)), estimator)
    assert score.estimates[-1].health == "degraded"
    assert "no IMU" in score.estimates[-1].reason
    assert score.rms()["position_m"] < 0.3


def test_silence_of_everything_is_lost_and_then_a_fresh_start(run, estimator) -> None:
    state = estimator.initial()
    for m in (m for m in run.messages if between(m, 0, 10)):
        state, _ = estimator.step(state, m)
    late = estimator.estimate(state, 60 * S)
    assert late.health == "lost"
    assert all(map(math.isfinite, late.covariance))
    shift = [
        msgspec.structs.replace(m, t_ns=m.t_ns + 60 * S, t_rx_ns=m.t_rx_ns + 60 * S)
        for m in run.messages
        if between(m, 10, 20)
    ]
    state, _ = estimator.step(state, shift[0])
    again = estimator.estimate(state, shift[0].t_ns)
    assert again.health == "initialising"
    assert "no sensor message for 60 s" in again.reason
    for m in shift:
        state, _ = estimator.step(state, m)
    assert state.restarts == 1
    assert estimator.estimate(state, 80 * S).health == "healthy"


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
