"""What is believed: a second fault beside the first is found, and thrust that is lost to speed, where there is any."""

import pytest
from msgspec.structs import replace

from sim.commission.belief import fitted, signs_checked
from sim.fitting.engine.split import NamedLog
from sim.fitting.wiring.correction import MIRRORED
from sim.world.teleop_log import teleop_run
from tests.sim.fitting.wiring.miswired import BOAT, FP, FS, drive


@pytest.mark.long
def test_a_second_fault_beside_the_first_is_found_too():
    mirrored = next(fault for fault in MIRRORED if fault.name == "positions:north")
    swapped = f"swapped:{FP}+{FS}"
    run = mirrored.apply(drive(swapped, seed=7300))
    found = signs_checked([NamedLog("log", run)], BOAT)
    assert {finding.name for finding in found.wiring.corrected} == {swapped, mirrored.name}, found.wiring
    assert found.wiring.unknown == ()


@pytest.mark.parametrize("loss_s_m", [0.0, 0.2])
def test_an_advance_loss_is_believed_where_there_is_one(loss_s_m):
    true = replace(BOAT, propulsion=replace(BOAT.propulsion, advance_loss_s_m=loss_s_m))
    model, fit = fitted(BOAT, [teleop_run(true, 3, 60.0)])
    assert (model != BOAT) == (loss_s_m > 0)
    assert ("advance_loss_s_m" in {p.name for p in fit.parameters}) == (loss_s_m > 0)
