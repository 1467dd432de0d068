"""A boat that is driven by hand and asks which thruster it is asks only while its thrusters are wanted."""

import numpy as np
import pytest
from msgspec.structs import replace

from companion.core.model.thrusters import configuration_matrix
from companion.core.pilot.trust.thrusters.remaining_thrust import ThrusterHealth
from companion.core.pilot.trust.thrusters.thruster_verdict import ThrusterState
from tests.companion.core.pilot.pilot_shell import VESSEL
from tests.companion.core.pilot.test_pilot_modes import Boat

B = configuration_matrix(VESSEL)
NEUTRAL = (1500,) * 8
STUCK = ThrusterHealth((1.0,) * 4, (None, 4.0, None, None), (0, 1, 2, 3))
DEAD = ThrusterHealth((0.0, 1.0, 1.0, 1.0), (None,) * 4, (0, 1, 2, 3))


def driven(held, **trouble):
    """Pulse widths of the last of ten ticks by hand; the boat is in this trouble at each."""
    return leased(held, **trouble).pwm_us


def leased(held, **trouble):
    boat = Boat("manual", held=0.5)
    for share in (0.5, 0.5, *(8 * (held,))):
        boat.sticks = share
        boat.state = boat.state.with_monitors(replace(boat.state.monitor(ThrusterState), **trouble))
        boat.tick()
    assert boat.leases[-1].source == "manual"
    return boat.leases[-1]


@pytest.mark.parametrize("trouble", [{}, {"probing": True}, {"health": STUCK}])
def test_sticks_at_rest_are_neutral_whatever_the_boat_would_like_to_know(trouble):
    assert driven(0.0, **trouble) == NEUTRAL


@pytest.mark.parametrize(("mode", "pushes"), [("manual", True), ("excitation", False), ("idle", False)])
def test_nobody_probes_where_thrusters_are_not_judged(mode, pushes):
    """It went through a whole excitation, and spoilt what was to be identified."""
    boat = Boat(mode)
    boat.state = boat.state.with_monitors(replace(boat.state.monitor(ThrusterState), probing=True))
    boat.tick()
    assert boat.state.monitor(ThrusterState).probing is pushes


def test_sticks_that_are_held_are_obeyed_and_may_be_probed():
    plain, probed = driven(0.5), driven(0.5, probing=True)
    assert min(plain[:4]) > 1600
    assert plain[:4] != probed[:4]


@pytest.mark.parametrize("health", [DEAD, STUCK])
def test_half_ahead_by_hand_is_straight_half_ahead_with_a_thruster_less(health):
    """The rate limit, from what is left of a thruster, made another body force of it: 4 N to port, 3 N m with it."""
    whole, rest = (B @ np.array(leased(0.5, **trouble).f_command_n) for trouble in ({}, {"health": health}))
    assert rest == pytest.approx(whole, abs=0.2)
