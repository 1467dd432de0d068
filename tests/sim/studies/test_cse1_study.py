"""The study on the real recordings, cut short; all of it: scripts/evidence identify --only cse1."""

import numpy as np
import pytest

from companion.logs.runs.splits import part
from sim.fitting.identify.result import fit_structured
from sim.fitting.identify.vessel_out import identified_vessel
from sim.fitting.validate.models import VesselSimulator
from sim.studies.cse1.study import RUNS, STRUCTURED, across, across_trimmed, crude, errors_of, held_out, recording
from tests.support.vessel_fixtures import boat

VESSEL = boat("cse1")


@pytest.mark.long
def test_half_a_run_predicts_the_other_half_and_beats_a_crude_model(shared_data) -> None:
    """The first six minutes of random_run1 fitted, the last five predicted, in every channel at 10 s."""
    run = recording(shared_data / "cse1", RUNS[0])
    found = fit_structured([part(run, 0.0, 360.0)], VESSEL)
    first = fit_structured([part(run, 0.0, 360.0)], VESSEL, crude(VESSEL))
    assert found.converged and found.iterations < 40
    models = [
        VesselSimulator(name, identified_vessel(VESSEL, fit, date="in a test", session=True))
        for name, fit in ((STRUCTURED, found), ("crude", first))
    ]
    errors = errors_of("half", models, held_out(run, VESSEL, [(360.0, 705.0)]))
    ratios = {
        name: np.array([errors.ratio(name, c, 10) for c in ("position", "u", "v", "r")])
        for name in (STRUCTURED, "crude")
    }
    assert ratios[STRUCTURED].max() < 0.75
    assert (ratios[STRUCTURED] < ratios["crude"]).all()


@pytest.mark.long
def test_one_joystick_run_predicts_the_other_and_trims_of_the_day_mend_station_keeping(shared_data) -> None:
    one, three, keeping = (recording(shared_data / "cse1", name) for name in RUNS)
    (there, _), found = across(one, [three, keeping], VESSEL)
    assert max(there.ratio(STRUCTURED, c, h) for c in ("position", "heading", "u", "v", "r") for h in (10, 20)) < 0.8
    trimmed = across_trimmed(found, keeping, VESSEL)
    plain = f"{STRUCTURED}, trims of the file"
    assert trimmed.of(STRUCTURED, "u", 10) < 0.5 * trimmed.of(plain, "u", 10)
