"""The estimator through outages, jumps, silence and messages out of order. World: estimator_world."""

import math

import msgspec
import numpy as np
import pytest

from companion.core.estimation.estimator import Estimator
from companion.core.estimation.filter_state import B_ACCEL, B_GYRO, B_PSI, B_RANGE, DYNAMIC, LATENT, LAYOUT, SPEED, TILT
from companion.core.estimation.health import is_settled
from companion.core.estimation.inertial import Inertial
from companion.core.estimation.kalman import KalmanEquations
from companion.core.estimation.latent_activity import MOST
from companion.core.estimation.process import Process
from companion.core.estimation.ranging.uwb_fusion import UwbFusion
from companion.core.estimation.start import after_gap
from companion.core.estimation.tuning import EstimatorTuning
from companion.core.geometry.frames import rotate, ssa
from companion.core.messages import AnchorRange, Attitude, ImuSample, UwbPosition, UwbRanges
from companion.core.model.manoeuvring import StructuredModel
from companion.core.sensors.uwb import HEALTH
from tests.companion.core.estimation.changed_runs import S, between, changed
from tests.companion.core.estimation.estimator_world import LATE_S, basin, estimate, step_all, without
from tests.support.vessel_fixtures import boat


def test_outage_degrades_then_is_lost_then_recovers(run, estimator) -> None:
    strict = Estimator(boat("aritra"), basin(), limits=HEALTH._replace(lost_sigma_m=0.5))
    gap = without(run, lambda m: isinstance(m, UwbRanges) and between(m, 12, 32))
    score = estimate(gap, strict, settle_s=38.0)
    health = {round(e.t_ns / S, 1): e for e in score.estimates}
    assert health[11.0].health == "healthy"
    assert health[15.1].health == "degraded"
    assert "no UWB accepted" in health[15.1].reason
    assert health[32.0].health == "lost"
    assert score.estimates[-1].health == "healthy"
    assert score.rms()["position_m"] < 0.3


def test_a_boat_put_down_elsewhere_is_found_again(run, estimator) -> None:
    """All ranges jump to those of a place 8 m away: the gate re-opens on their agreement, within 5 s, and says so."""
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
        if 26 * S < e.t_ns < 31 * S:
            assert e.health == "degraded" and "taken anew" in e.reason
    assert score.estimates[-1].health == "healthy"


@pytest.mark.parametrize("arm_m", [(-1.5, 0.7), (1.0, -1.2)])
def test_a_place_found_anew_is_the_body_s_and_not_the_tag_s(running, estimator, arm_m) -> None:
    """The tag sits far out: exact ranges of a place 8 m away, until the filter goes there."""
    uwb = msgspec.structs.replace(boat("aritra").sensors.uwb, x_m=arm_m[0], y_m=arm_m[1])
    fusion = UwbFusion(basin(), uwb, EstimatorTuning(), KalmanEquations(B_RANGE + len(basin().anchors)))
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


def test_a_position_of_which_one_axis_alone_is_good_is_none(running, estimator) -> None:
    fusion = UwbFusion(basin(), boat("aritra").sensors.uwb, EstimatorTuning(), KalmanEquations(B_RANGE + 4))
    before = msgspec.structs.replace(estimator.belief(running, 3_300_000_000), ranges_ns=None)
    dx, dy = rotate(before.x[2], *fusion.arm(before)[:2])
    good = UwbPosition(t_ns=0, t_rx_ns=0, tag="test", x_m=before.x[1] + dy, y_m=before.x[0] + dx, z_m=0.0)
    assert fusion.fuse_position(before, good)[0].position_ns == before.t_ns
    halved, seen = fusion.fuse_position(before, msgspec.structs.replace(good, y_m=good.y_m + 9.0))
    assert [one.accepted for one in seen] == [False, True] and halved.position_ns == before.position_ns < before.t_ns


@pytest.mark.long
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
    assert score.rms()["position_m"] < 0.18
    assert score.estimates[-1].health == "healthy"


def test_positions_are_left_out_while_ranges_come(run, estimator) -> None:
    def hear(state, m):
        state, _ = estimator.step(state, m)
        if isinstance(m, UwbRanges):
            wrong = UwbPosition(t_ns=m.t_ns, t_rx_ns=m.t_rx_ns, tag="t", x_m=0.0, y_m=0.0, z_m=0.0)
            state, innovations = estimator.step(state, wrong)
            assert innovations == ()
        return state

    state = step_all(run, estimator, 20.0, hear)
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


def test_after_a_silence_in_which_heading_was_lost_the_next_one_is_believed(run, estimator) -> None:
    """Six seconds in which somebody turned the boat by half a radian: more than the gate would let pass."""
    turned_rad = 0.5
    assert turned_rad > 3.29 * EstimatorTuning().heading_gate.ceiling

    def turned(m):
        hit = isinstance(m, Attitude) and between(m, 26, 99)
        return msgspec.structs.replace(m, psi_rad=ssa(m.psi_rad + turned_rad)) if hit else m

    silent = changed(without(run, lambda m: between(m, 20, 26)), turned)
    state = step_all(silent, estimator, 26.1, lambda state, m: estimator.step(state, m)[0])
    now = estimator.estimate(state, round(26.1 * S))
    assert abs(ssa(now.psi_rad - turned_rad - run.truth(26.1)[2])) < 0.1


def test_a_latent_force_is_as_lively_after_a_gap_whether_the_filter_started_afresh_or_not(run, estimator) -> None:
    def liveliest(state):
        return max(axis.log_variance for axis in state.history[-1].belief.activity)

    def hear(state, m):
        state, _ = estimator.step(state, m)
        if isinstance(m, ImuSample) and state.history and estimator.instant_ns(m) == state.history[-1].t_ns:
            after.append((m.t_rx_ns, liveliest(state)))
        return state

    for silence_s, restarts in ((6.0, 0), (11.0, 1)):
        after: list[tuple[int, float]] = []
        state = step_all(without(run, lambda m, s=silence_s: between(m, 15, 15 + s)), estimator, 32.0, hear)
        assert state.restarts == restarts
        began = after[0][1]
        again = next(a for t_ns, a in after if t_ns > (15 + silence_s) * S)
        assert again == pytest.approx(MOST, abs=0.1) and began == pytest.approx(math.log(300.0), abs=0.1)


def test_rates_count_when_the_filters_saw_them_and_heading_at_its_stamp(running, estimator) -> None:
    late_ns = round(LATE_S * 1e9)
    t_ns = running.history[-1].t_ns + S // 50
    x = estimator.belief(running, t_ns).x
    m = Attitude(
        t_ns=t_ns + late_ns, t_rx_ns=t_ns + late_ns, phi_rad=0.0, theta_rad=0.0,
        psi_rad=ssa(x[2] + x[5] * late_ns * 1e-9 + x[B_PSI]), p_rad_s=0.0, q_rad_s=0.0, r_rad_s=x[5] + x[B_GYRO],
    )  # fmt: skip
    assert estimator.instant_ns(m) == t_ns
    _, (heading, rate) = estimator.step(running, m)
    assert abs(x[5]) * late_ns * 1e-9 > 5e-4
    assert heading.innovation[0] == pytest.approx(0.0, abs=1e-9)
    assert rate.innovation[0] == pytest.approx(0.0, abs=1e-3)  # level axes: roll and pitch are small here


@pytest.mark.parametrize("waves_n", [3.0, 90.0])
def test_after_a_gap_speed_is_as_unknown_as_at_a_start_and_no_more(running, estimator, waves_n) -> None:
    """However long a force of any size may have pushed the boat meanwhile."""
    now, tuning = estimator.belief(running, 3_300_000_000), estimator.tuning
    P = now.P.copy()
    P[SPEED, SPEED] += np.eye(2) * (waves_n / 30.0) ** 2
    after = after_gap(msgspec.structs.replace(now, P=P), tuning)
    assert [math.sqrt(after.P[i, i]) for i in LAYOUT.velocity] == pytest.approx([tuning.start_velocity_sigma_m_s] * 2)
    assert not after.settled and np.linalg.eigvalsh(after.P).min() > 0.0


def test_one_acceleration_seen_at_two_estimates_of_speed_does_not_tell_speed(running, estimator) -> None:
    """Two readings as expected, the estimate moved in between; the latent force may be any, as after a gap."""
    vessel, tuning = boat("aritra"), EstimatorTuning()
    process = Process(StructuredModel.of(vessel), (vessel.sensors.imu.x_m, vessel.sensors.imu.y_m))
    inertial = Inertial(process, vessel.sensors.imu, tuning, KalmanEquations(B_RANGE + 4))
    now = estimator.belief(running, 3_300_000_000)

    def sigma_m_s(since_s: float, settled: bool = False) -> float:
        P = np.diag(np.diag(now.P))
        P[SPEED, SPEED], P[LATENT, LATENT] = np.eye(2) * 0.5**2, np.eye(3) * 90.0**2
        belief = msgspec.structs.replace(
            now, P=P, settled=settled, since_ns=now.t_ns - round(since_s * S), slopes_rad_s2=(0.0, 0.0, 0.0)
        )
        for speed_m_s in ((0.0, 0.0), (0.9, 0.3), (1.5, -0.4)):
            x = belief.x.copy()
            x[SPEED], x[TILT] = speed_m_s, 0.0
            ax, ay = process.acceleration(x[DYNAMIC], process.drive(belief.f_n))[0] + x[B_ACCEL]
            m = ImuSample(
                t_ns=0, t_rx_ns=0, source="test", ax_m_s2=ax, ay_m_s2=ay, az_m_s2=-9.81, p_rad_s=0.0, q_rad_s=0.0,
                r_rad_s=0.0,
            )  # fmt: skip
            belief, _ = inertial.fuse_imu(msgspec.structs.replace(belief, x=x), m)
        return math.sqrt(max(belief.P[i, i] for i in LAYOUT.velocity))

    assert sigma_m_s(since_s=3.0) > 0.48
    assert sigma_m_s(since_s=21.0) < 0.2, "it is taken for known then"
    assert sigma_m_s(since_s=3.0, settled=True) < 0.2


@pytest.mark.parametrize(("before_m_s", "settled"), [(0.06, True), (0.07, False)])
def test_speed_is_known_when_it_was_right_before_a_position_too(running, estimator, before_m_s, settled) -> None:
    def of_speed(belief, sigma_m_s):
        P = belief.P.copy()
        P[3, 3] = P[4, 4] = sigma_m_s**2
        return msgspec.structs.replace(belief, P=P, settled=False, fixes=9, since_ns=belief.t_ns - 9 * S)

    now = estimator.belief(running, 3_300_000_000)
    before, after = of_speed(now, before_m_s), of_speed(now, 0.04)
    fixed = msgspec.structs.replace(after, position_ns=after.t_ns)
    assert before.position_ns < after.t_ns
    assert is_settled(before, fixed, estimator.tuning) is settled
    assert not is_settled(before, after, estimator.tuning), "no position came"


def test_positions_that_come_back_before_speed_was_known_do_not_make_it_known(run, estimator) -> None:
    """The time that it may take to settle runs out while there are none."""
    away = without(run, lambda m: isinstance(m, UwbRanges) and between(m, 2.5, 24))
    healthy = [e for e in estimate(away, estimator).estimates if e.t_ns > 24 * S and e.health == "healthy"]
    errors = [np.subtract((e.u_m_s, e.v_m_s), run.truth(e.t_ns / S)[SPEED]) for e in healthy]
    assert len(healthy) > 50 and np.hypot(*np.transpose(errors)).max() < 0.2


def test_a_tag_that_gets_through_every_four_seconds_is_enough(run, estimator) -> None:
    seldom = without(run, lambda m: isinstance(m, UwbRanges) and m.t_rx_ns // S % 4 > 0)
    healthy = [e for e in estimate(seldom, estimator).estimates if e.t_ns > 10 * S and e.health == "healthy"]
    assert len(healthy) > 100


def test_without_imu_it_says_so_and_goes_on(run, estimator) -> None:
    score = estimate(without(run, lambda m: isinstance(m, ImuSample)), estimator)
    assert score.estimates[-1].health == "degraded"
    assert "no IMU" in score.estimates[-1].reason
    assert score.rms()["position_m"] < 0.3


def test_without_imu_and_heading_it_is_lost_before_it_has_turned_far(run, estimator) -> None:
    silent = without(run, lambda m: not isinstance(m, UwbRanges) and between(m, 20, 40))
    estimates = [e for e in estimate(silent, estimator).estimates if e.t_ns > 20 * S]
    lost = next(e for e in estimates if e.health == "lost")
    assert lost.t_ns == pytest.approx(23.1 * S, abs=S / 8) and "nothing tells how the boat turns" in lost.reason
    assert abs(ssa(lost.psi_rad - run.truth(lost.t_ns / S)[2])) < 0.3


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
        if between(m, 10, 30)
    ]
    state, _ = estimator.step(state, shift[0])
    again = estimator.estimate(state, shift[0].t_ns)
    assert again.health == "initialising"
    assert "no sensor message for 60 s" in again.reason
    for m in shift:
        state, _ = estimator.step(state, m)
    assert state.restarts == 1
    assert estimator.estimate(state, 90 * S).health == "healthy"
