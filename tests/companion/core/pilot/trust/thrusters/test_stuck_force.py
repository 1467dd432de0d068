"""A thruster that is known to stick: at another force than was believed. Thruster 0; seeds 5 to 9, 20 to 27."""

import numpy as np
import pytest

from companion.core.pilot.trust.thrusters.hypothesis_bank import NOISE, ThrustHypothesis
from companion.core.pilot.trust.thrusters.remaining_thrust import ThrusterHealth
from companion.core.pilot.trust.thrusters.stuck_force import another_force
from companion.core.pilot.trust.thrusters.thruster_verdict import ASK_NATS
from tests.companion.core.pilot.trust.thrusters.driven_bank import BANK, MONITOR, VERDICTS, VESSEL, B, believing, driven


@pytest.mark.parametrize("seed", range(5, 10))
def test_one_that_cannot_be_borne_after_all_stops_the_boat_within_seconds(seed):
    """Believed at -10 N, which three others hold against for long; it is 16, which takes 42 % of all thrust."""
    alerts = []
    state = driven(believing(-10.0), -16.0, 15, seed, alerts=alerts)
    ((t_s, text),) = alerts
    assert t_s < 12.0 and state.health.stuck_n[0] == pytest.approx(-16.0, abs=3.5)
    assert text == f"thruster front_port is stuck at {round(state.health.stuck_n[0])} N, not -10 N"
    assert state.hopeless == f"{text.partition(',')[0]}; cut its power"


@pytest.mark.parametrize("seed", range(5, 8))
def test_one_that_can_be_borne_all_the_same_is_held_against_as_it_is(seed):
    state = driven(believing(4.0), 9.0, 30, seed)
    assert not state.hopeless and state.health.stuck_n[0] == pytest.approx(9.0, abs=2.5)
    assert state.findings == () and state.health.gains == (1.0,) * 4


@pytest.mark.parametrize("seed", range(5, 8))
def test_one_that_is_known_well_enough_is_not_told_of_again(seed):
    alerts = []
    state = driven(believing(-8.0), -7.0, 60, seed, alerts=alerts)
    assert not alerts and state.health.stuck_n[0] == -8.0


@pytest.mark.parametrize(
    ("force_n", "sigma_n", "counts"),
    [(-13.5, 1.0, True), (-12.5, 0.1, False), (-13.5, 2.0, False), (-4.0, 2.5, True), (-4.0, 3.5, False)],
)
def test_another_force_counts_where_it_surely_is_one_and_makes_a_difference(force_n, sigma_n, counts):
    """Believed at -10 N, of a thruster of 38."""
    state = believing(-10.0)
    state.bank.mean[0, 3], state.bank.P[0, 3, 3] = force_n, sigma_n**2
    assert another_force(state.bank, state.health, VESSEL) == ((0, force_n) if counts else None)


@pytest.mark.parametrize("seed", range(20, 28))
def test_a_push_is_not_taken_for_more_force_of_a_thruster_that_is_known_to_stick(seed):
    """10 to 40 N for 5 s, from where it has been known for 20."""
    size_n, towards, arm_m = np.random.default_rng(seed).uniform((10.0, -np.pi, -0.3), (40.0, np.pi, 0.3))
    wrench = size_n * np.array([np.cos(towards), np.sin(towards), arm_m])
    state = driven(believing(-8.0), -8.0, 40, seed, lambda t_s: wrench * (20.0 <= t_s < 25.0))
    assert not state.hopeless and state.health.stuck_n[0] == -8.0


def test_no_other_force_is_believed_while_sensors_contradict_each_other():
    assert driven(believing(-10.0), -16.0, 15, suspect=True).health.stuck_n[0] == -10.0


def test_one_that_is_told_nothing_by_hand_is_known_to_push_as_before():
    """Sticks at rest: neutral is commanded, and nothing is new of it."""
    bank, state = VERDICTS.bank(believing(-8.0).health), believing(-8.0).bank
    rng = np.random.default_rng(5)
    for _ in range(300):
        state = bank.step(state, -8.0 * B[:, 0] + rng.normal(0, NOISE), np.zeros(4), np.zeros(2), 0.1)
    assert state.nats.max() < ASK_NATS and state.mean[0, 3] == pytest.approx(-8.0, abs=2.5)


def test_what_blames_it_once_more_says_nothing_of_its_own_and_a_second_fault_is_found():
    state = driven(believing(-8.0), -8.0, 10)
    blames = [k for k, h in enumerate(BANK.hypotheses) if h.is_thruster and 0 in (h.i, h.j)]
    assert len(blames) == 5 and not state.bank.nats[blames].any()
    np.testing.assert_array_equal(state.bank.mean[blames, 3], state.bank.mean[0, 3])
    bank, seen, rng, f = VERDICTS.bank(state.health), state.bank, np.random.default_rng(5), np.zeros(4)
    for _ in range(100):
        f = f + 0.1 * (rng.normal(0, 15, 4) - f)
        seen = bank.step(
            seen, (-8.0 - f[0]) * B[:, 0] - 2.0 * f[2] * B[:, 2] + rng.normal(0, NOISE), f, np.zeros(2), 0.1
        )
    assert bank.hypotheses[int(np.argmax(seen.nats))] == ThrustHypothesis("gain", 2)


def test_a_boat_without_a_thruster_that_sticks_has_the_bank_that_it_had():
    assert VERDICTS.bank(ThrusterHealth.sound(4)) is BANK and VERDICTS.bank(believing(0.0).health) is not BANK
    np.testing.assert_array_equal(VERDICTS.initial(MONITOR.initial.health).mean, BANK.initial().mean)
