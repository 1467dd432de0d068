"""What is left of the thrusters gives the plan's body force, by pulses that do it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.core.model.thrusters import configuration_matrix, force_from_pwm
from companion.core.pilot.trust.thrusters.remaining_thrust import RemainingThrust, ThrusterHealth
from tests.support.drive_fixture import setup

VESSEL = setup().pilot.vessel
B = configuration_matrix(VESSEL)
REMAINING = RemainingThrust(VESSEL)
SOUND = ThrusterHealth.sound(4)
VOLTS = 15.0
forces = st.lists(st.floats(-6, 6), min_size=4, max_size=4).map(np.array)


def with_(i, gain=1.0, stuck=None):
    gains, stucks = list(SOUND.gains), list(SOUND.stuck_n)
    gains[i], stucks[i] = gain, stuck
    return ThrusterHealth(tuple(gains), tuple(stucks), SOUND.order)


def comes(pulses, health):
    """Forces that really come for pulses, of thrusters with this health."""
    pulses = [pulses[health.order.index(i)] for i in range(4)]  # thruster i hangs where its pulse is expected not
    out = []
    for t, pwm, gain, stuck in zip(VESSEL.thrusters, pulses, health.gains, health.stuck_n, strict=True):
        force = force_from_pwm(t, VESSEL.force_maps[t.force_map], pwm, VOLTS)
        out.append(gain * force if stuck is None else stuck)
    return np.array(out)


@given(f=forces, i=st.integers(0, 3), gain=st.sampled_from([1.0, 0.4, 0.0, -1.0]))
def test_the_same_body_force_comes_whatever_one_thruster_is(f, i, gain):
    health = with_(i, gain)
    told = REMAINING.redistribute(f, health)
    assert B @ told == pytest.approx(B @ f, abs=0.1)
    assert comes(REMAINING.pulses(told, health, VOLTS), health) == pytest.approx(told, abs=0.3), "a pulse is a whole us"


@given(f=forces, i=st.integers(0, 3), stuck=st.floats(-8, 8))
def test_the_others_hold_against_one_that_is_stuck(f, i, stuck):
    health = with_(i, stuck=stuck)
    told = REMAINING.redistribute(f, health)
    assert told[i] == stuck and B @ told == pytest.approx(B @ f, abs=0.1)
    assert REMAINING.pulses(told, health, VOLTS)[i] == 1500, "nobody commands it any more"


@given(f=forces)
def test_pulses_of_two_that_changed_places_are_exchanged(f):
    health = ThrusterHealth(SOUND.gains, SOUND.stuck_n, (2, 1, 0, 3))
    sound = REMAINING.pulses(f, SOUND, VOLTS)
    assert REMAINING.pulses(f, health, VOLTS) == (sound[2], sound[1], sound[0], sound[3])


def test_what_is_sound_is_left_as_it_is_and_the_probe_moves_nothing():
    f = np.array([1.0, -2.0, 3.0, -4.0])
    assert REMAINING.redistribute(f, SOUND) is f
    first, then = REMAINING.probe(0), REMAINING.probe(1_000_000_000)
    assert first == pytest.approx(-then) and np.abs(first).max() == pytest.approx(3.0)
    assert B @ first == pytest.approx(np.zeros(3), abs=1e-9)
