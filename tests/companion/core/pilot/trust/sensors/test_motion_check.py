"""A boat that moves otherwise than it is driven stops, and says what it had suspected by then."""

from dataclasses import replace
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from companion.core.estimation.latent_activity import LatentMeans
from companion.core.messages import Innovation
from companion.core.pilot.trust.sensors.motion_check import FORCE_TICKS, SLIP_TICKS, MotionMonitor, MotionState
from companion.core.pilot.trust.thrusters.thruster_verdict import ThrusterState
from tests.companion.core.pilot.monitors.monitor_fixture import view
from tests.companion.core.pilot.test_pilot_modes import Boat
from tests.support.vessel_fixtures import boat as vessel_of

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


S = 1_000_000_000
AT_REST = SimpleNamespace(
    since_ns=-10 * S, x=np.zeros(24), latent_means=LatentMeans(), settled=True, anchor_gates=[None] * 4,
    displaced_ns=None,
)  # fmt: skip


def contradicted_after_s(rate_Hz, d2, cycles=200, one_by_one=False):
    """When ranges to anchors that are off by d2 = nu^2 / S each are found to contradict; None: never."""
    vessel = vessel_of("aritra")
    uwb = msgspec.structs.replace(vessel.sensors.uwb, rate_Hz=rate_Hz)
    sensors = msgspec.structs.replace(vessel.sensors, uwb=uwb)
    monitor, state = MotionMonitor(msgspec.structs.replace(vessel, sensors=sensors)), MotionState()
    for k in range(round(cycles * max(1.0, 10.0 / rate_Hz))):
        t_ns = k * S // 10
        if k % max(1, round(10 / rate_Hz)) == 0:
            turn = round(k * rate_Hz / 10) % len(d2)
            for i, value in [(turn, d2[turn])] if one_by_one else enumerate(d2):
                seen = Innovation(t_ns=t_ns, sensor=f"range {i}", innovation=(1.0,), S=(1.0,), d2=value, accepted=False)
                state, _ = monitor.on_message(state, seen, t_ns)
        state, report = monitor.on_tick(state, replace(view(t_ns), belief=AT_REST))
        if report.events:
            return t_ns / S
    return None


@pytest.mark.parametrize(("rate_Hz", "within_s"), [(1.0, (1.0, 1.1)), (10.0, (0.7, 1.1))])
@pytest.mark.parametrize("d2", [(500.0, 900.0, 40.0, 300.0), (1.0, 900.0, 40.0, 300.0)])
def test_ranges_that_are_far_off_contradict_before_a_gate_re_opens(rate_Hz, within_s, d2):
    assert within_s[0] <= contradicted_after_s(rate_Hz, d2) <= within_s[1]


@pytest.mark.parametrize("rate_Hz", [1.0, 10.0])
@pytest.mark.parametrize(
    "d2", [(1.0, 0.5, 900.0, 900.0), (1.0, 0.5, 900.0), (0.5, 900.0), (900.0,), (2.0, 2.0, 2.0, 2.0)]
)
def test_some_bad_anchors_and_some_noise_contradict_nothing(rate_Hz, d2):
    assert contradicted_after_s(rate_Hz, d2) is None


def test_two_ranges_that_are_both_far_off_contradict_as_the_third_of_their_cycles_comes():
    assert contradicted_after_s(1.0, (500.0, 40.0)) == 2.0


@pytest.mark.parametrize(("d2", "found"), [((500.0, 900.0, 40.0, 300.0), True), ((1.0, 0.5, 900.0, 1.5), False)])
def test_ranges_that_come_one_by_one_are_judged_in_threes(d2, found):
    assert (contradicted_after_s(10.0, d2, one_by_one=True) is not None) is found


@pytest.mark.parametrize(
    ("biases_m", "displaced_ns", "found"),
    [
        ((0.0, 0.0, 3.9, 5.0), 2 * S, True),  # ranges of another scale: two anchors carry the boat off
        ((0.0, 0.0, 3.9, 5.0), None, False),  # two that were moved, while the others went on agreeing with the motion
        ((0.0, 0.1, 0.0, 2.5), 2 * S, False),
        ((0.0, 0.0, 0.9, 1.1), 2 * S, False),
    ],
)
def test_two_anchors_of_four_that_moved_the_boat_against_its_motion_do_not_vouch_for_a_place(
    biases_m, displaced_ns, found
):
    monitor = MotionMonitor(vessel_of("aritra"))
    belief = SimpleNamespace(**{**vars(AT_REST), "x": np.r_[np.zeros(20), biases_m], "displaced_ns": displaced_ns})
    _, report = monitor.on_tick(MotionState(), replace(view(3 * S), belief=belief))
    assert ("untrusted" in report.events) is found
    assert not found or "2 of 4 anchors are off by +3.9 and +5.0 m" in report.events["untrusted"]
