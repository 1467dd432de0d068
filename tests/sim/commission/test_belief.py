"""What is believed: a second fault beside the first is found, and thrust that is lost to speed, where there is any."""

import pytest
from msgspec.structs import replace

from sim.commission.belief import learned, signs_checked
from sim.commission.job import CommissionOutcome
from sim.commission.journal import FlightJournal
from sim.commission.report import report
from sim.commission.stages import STAGES
from sim.fitting.engine.split import NamedLog
from sim.fitting.excite.design import gain_nats
from sim.fitting.excite.information import Knowledge
from sim.fitting.identify.refinements import with_advance_loss
from sim.fitting.identify.structured_fit import UNMEASURED
from sim.fitting.wiring.correction import MIRRORED
from sim.world.teleop_log import teleop_run
from tests.sim.fitting.wiring.miswired import BOAT, FP, FS, drive
from tests.support.excitation_fixture import BASIN


@pytest.mark.long
def test_a_second_fault_beside_the_first_is_found_too():
    mirrored = next(fault for fault in MIRRORED if fault.name == "positions:north")
    swapped = f"swapped:{FP}+{FS}"
    run = mirrored.apply(drive(swapped, seed=7300))
    found = signs_checked([NamedLog("log", run)], BOAT)
    assert {finding.name for finding in found.wiring.corrected} == {swapped, mirrored.name}, found.wiring
    assert found.wiring.unknown == ()


@pytest.mark.parametrize("loss_s_m", [0.0, 0.2])
def test_an_advance_loss_is_believed_and_reported_where_there_is_one(loss_s_m, tmp_path):
    true = replace(BOAT, propulsion=replace(BOAT.propulsion, advance_loss_s_m=loss_s_m))
    log = NamedLog("log", teleop_run(true, 3, 60.0))
    belief = learned(BOAT, [log], "2026-01-01")
    assert (belief.model != BOAT) == (loss_s_m > 0)
    assert belief.vessel.propulsion.advance_loss_s_m == pytest.approx(loss_s_m, abs=0.02)
    outcome = CommissionOutcome(belief, belief.vessel, reached=True)
    page = report(outcome, FlightJournal(tmp_path / "c", {}), BASIN, {})
    assert ("advance_loss_s_m" in page) == (loss_s_m > 0)


def test_what_a_flight_has_told_of_a_stage_is_the_same_whether_a_loss_stands_beside_it_or_not():
    plain, lossy = (Knowledge.prior(each, UNMEASURED) for each in (BOAT, with_advance_loss(BOAT)))
    for stage in STAGES:
        of, of_after = stage.indices(plain), stage.indices(lossy)
        assert gain_nats(plain, lossy, of, of_after) == pytest.approx(0.0, abs=1e-9), stage.name
