"""Signs and sides are asked again after something was put right: beside one fault there may be another."""

import pytest

from sim.commission.belief import signs_checked
from sim.fitting.engine.split import NamedLog
from sim.fitting.wiring.correction import MIRRORED
from tests.sim.fitting.wiring.miswired import BOAT, FP, FS, drive


@pytest.mark.long
def test_a_second_fault_beside_the_first_is_found_too():
    mirrored = next(fault for fault in MIRRORED if fault.name == "positions:north")
    swapped = f"swapped:{FP}+{FS}"
    run = mirrored.apply(drive(swapped, seed=7300))
    found = signs_checked([NamedLog("log", run)], BOAT)
    assert {finding.name for finding in found.wiring.corrected} == {swapped, mirrored.name}, found.wiring
    assert found.wiring.unknown == ()
