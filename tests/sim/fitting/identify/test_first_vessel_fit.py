"""A first vessel file is good enough for a fit to start from. Seed 4."""

import pytest
from msgspec.structs import replace

from companion.core.model.first_vessel import first_vessel
from companion.core.model.manoeuvring import mass_matrix
from sim.fitting.identify.result import fit_structured
from sim.world.teleop_log import teleop_run
from tests.companion.core.model.test_first_vessel import ARITRA, T200
from tests.support.vessel_fixtures import boat


def test_a_fit_starts_from_it():
    """Logs of the reference boat, of which the file knows size and mass only."""
    run = teleop_run(boat("aritra"), 4, 90.0, uwb_hz=5.0, sigma_m=0.07)
    fitted = fit_structured([run], replace(first_vessel(ARITRA, "new", T200), sensors=boat("aritra").sensors))
    M = mass_matrix(boat("aritra"))
    assert fitted.converged
    assert fitted["M11_kg"].value == pytest.approx(M[0, 0], rel=0.15)
    assert fitted["M33_kg_m2"].value == pytest.approx(M[2, 2], rel=0.25)
