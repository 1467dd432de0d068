"""A boat that moves otherwise than it is driven stops, and says what it had suspected by then."""

from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from companion.core.estimation.latent_activity import LatentMeans
from companion.core.messages import Innovation, OperatorCommand
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
    since_ns=-10 * S, x=np.zeros(24), latent_means=LatentMeans(), settled=True, latest=[object()] * 4,
    was_displaced=lambda t_ns, within_s: False,
)  # fmt: skip


def contradicted_after_s(rate_Hz, d2, cycles=200, one_by_one=False):
    """When ranges to anchors that are off by d2 = nu^2 / S each are found to contradict; None: never."""
    vessel = vessel_of("aritra")
    uwb = replace(vessel.sensors.uwb, rate_Hz=rate_Hz)
    sensors = replace(vessel.sensors, uwb=uwb)
    monitor, state = MotionMonitor(replace(vessel, sensors=sensors)), MotionState()
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


def biased(state, biases_m, displaced_s, t_s, heard=None, vessel="aritra"):
    """State and condition at `t_s` where ranges moved the boat at `displaced_s` and anchors have these biases."""
    heard = len(biases_m) if heard is None else heard
    latest = [object()] * heard + [None] * (len(biases_m) - heard)
    belief = SimpleNamespace(**{
        **vars(AT_REST), "x": np.r_[np.zeros(20), biases_m], "latest": latest,
        "was_displaced": lambda t_ns, within_s: 0 <= t_ns / S - displaced_s < within_s,
    })  # fmt: skip
    state, report = MotionMonitor(vessel_of(vessel)).on_tick(state, replace(view(t_s * S), belief=belief))
    return state, report.events.get("untrusted", "")


@pytest.mark.parametrize(
    ("biases_m", "displaced_s", "heard", "found"),
    [
        ((0.0, 0.0, 3.9, 5.0), 2, 4, "2 of 4 anchors are off by +3.9 and +5.0 m"),  # another scale: two carry it off
        ((0.0, 0.0, 3.9, 5.0), -60, 4, ""),  # two that were moved, while the others went on agreeing with the motion
        ((0.0, 0.1, 0.0, 2.5), 2, 4, ""),
        ((0.0, 0.0, 0.9, 1.1), 2, 4, ""),
        ((2.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 2, 4, "2 of 4 anchors"),  # the others are out of reach
        ((2.0,) * 4 + (0.0,) * 4, 2, 8, "4 of 8 anchors"),
        ((2.0,) * 3 + (0.0,) * 5, 2, 8, ""),
    ],
)
def test_anchors_that_moved_the_boat_against_its_motion_do_not_vouch_for_its_place(biases_m, displaced_s, heard, found):
    _, text = biased(MotionState(), biases_m, displaced_s, 3, heard)
    assert (found in text) if found else not text


def test_what_moved_the_boat_is_doubted_after_a_new_start_too_and_what_comes_later_is_not():
    state, text = biased(MotionState(), (0.0, 0.0, 3.9, 5.0), 2, 3)
    assert text and "restart" in text
    monitor = MotionMonitor(vessel_of("aritra"))
    state, _ = monitor.on_message(state, OperatorCommand(t_ns=50 * S, command="start"), 50 * S)
    assert not state.findings and biased(state, (0.0, 0.0, 3.9, 5.0), 2, 60)[1]
    assert not biased(state, (0.0, 0.0, 0.1, 5.0), 2, 60)[1], "one has come back"
    assert not biased(MotionState(), (0.0, 0.0, 3.9, 5.0), 2, 60)[1]


def test_a_boat_without_uwb_has_no_anchors_to_doubt():
    """Its other sensors' slow errors stand where the anchors' would."""
    assert not biased(MotionState(), (3.0, 3.0), 2, 3, vessel="lake")[1]
