"""What positions leave open of the thrusters, decided by fits to all sensors, or left open."""

from dataclasses import replace as changed

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from companion.core.model.thrusters import configuration_matrix
from sim.commission.belief import signs_checked
from sim.commission.rivals import CLEAR_NATS, settled
from sim.fitting.engine.split import NamedLog
from sim.fitting.wiring.check import Checked
from sim.fitting.wiring.correction import Correction, turn
from sim.fitting.wiring.record import WiringFinding, WiringReport
from sim.fitting.wiring.thrusters import exchanged, ways
from sim.world.teleop_log import teleop_run
from tests.sim.commission.signs_flights import FOUR, flown, logs

GAINS = (0.66, 0.87, 1.09, 1.27)
"""Of a boat whose swapped thrusters two flights do not tell from others, by positions (drawn at random, seed 1093)."""
SIDE = {"front_starboard": "rear_starboard", "rear_starboard": "front_starboard"}


def uneven(vessel):
    return replace(vessel, thrusters=tuple(replace(t, gain=g) for t, g in zip(vessel.thrusters, GAINS, strict=True)))


@pytest.mark.long
@pytest.mark.parametrize("moves", [{}, SIDE], ids=["right", "swapped on one side"])
def test_two_flights_tell_which_way_each_thruster_pushes_aside_unless_the_imu_is_mounted_otherwise(moves, tmp_path):
    true = exchanged(uneven(FOUR), moves, "")
    found = logs(flown(true, FOUR, tmp_path / "flights", 2), FOUR)
    open_still = signs_checked(found, FOUR)
    assert bool(open_still.wiring.unknown) == bool(moves)
    known = settled(open_still)
    assert not known.wiring.unknown
    assert (np.sign(configuration_matrix(known.vessel)) == np.sign(configuration_matrix(true))).all()
    assert [(f.thrusters, f.certain) for f in known.wiring.findings] == [(True, True)] * bool(moves)
    assert all((f.nats or 0.0) > CLEAR_NATS for f in known.wiring.findings)
    assert msgspec.json.decode(msgspec.json.encode(known.wiring), type=WiringReport) == known.wiring
    for quarters in (1, 2):
        turned = Correction("turned", "", forces=turn(quarters), tilted=True)
        wrong = [NamedLog(log.name, turned.apply(log.run)) for log in found]
        doubtful = signs_checked(wrong, FOUR)
        assert settled(doubtful).vessel == FOUR


def test_what_is_not_open_or_no_matter_of_thrusters_is_left_as_it_is():
    nothing = Checked((), (), (), FOUR, WiringReport(logs=2))
    assert settled(nothing) is nothing
    for unknown in (("the heading is mirrored",), tuple(way.text for way in ways(FOUR) if way.faults == 1)):
        some = changed(nothing, wiring=WiringReport(logs=2, unknown=unknown))
        assert settled(some) is some


def test_of_what_was_put_right_already_the_rivals_are_no_matter_of_the_vessel_as_it_is_now():
    one, other = (way.text for way in ways(FOUR)[1:3])
    finding = WiringFinding(name="x", text=one, nats=9.0, certain=True, rivals=(other,), thrusters=True)
    some = Checked((), (), (), FOUR, WiringReport(logs=2, findings=(finding,)))
    assert settled(some) is some


def test_where_no_fit_can_be_made_it_stays_open():
    log = NamedLog("short", teleop_run(FOUR, 1, 3.0))
    some = Checked((log,), (), (), FOUR, WiringReport(logs=1, unknown=(ways(FOUR)[1].text,)))
    assert settled(some) is some
