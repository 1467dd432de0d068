"""A boat that moves otherwise than it is driven stops, and says what it had suspected by then."""

from dataclasses import replace

import pytest

from companion.core.pilot.trust.motion_check import FORCE_TICKS, SLIP_TICKS, MotionState
from companion.core.pilot.trust.thruster_monitor import ThrusterState
from tests.companion.core.pilot.test_pilot_modes import Boat

SUSPECTED = "thruster front_port gives another force or thruster front_port is stuck"


@pytest.mark.parametrize("suspected", ["", SUSPECTED])
def test_what_was_suspected_stands_in_the_reason_of_the_stop(suspected):
    boat = Boat("auto")
    slipping = MotionState(slip_m_s=(2.0, 0.0), beyond=SLIP_TICKS, forced=FORCE_TICKS)
    boat.state = boat.state.with_monitors(slipping, replace(boat.state.monitor(ThrusterState), suspected=suspected))
    boat.tick()
    assert boat.mode == "safe" and not boat.moves
    why = boat.state.helm.why
    assert "otherwise than it is driven" in why
    assert (f"; suspected before: {SUSPECTED}" in why) == bool(suspected)
