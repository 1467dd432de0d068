"""A sensor that is stuck is left out, one that is only quiet is not; blindness is not over because a filter says so."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.core.messages import Alert, Attitude, ImuSample, OverrideLease, StateEstimate
from companion.core.messages.sensors import GnssFix
from companion.core.pilot import annunciator
from companion.core.pilot.monitors.stuck_sensor import LEAST, STUCK_NS, SensorRepeats, StuckSensorMonitor
from tests.companion.core.pilot.pilot_shell import N, on_the_leg, plan

MS = 1_000_000
IMU = ImuSample(
    t_ns=0, t_rx_ns=0, ax_m_s2=0.1, ay_m_s2=0.0, az_m_s2=-9.8, p_rad_s=0.0, q_rad_s=0.0, r_rad_s=0.0, source="RAW_IMU"
)
ATTITUDE = Attitude(t_ns=0, t_rx_ns=0, phi_rad=0.0, theta_rad=0.0, psi_rad=1.0, p_rad_s=0.0, q_rad_s=0.0, r_rad_s=0.0)


def said(messages, moves=True):
    """(withheld, each; levels of the alerts). `moves`: between two readings the other sensor tells of a turn."""
    state, stuck, levels = SensorRepeats(), [], []
    for k, message in enumerate(messages):
        state, report = StuckSensorMonitor().on_message(state, message, message.t_ns)
        stuck.append(report.withhold)
        levels += [a.level for a in report.alerts]
        other = ATTITUDE if isinstance(message, ImuSample) else IMU
        other = replace(other, t_ns=message.t_ns, r_rad_s=0.1 * (k % 2) * moves)
        state, _ = StuckSensorMonitor().on_message(state, other, other.t_ns)
    return stuck, levels


@given(st.integers(5, 250), st.sampled_from([IMU, ATTITUDE]))
def test_the_same_reading_for_a_second_is_a_stuck_sensor_whatever_its_stamps(period_ms, message):
    count = STUCK_NS // (period_ms * MS) + LEAST + 2
    stuck, told = said([replace(message, t_ns=k * period_ms * MS) for k in range(count)])
    begun = stuck.index(True)
    assert all(stuck[begun:]) and told == ["error"], "told once"
    assert begun == max(math.ceil(STUCK_NS / (period_ms * MS)), LEAST - 1), "not one reading earlier or later"


def test_pulses_tell_that_an_autopilot_is_frozen_whose_sensors_agree():
    """IMU and attitude stand still together, stamps go on: only the leases know better."""
    shell = on_the_leg()
    shell.state = shell.state.with_monitors(SensorRepeats())
    for k in range(15):
        for at_ns in range(shell.t_ns, shell.t_ns + 100 * MS, 20 * MS):
            shell.feed(*(replace(m, t_ns=at_ns, t_rx_ns=at_ns) for m in (IMU, ATTITUDE)))
        shell.tick()
        shell.feed(plan(shell.index, f_n=((20.0 if k % 4 < 2 else -20.0,) * N,) * 20))
    told = [o.text for o in shell.outputs if isinstance(o, Alert) and "frozen" in o.text]
    assert [text.split(":")[0] for text in told] == ["IMU (RAW_IMU)", "attitude"]


def test_one_digit_is_life_and_ends_it():
    quiet = [replace(IMU, t_ns=k * 20 * MS, ax_m_s2=0.1 + 0.01 * (k % 40 == 0)) for k in range(200)]
    assert said(quiet) == ([False] * 200, [])
    again = [replace(IMU, t_ns=k * 20 * MS) for k in range(60)] + [replace(IMU, t_ns=1300 * MS, r_rad_s=0.01)]
    stuck, told = said(again)
    assert stuck[59] and not stuck[60] and told == ["error", "info"]


@pytest.mark.parametrize(("period_ms", "stuck_from"), [(20, 50), (240, 5), (260, 4), (900, 4)])
def test_a_second_and_five_readings_are_needed_and_no_more(period_ms, stuck_from):
    """Counted from 0: the fifth reading has number 4."""
    stuck, _ = said([replace(ATTITUDE, t_ns=k * period_ms * MS) for k in range(60)])
    assert stuck.index(True) == stuck_from


@pytest.mark.parametrize("message", [IMU, ATTITUDE])
@pytest.mark.long
def test_a_boat_at_rest_may_say_the_same_for_an_hour(message):
    assert said([replace(message, t_ns=k * 20 * MS) for k in range(180_000)], moves=False) == ([False] * 180_000, [])


def lease(t_ns, pwm_us):
    channels = (9, 10, 11, 12)
    return OverrideLease(
        t_ns=t_ns,
        index=0,
        channels=channels,
        pwm_us=(pwm_us,) * 4,
        valid_for_s=0.3,
        source="plan",
        reason="",
        f_command_n=(0.0,) * 4,
    )


@pytest.mark.parametrize(("pwm_us", "stuck"), [(1500, False), (1550, False), (1700, True)])
def test_thrust_that_changes_and_is_not_felt_is_proof_though_both_sensors_say_the_same(pwm_us, stuck):
    """From the first new pulse half a second is allowed for it to be felt."""
    monitor, state, withheld = StuckSensorMonitor(), SensorRepeats(), []
    for k in range(200):
        t_ns = k * 20 * MS
        state, report = monitor.on_message(state, replace(IMU, t_ns=t_ns), t_ns)
        withheld.append(report.withhold)
        state, _ = monitor.on_message(state, lease(t_ns, pwm_us if k >= 100 else 1500), t_ns)
    assert not any(withheld[:125]) and all(held is stuck for held in withheld[126:])


@pytest.mark.parametrize("drift_rad_s2", [0.0, 1.5e-5])
def test_gyros_that_hiss_and_drift_do_not_say_that_a_boat_at_rest_moves(drift_rad_s2):
    """GNSS of a real autopilot at rest, to the last digit the same for five minutes; seed 1. Drift: SIM_DRIFT_SPEED."""
    monitor, state, rng = StuckSensorMonitor(), SensorRepeats(), np.random.default_rng(1)
    fix = GnssFix(t_ns=0, t_rx_ns=0, lat_deg=12.99, lon_deg=80.23, fix_type=3, v_north_m_s=0.0, v_east_m_s=0.0)
    for k, noise in enumerate(rng.normal(scale=0.002, size=(15_000, 3))):
        t_ns = k * 20 * MS
        p, q, r = map(float, noise + drift_rad_s2 * t_ns * 1e-9)
        state, _ = monitor.on_message(state, replace(IMU, t_ns=t_ns, p_rad_s=p, q_rad_s=q, r_rad_s=r), t_ns)
        if k % 10 == 0:
            state, report = monitor.on_message(state, replace(fix, t_ns=t_ns), t_ns)
            assert not report.withhold and not report.alerts
    state, _ = monitor.on_message(state, replace(IMU, t_ns=t_ns, r_rad_s=math.nan), t_ns)
    for _ in range(60):
        t_ns += 20 * MS
        state, _ = monitor.on_message(state, replace(IMU, t_ns=t_ns, r_rad_s=0.05), t_ns)
        state, report = monitor.on_message(state, replace(fix, t_ns=t_ns), t_ns)
    assert report.withhold, "it does as soon as it turns, in spite of a rate that is no number"


def test_two_readings_far_apart_are_no_proof():
    assert said([IMU, replace(IMU, t_ns=5000 * MS)]) == ([False, False], [])


def test_a_filter_that_starts_again_does_not_begin_the_blind_time_anew():
    """Degraded, healthy for a moment, degraded: all of it is one blindness; two healthy seconds end it."""
    estimate = StateEstimate(
        t_ns=0, north_m=0.0, east_m=0.0, psi_rad=0.0, u_m_s=0.0, v_m_s=0.0, r_rad_s=0.0, covariance=(0.0,) * 36,
        accel_bias_m_s2=(0.0, 0.0), gyro_bias_rad_s=0.0, anchor_bias_m={}, disturbance_n=(0.0, 0.0, 0.0),
        health="healthy", reason="",
    )  # fmt: skip
    seen, blind = annunciator.AnnunciatorState(), []
    story = ["degraded"] * 40 + ["healthy"] * 10 + ["degraded"] * 20 + ["healthy"] * 30 + ["degraded"] * 40
    for k, health in enumerate(story):
        t_ns = (k + 1) * 100 * MS
        seen, _ = annunciator.at_estimate(seen, replace(estimate, t_ns=t_ns, health=health))
        blind.append(annunciator.degraded_too_long(seen, t_ns, 5.0) is not None)
    assert not any(blind[:51]) and all(blind[51:70]), "5 s after it began, though healthy in between"
    assert not any(blind[70:]), "three healthy seconds: begins anew"
