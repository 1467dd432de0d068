"""Heading against gyro: which of the two is wrong, and what is no fault of either."""

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.core.messages import Attitude
from companion.core.pilot.trust.heading_check import HeadingMonitor, HeadingState
from tests.companion.core.pilot.monitors.monitor_fixture import view
from tests.support.vessel_fixtures import boat

S = 1_000_000_000
FAULT_S, END_S = 6.0, 12.0
TURN_RAD_S = 0.15


def course(t_s):
    """Heading [rad] and yaw rate [rad/s] of a boat that turns to and fro."""
    return TURN_RAD_S * 2.0 * math.sin(t_s / 2.0), TURN_RAD_S * math.cos(t_s / 2.0)


def watched(spoil, seed=1):
    """The monitor's state after 12 s at 50 Hz; `spoil`: what psi and r become from `FAULT_S` on."""
    monitor, rng = HeadingMonitor(boat("aritra").sensors, 0.0), np.random.default_rng(seed)
    state = HeadingState()
    for k in range(round(END_S * 50)):
        t_ns, (psi, r) = k * S // 50, course(k / 50)
        psi, r = psi + rng.normal(0, 0.002), r + rng.normal(0, 0.002)
        if k / 50 >= FAULT_S:
            psi, r = spoil(psi, r, rng)
        message = Attitude(
            t_ns=t_ns, t_rx_ns=t_ns, phi_rad=0.0, theta_rad=0.0, psi_rad=psi, p_rad_s=0.0, q_rad_s=0.0, r_rad_s=r
        )
        state, _ = monitor.on_message(state, message, t_ns)
        if k % 5 == 0:
            seen = replace(view(t_ns), belief=object(), model_nu=(0.0, 0.0, course(k / 50)[1]))
            state, _ = monitor.on_tick(state, seen)
    return state


FAULTS = {
    "gyro that hangs": (lambda psi, r, rng: (psi, 0.1), "gyro"),
    "gyro with the other sign": (lambda psi, r, rng: (psi, -r), "gyro"),
    "gyro with a bias": (lambda psi, r, rng: (psi, r + 0.2), "gyro"),
    "noisy gyro": (lambda psi, r, rng: (psi, r + rng.normal(0, 0.1)), "gyro"),
    "compass that hangs": (lambda psi, r, rng: (0.05, r), "heading"),
    "compass that swings": (lambda psi, r, rng: (3.0 * psi, r), "heading"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_the_one_that_is_wrong_is_named_within_two_seconds(name):
    spoil, what = FAULTS[name]
    (finding,) = watched(spoil).findings
    assert finding.what == what and finding.t_ns <= (FAULT_S + 2.0) * S


@pytest.mark.parametrize("name", ["none", "one spike", "the noise of a poor gyro"])
def test_what_is_no_fault_is_none(name):
    once = iter([3.0])
    spoils = {
        "none": lambda psi, r, rng: (psi, r),
        "one spike": lambda psi, r, rng: (psi, r + next(once, 0.0)),
        "the noise of a poor gyro": lambda psi, r, rng: (psi, r + rng.normal(0, 0.02)),
    }
    assert watched(spoils[name]).findings == ()
