"""What a lab measures of a boat, what the fit makes of it, and the scores of a campaign's boats."""

import numpy as np
import pytest
from msgspec.structs import replace

from companion.core.model.manoeuvring import mass_matrix
from sim.fitting.engine.parameters import Parameters
from sim.studies.boats.campaign import BoatScore, figures, line, one_boat
from sim.studies.boats.draw import draw_boat, in_still_air
from sim.studies.boats.lab_priors import BOLLARD, WEIGHED, WIDE_GAIN, LabPriors, measured, settings_for
from sim.studies.boats.open_loop import STARTS, distances, rms
from sim.world.teleop_log import teleop_run
from tests.support.vessel_fixtures import boat

FILE = boat("aritra")
TRUE = draw_boat(FILE, np.random.default_rng(111), gain_sigma=0.0)


@pytest.fixture(scope="module")
def scores() -> tuple[BoatScore, ...]:
    return one_boat(FILE, 112, 1.0, 0.10, labs=(WEIGHED, BOLLARD), train_s=120.0)


def test_a_weighed_boat_has_its_mass_and_no_more() -> None:
    file, settings = measured(FILE, TRUE, WEIGHED, np.random.default_rng(1))
    assert file.inertia.mass_kg == pytest.approx(TRUE.inertia.mass_kg, rel=0.02)
    assert file.inertia.mass_kg != TRUE.inertia.mass_kg
    assert [t.gain for t in file.thrusters] == [t.gain for t in FILE.thrusters]
    assert replace(file, inertia=FILE.inertia) == FILE and file.inertia.X_udot_kg == FILE.inertia.X_udot_kg
    assert settings.sigmas.gain == WIDE_GAIN


def test_the_prior_of_surge_inertia_is_the_scale_and_the_added_mass_together() -> None:
    centre, sigma = (a[Parameters(FILE).names.index("M11_kg")] for a in _prior(WEIGHED))
    assert centre == pytest.approx(np.log(mass_matrix(FILE)[0, 0]))
    assert sigma == pytest.approx(np.hypot(0.005 * 45.0, 0.145 * 4.5) / 49.5)
    no_scale = _prior(LabPriors("nothing measured"))[1]
    assert no_scale[Parameters(FILE).names.index("M11_kg")] == 0.5


def _prior(lab: LabPriors) -> tuple[np.ndarray, np.ndarray]:
    settings = settings_for(FILE, lab)
    return Parameters(FILE, settings.sigmas, settings.overrides).prior


def test_a_bollard_pull_says_the_gains_and_no_more() -> None:
    file, settings = measured(FILE, TRUE, BOLLARD, np.random.default_rng(1))
    ratio = [a.gain / b.gain for a, b in zip(file.thrusters, TRUE.thrusters, strict=True)]
    assert ratio == pytest.approx([1.0] * 4, abs=0.1) and len(set(ratio)) == 4
    assert file.inertia == FILE.inertia
    assert settings.sigmas.gain == 0.025 and not settings.overrides


@pytest.mark.long
def test_either_measurement_gives_the_scale_and_the_same_ratios(scores: tuple[BoatScore, ...]) -> None:
    assert [s.lab for s in scores] == [WEIGHED.name, BOLLARD.name]
    for s in scores:
        assert np.median(np.abs(list(s.error.values()))) < 0.05
        assert np.median(np.abs(list(s.scale_free_error.values()))) < 0.01
        assert s.stable
        assert set(s.covered) == set(s.z) and {"tag_x_m", "tag_y_m"} == set(s.covered) - set(s.error)
    weighed, pulled = scores
    assert "M11_kg" in weighed.undetermined, "known from the scale, not from the log"
    assert not {n for n in pulled.undetermined if not n.startswith("warp_")}
    for name, error in weighed.scale_free_error.items():
        assert error == pytest.approx(pulled.scale_free_error[name], abs=0.01), name


@pytest.mark.long
def test_identified_moves_like_the_boat_and_the_series_does_not(scores: tuple[BoatScore, ...]) -> None:
    for start in STARTS:
        m = {name: rms(d) for name, d in scores[0].open_loop_m[start].items()}
        assert m["identified"] < 0.4 * min(m["file"], m["taylor"], m["taylor_smoother"]), start
    exact = scores[0].open_loop_m["exact"]
    assert rms(exact["true"]) < 0.05 < rms(scores[0].open_loop_m["filter"]["true"])


@pytest.mark.long
def test_figures_take_boats_together(scores: tuple[BoatScore, ...]) -> None:
    one, all_ = figures(scores[:1]), figures([scores[0], scores[1]])
    assert np.isnan(one.coverage_half) and one.coverage == np.mean(list(scores[0].covered.values()))
    by_boat = [np.mean(list(s.covered.values())) for s in scores]
    assert all_.coverage == pytest.approx(np.mean(by_boat))
    assert all_.coverage_half == pytest.approx(12.7062 * abs(by_boat[0] - by_boat[1]) / 2, rel=1e-4)
    pooled = [*scores[0].open_loop_m["filter"]["true"], *scores[1].open_loop_m["filter"]["true"]]
    assert all_.rms_m["filter"]["true"] == pytest.approx(np.sqrt(np.mean(np.square(pooled))))
    assert all_.unstable == 0 and "boat 112" in line(scores[0])


def test_a_series_that_runs_away_is_infinitely_far() -> None:
    boat_ = in_still_air(FILE)
    unseen = teleop_run(FILE, 113, 70.0)
    away = np.zeros((3, 23))
    away[:, [1, 10]] = 5.0  # speeds grow by themselves, the faster the larger they are
    found = distances(unseen, {"file": boat_}, {"away": away}, "exact", np.random.default_rng(1))
    assert np.isinf(found["away"]).all() and (found["file"] < 0.05).all()
    assert np.isinf(rms(found["away"]))
