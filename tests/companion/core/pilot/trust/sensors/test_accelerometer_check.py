"""An accelerometer that hangs is left out, one that shakes is told; vibration, blows and rest are no fault."""

import math

import numpy as np
import pytest

from companion.core.messages import ImuSample, OperatorCommand
from companion.core.pilot.trust.sensors.accelerometer_check import AccelerometerMonitor
from tests.support.vessel_fixtures import boat

S = 1_000_000_000
FAULT_S, END_S = 4.0, 10.0


def watched(spoil, *, seed=1, turns=True, sigma=0.05, begins_s=FAULT_S):
    """The monitor, its state, when it withheld first [s], and its alerts; `spoil`: (t, a, dice) -> a."""
    monitor, rng = AccelerometerMonitor(boat("aritra").sensors.imu), np.random.default_rng(seed)
    state, first, alerts = monitor.initial, None, []
    for k in range(round(END_S * 50)):
        t_s, t_ns = k / 50, k * S // 50
        a = np.array([0.3 * math.sin(t_s), 0.2 * math.cos(t_s), -9.81]) + rng.normal(0, sigma, 3)
        if t_s >= begins_s:
            a = np.asarray(spoil(t_s, a, rng))
        ax, ay, az = (float(x) for x in np.round(a / 0.00981) * 0.00981)  # whole milli-g
        r = round(0.1 * math.sin(t_s) * turns, 3)
        sample = ImuSample(
            t_ns=t_ns, t_rx_ns=t_ns, ax_m_s2=ax, ay_m_s2=ay, az_m_s2=az, p_rad_s=0.0, q_rad_s=0.0, r_rad_s=r,
            source="RAW_IMU",
        )  # fmt: skip
        state, report = monitor.on_message(state, sample, t_ns)
        first = t_s if report.withhold and first is None else first
        alerts += [alert.text for alert in report.alerts]
    return monitor, state, first, alerts


def shaken(t, a, rng):
    return a + rng.normal(0, 1.0, 3)


def hanging(t, a, rng):
    return 0.4, 0.1, -9.8


def forgotten_by_a_start_alone(monitor, state):
    begun, _ = monitor.on_message(state, OperatorCommand(t_ns=0, command="start"), 0)
    kept, _ = monitor.on_message(state, OperatorCommand(t_ns=0, command="stop"), 0)
    return begun == monitor.initial and kept == state


def test_one_that_hangs_is_left_out_within_three_seconds_and_told_once():
    monitor, state, first, alerts = watched(hanging)
    assert FAULT_S < first < FAULT_S + 3.0
    assert len(alerts) == 1 and "the same reading" in alerts[0] and state.findings[0].what == "accel"
    assert forgotten_by_a_start_alone(monitor, state)


def test_one_that_shakes_is_told_once_and_goes_on():
    monitor, state, first, alerts = watched(shaken)
    assert first is None and len(alerts) == 1 and "shakes" in alerts[0]
    assert state.findings[0].what == "accel" and FAULT_S < state.findings[0].t_ns / S < FAULT_S + 3.0
    assert forgotten_by_a_start_alone(monitor, state)


def test_one_that_shakes_and_then_hangs_is_left_out():
    _, state, first, alerts = watched(lambda t, a, rng: shaken(t, a, rng) if t < 7.0 else hanging(t, a, rng))
    assert first > 7.0 and state.left_out and len(alerts) == 2


SOUND = {
    "nothing": lambda t, a, rng: a,
    "vibration of 0.3 m/s^2": lambda t, a, rng: a + rng.normal(0, 0.3, 3),
    "a blow against a pier": lambda t, a, rng: a + (rng.normal(0, 15.0, 3) if t < FAULT_S + 0.2 else 0.0),
    "waves that lean the hull by 8 degrees": lambda t, a, rng: a + 9.81 * math.sin(0.14 * math.sin(4.0 * t)),
}


@pytest.mark.parametrize("name", SOUND)
def test_a_sound_accelerometer_stays(name):
    assert watched(SOUND[name])[2:] == (None, [])


@pytest.mark.parametrize(("turns", "sigma"), [(False, 0.05), (True, 0.0)])
def test_a_boat_at_rest_or_in_a_world_without_noise_may_say_the_same_for_long(turns, sigma):
    still = (0.0, 0.0, -9.81)
    assert watched(lambda t, a, rng: still, turns=turns, sigma=sigma, begins_s=0.0 if turns else FAULT_S)[2:] == (
        None,
        [],
    )
