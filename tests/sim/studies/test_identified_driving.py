"""Pilots with different beliefs in one true boat."""

import math

import numpy as np
import pytest

from companion.boat.load_run import EXAMPLES, load_setup
from companion.core.model.manoeuvring import StructuredModel
from sim.fitting.taylor.abkowitz import AbkowitzModel
from sim.studies.boats.draw import draw_boat
from sim.studies.driving.identified import BelievedModel, missions, start_of
from tests.support.vessel_fixtures import boat

FILE = boat("aritra")
SETTINGS = load_setup(EXAMPLES / "aritra.toml").pilot


def test_a_pilot_plans_with_what_he_believes() -> None:
    assert isinstance(BelievedModel("true", FILE).model, StructuredModel)
    series = BelievedModel("Taylor", FILE, np.ones((3, 23))).model
    assert isinstance(series, AbkowitzModel)
    assert series.lag_s == FILE.propulsion.lag_s and (series.coefficients == 1.0).all()


def test_starts_differ_by_seed_and_stay_near() -> None:
    starts = np.array([start_of(seed) for seed in range(50)])
    assert len(set(map(tuple, starts))) == 50
    assert (np.abs(starts - [8.0, 8.0, 0.0]) <= [0.5, 0.5, 0.6]).all()


@pytest.mark.long
def test_the_same_seed_is_the_same_run_and_the_belief_matters() -> None:
    true = draw_boat(FILE, np.random.default_rng(114), gain_sigma=0.0)
    beliefs = (BelievedModel("true", true), BelievedModel("true", true), BelievedModel("file", FILE))
    first, again, file = (missions(true, b, SETTINGS, [115], limit_s=18.0)[0] for b in beliefs)
    assert first == again
    assert first.cross_track_rms_m != file.cross_track_rms_m and file.belief == "file"
    assert first.plans == 1.0 and first.missed >= 2 and first.seconds == pytest.approx(18.0)
    assert 0.0 < first.cross_track_rms_m < 0.6


def test_a_boat_that_never_gets_under_way_has_no_figures() -> None:
    (found,) = missions(FILE, BelievedModel("true", FILE), SETTINGS, [116], limit_s=0.5)
    assert math.isnan(found.cross_track_rms_m) and math.isnan(found.position_rmse_m)
    assert found.missed == len(SETTINGS.mission.path.points) and found.plans == 0.0
