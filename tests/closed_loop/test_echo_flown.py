"""What the autopilot does with our overrides, seen and told over its own wires: one case a parameter that is wrong."""

import numpy as np
import pytest

from companion.core.messages import Alert, OverrideLease, VehicleRequest
from sim.world.autopilot.parameter_table import BOAT_PARAMETERS
from tests.support.drive_fixture import driving, voyage

STICKS = (1500,) * 16
SCALED = {f"SERVO{n}_FUNCTION": 147.0 + n for n in range(1, 5)} | {"SERVO8_FUNCTION": 94.0}
"""RCIN9Scaled to RCIN12Scaled, and an output that arming accepts, as in deploy/ardupilot/scaled.param."""


def told(run):
    return [m.text for m in run.of(Alert) if m.level != "info"]


def with_(**parameters):
    return {"parameters": {**BOAT_PARAMETERS, **parameters}}


def under_way(**world):
    run = voyage(7, **world)
    assert run.run(driving, 20.0), run.state.helm
    run.run(lambda r: False, 4.0)
    return run


def at_rest(run):
    run.run(lambda r: False, 1.0)
    return run.of(OverrideLease)[-1].source == "neutral" and abs(run.world.plant.motion.x[6:]).max() < 0.5


@pytest.mark.parametrize(
    "world",
    [
        {},
        {"receiver_us": STICKS},
        with_(**SCALED, **{f"RC{n}_DZ": 0.0 for n in range(9, 13)}),
        with_(**{f"SERVO{n}_FUNCTION": 58.0 + n for n in range(1, 5)}, SERVO8_FUNCTION=94.0),
        with_(SCHED_LOOP_RATE=50.0),
    ],
    ids=["gate", "gate with a receiver", "scaled", "plain", "slow loop"],
)
@pytest.mark.long
def test_where_all_is_right_nothing_is_told(world):
    run = under_way(**world)
    assert run.state.helm.mode == "auto" and told(run) == []
    shown = np.array([m.pwm_us[:4] for m in run.messages if type(m).__name__ == "ServoOutput"])
    assert np.ptp(shown[-30:], axis=0).max() > 20, "it drove, and the echo moved with it"


@pytest.mark.parametrize(
    "parameter", [{"SYSID_MYGCS": 255.0}, {"RC_OVERRIDE_TIME": 0.0}], ids=["sysid", "override time"]
)
def test_an_autopilot_that_does_not_take_overrides_is_neither_armed_nor_driven(parameter):
    run = voyage(7, **with_(**parameter))
    run.run(lambda r: False, 8.0)
    assert run.state.helm.mode == "starting" and "SYSID_MYGCS" in run.state.helm.why
    (text,) = [t for t in told(run) if "does not take our overrides" in t]
    assert "which must be 1" in text and "RC_OVERRIDE_TIME" in text
    assert not [m for m in run.of(VehicleRequest) if m.action == "arm"]
    assert {m.source for m in run.of(OverrideLease)} == {"neutral"}


def test_overrides_that_are_refused_under_way_stop_the_boat():
    """With a receiver that rests in the middle neutral looks obeyed: it shows when it drives."""
    run = under_way(receiver_us=STICKS)
    run.world.rover.vehicle.parameters.set("RC_OVERRIDE_TIME", 0.0)
    refused_ns = run.world.t_ns
    assert run.run(lambda r: r.state.helm.mode == "safe", 6.0)
    assert (run.world.t_ns - refused_ns) * 1e-9 < 1.5, "what leaves the autopilot shows it before RC_CHANNELS counts"
    assert "RC_OVERRIDE_TIME" in run.state.helm.why and at_rest(run)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda rover: setattr(rover.vehicle.modes, "safety_on", True), "BRD_SAFETY_DEFLT"),
        (lambda rover: rover.vehicle.parameters.set("SERVO2_FUNCTION", 0.0), "SERVOn_FUNCTION"),
        (lambda rover: rover.vehicle.parameters.set("SERVO3_FUNCTION", 59.0), "which was not sent"),
    ],
    ids=["safety switch", "an output without function", "another channel's pulses"],
)
@pytest.mark.long
def test_outputs_that_do_not_follow_are_told_with_the_parameter_to_look_at(change, words):
    run = under_way()
    change(run.world.rover)
    assert run.run(lambda r: any(words in text for text in told(r)), 4.0), told(run)
    assert all(m.level == "error" for m in run.of(Alert) if words in m.text)


def test_a_hand_on_the_transmitter_takes_the_boat_and_keeps_it():
    run = under_way(receiver_us=STICKS)
    run.world.receiver_us = (*STICKS[:5], 1800, *STICKS[6:])
    assert run.run(lambda r: r.state.helm.mode == "safe", 1.5)
    assert "the pilot moved RC channel 6 from 1500 to 1800 us" in run.state.helm.why and at_rest(run)
    run.world.receiver_us = STICKS
    run.run(lambda r: False, 2.0)
    assert run.state.helm.mode == "safe" and at_rest(run)
