"""Heading against gyro: which of the two is wrong, and what is no fault of either."""

import math
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from companion.core.messages import Attitude
from companion.core.pilot.trust.sensors.heading_check import HeadingMonitor, HeadingState
from companion.core.pilot.trust.sensors.turn_readings import Repetition
from tests.companion.core.pilot.monitors.monitor_fixture import view
from tests.support.vessel_fixtures import boat

S = 1_000_000_000
FAULT_S, END_S = 6.0, 12.0
TURN_RAD_S = 0.15


def course(t_s):
    """Heading [rad] and yaw rate [rad/s] of a boat that turns to and fro."""
    return TURN_RAD_S * 2.0 * math.sin(t_s / 2.0), TURN_RAD_S * math.cos(t_s / 2.0)


def watched(spoil, seed=1, end_s=END_S, share=lambda t_s: 0.1, runs_s=0.0, again=lambda message: (), course=course,
            start_s=FAULT_S, drives_s=0.0, **shown):  # fmt: skip
    """The monitor's state after 12 s at 50 Hz; `spoil`: what psi and r become from `start_s` on; `share`: of thrust;
    `runs_s`: since when the filter runs; `again`: what comes after each attitude; `drives_s`: since when
    thrusters may turn; `shown`: of the view.
    """
    vessel = boat("aritra")
    monitor, rng = HeadingMonitor(vessel, 0.0), np.random.default_rng(seed)
    state = HeadingState()
    for k in range(round(end_s * 50)):
        t_ns, (psi, r) = k * S // 50, course(k / 50)
        psi, r = psi + rng.normal(0, 0.002), r + rng.normal(0, 0.002)
        if k / 50 >= start_s:
            psi, r = spoil(psi, r, rng)
        message = Attitude(
            t_ns=t_ns, t_rx_ns=t_ns, phi_rad=0.0, theta_rad=0.0, psi_rad=psi, p_rad_s=0.0, q_rad_s=0.0, r_rad_s=r
        )
        for one in (message, *again(message)):
            state, report = monitor.on_message(state, one, t_ns)
            assert not state.jumped or math.isnan(report.instead.psi_rad), "it stays left out"
        if k % 5 == 0:
            f_n = np.array([share(k / 50) * t.force_max_N for t in vessel.thrusters])
            belief = SimpleNamespace(f_n=f_n) if k / 50 >= runs_s else None
            seen = {"belief": belief, "model_nu": (0.0, 0.0, course(k / 50)[1]), "driving": k / 50 >= drives_s, **shown}
            seen = replace(view(t_ns), **seen)
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


straight = partial(watched, course=lambda t_s: (0.0, 0.0))


@pytest.mark.parametrize(
    ("spoil", "what"), [(lambda psi, r, rng: (psi, 0.001), "gyro"), (lambda psi, r, rng: (0.001, r), "heading")]
)
def test_one_that_hangs_is_found_though_the_boat_goes_straight(spoil, what):
    (finding,) = straight(spoil).findings
    assert finding.what == what and finding.t_ns <= (FAULT_S + 0.7) * S


@pytest.mark.parametrize("degrees", [1.0, 0.1, 0.01])
def test_a_heading_in_whole_steps_does_not_hang_where_a_boat_that_circled_goes_straight(degrees):
    """At 10 Hz, of a boat that circles for 20 s."""
    readings, psi_rad = Repetition(), 0.0
    for k in range(400):
        psi_rad += math.radians(25.0 if k < 200 else 0.0) * 0.1
        readings = readings.take(math.radians(degrees) * round(math.degrees(psi_rad) / degrees), 0.1)
        assert not readings.hangs
    assert readings.lively > 100, "but for the steps it would"


@pytest.mark.parametrize(("rate_Hz", "within_s"), [(50, 0.5), (10, 1.0), (4, 2.5)])
def test_a_sensor_of_any_rate_hangs_after_half_a_second_and_ten_readings(rate_Hz, within_s):
    rng, readings = np.random.default_rng(4), Repetition()
    for _ in range(200):
        readings = readings.take(np.float32(rng.normal(1.0, 0.002)), 1 / rate_Hz)
        assert not readings.hangs
    for _ in range(math.ceil(within_s * rate_Hz)):
        readings = readings.take(readings.value, 1 / rate_Hz)
    assert readings.hangs


def test_one_that_was_silent_at_rest_has_half_a_second_to_live_again():
    """Its readings were clamped to zero until thrust shook it."""

    def resting(psi, r, rng):
        return (psi, 0.0) if next(times) < round(3.1 * 50) else (psi, r)

    times = iter(range(10**6))
    assert straight(resting, drives_s=FAULT_S + 3.0).findings == ()


def test_what_is_said_again_for_another_reason_does_not_hang():
    """At rest nothing shakes it; whole messages come again; a gyro says whole mrad/s."""
    hung, rounded = (lambda psi, r, rng: (psi, 0.001)), iter(range(10**6))
    assert straight(hung, driving=False).findings == ()
    assert straight(lambda psi, r, rng: (0.001, 0.001)).findings == ()
    assert straight(lambda psi, r, rng: (psi, next(rounded) // 50 % 2 * 1e-3), start_s=0.0).findings == ()


def test_one_of_them_that_may_be_wrong_keeps_thrusters_from_being_blamed():
    """A gyro that is wrong by 3 degrees a second for a second: not enough to say so."""
    early = watched(lambda psi, r, rng: (psi, r + 0.055), end_s=FAULT_S + 1.2)
    assert early.is_suspect and not early.findings
    assert not watched(lambda psi, r, rng: (psi, r)).is_suspect
    assert watched(lambda psi, r, rng: (psi, r + rng.normal(0, 0.1))).is_suspect, "what was found is not believed"
    assert not watched(lambda psi, r, rng: (psi + 0.4, r)).is_suspect, "a heading that jumped is left out"


def test_a_compass_that_drifts_is_found_though_slowly():
    """By 1 degree a second: more than the gyro's own drift, less than any short window shows."""
    drift = iter(np.arange(0.0, 10.0, math.radians(1.0) / 50))
    (finding,) = watched(lambda psi, r, rng: (psi + next(drift), r), end_s=30.0).findings
    assert finding.t_ns <= (FAULT_S + 14.0) * S


@pytest.mark.parametrize("late_ns", [0, 20_000_000])
def test_attitudes_out_of_order_or_of_the_same_instant_hide_nothing(late_ns):
    """Two in one packet of a link without a clock, or two packets that changed places, one in ten."""

    def again(message):
        return (replace(message, t_ns=message.t_ns - late_ns),) if message.t_ns % (S // 5) == 0 else ()

    drift = iter(np.arange(0.0, 10.0, math.radians(6.0) / 50))
    (finding,) = watched(lambda psi, r, rng: (psi + next(drift), r), again=again).findings
    assert finding.what == "heading" and finding.t_ns <= (FAULT_S + 2.0) * S
    assert watched(lambda psi, r, rng: (psi + 0.4, r), again=again).jumped


def test_a_heading_that_jumped_is_left_out_after_a_gap_too():
    state, monitor = watched(lambda psi, r, rng: (psi + 0.4, r)), HeadingMonitor(boat("aritra"), 0.0)
    t_ns = round(END_S * S) + 2 * S
    late = Attitude(
        t_ns=t_ns, t_rx_ns=t_ns, phi_rad=0.0, theta_rad=0.0, psi_rad=0.4, p_rad_s=0.0, q_rad_s=0.0, r_rad_s=0.0
    )
    _, report = monitor.on_message(state, late, t_ns)
    assert state.jumped and math.isnan(report.instead.psi_rad)


def test_without_attitudes_no_memory_grows():
    monitor, seen = HeadingMonitor(boat("aritra"), 0.0), replace(view(0), belief=SimpleNamespace(f_n=np.zeros(4)))
    seen = replace(seen, model_nu=(0.0, 0.0, 0.0))
    state = watched(lambda psi, r, rng: (psi, r))
    kept = len(state.past)
    for _ in range(100):
        state, _ = monitor.on_tick(state, seen)
    assert len(state.past) <= kept + 1


@pytest.mark.parametrize(("share", "found"), [(0.9, 0), (0.1, 1)])
def test_a_compass_that_full_thrust_turns_is_no_fault(share, found):
    """By 0.2 rad within two seconds of setting off, as BlueBoat's run 216; without thrust it is one."""
    turned = iter(0.2 * np.minimum(1.0, np.arange(0.0, 40.0, 0.02) / 2.0))
    state = watched(
        lambda psi, r, rng: (psi + next(turned), r), end_s=30.0, share=lambda t_s: share if t_s > FAULT_S else 0.0
    )
    assert len(state.findings) == found


def test_a_heading_that_jumps_is_left_out_but_not_while_an_autopilot_still_finds_it():
    """A real Rover 4.7 turned by 21 degrees 2 s after its start, before there was an estimate."""
    jumps = partial(watched, lambda psi, r, rng: (psi + 0.4, r))
    assert jumps().jumped and jumps().findings[0].what == "heading"
    before = jumps(runs_s=FAULT_S + 1.0)
    assert not before.jumped and not before.findings
