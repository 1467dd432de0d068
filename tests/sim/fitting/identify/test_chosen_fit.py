"""The choice of model and method by prediction of the other half of the logs. Seeds as stated at each call."""

import numpy as np
import polars as pl
import pytest
from msgspec.structs import replace

from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.run import Run
from companion.logs.runs.splits import HeldOut
from sim.fitting.engine.smoothing import SmootherNoise, smooth
from sim.fitting.identify.chosen_fit import ChosenFit, fit_chosen
from sim.fitting.identify.folds import HORIZONS_S, folds
from sim.fitting.identify.refinements import REFINEMENTS, missing
from sim.fitting.identify.structured_fit import FitSettings
from sim.fitting.identify.trials import MULTI_STEP, WINDOWS
from sim.fitting.identify.vessel_out import identified_vessel
from sim.fitting.validate.models import VesselSimulator
from sim.fitting.validate.scores import SpeedBox
from sim.fitting.validate.study import validate
from sim.world.teleop_log import teleop_run
from tests.support.vessel_fixtures import boat

FILE = boat("aritra")
N_UR = -10.0


def chosen(*runs: Run) -> ChosenFit:
    return fit_chosen(runs, FILE, FitSettings(), lambda _text, _share: None)


def kept(found: ChosenFit) -> set[str]:
    (trial,) = [t for t in found.trials if t.kept]
    return set(trial.refinements)


def weak_astern() -> VesselFile:
    """Three quarters of the thrust astern, and yaw damping that grows with speed."""
    maps = {name: replace(m, k_astern_N_s2=0.75 * m.k_astern_N_s2) for name, m in FILE.force_maps.items()}
    terms = {"speed_damping": {"N_ur_N_s2": N_UR, "source": "test"}}
    return replace(FILE, force_maps=maps, terms=terms)


def position_error_m(vessel: VesselFile, run: Run) -> float:
    noise = SmootherNoise.of(FILE)
    box = SpeedBox.of(smooth(run, noise).nu)
    found = validate([VesselSimulator("it", vessel)], [HeldOut(run)], FILE, noise, box=box, seed=0)
    (score,) = [s for s in found.scores if s.name == "it"]
    return float(score.rms["position"][score.horizons_s.index(10)])


def test_what_the_file_lacks_is_found_and_written():
    found = chosen(teleop_run(weak_astern(), 2, 150.0, uwb_hz=5.0, sigma_m=0.07))
    assert {"astern", "speed_damping"} <= kept(found)
    assert found.result["astern_t200"].value == pytest.approx(0.75, abs=4 * found.result["astern_t200"].se + 0.01)
    assert found.result["N_ur_N_s2"].value == pytest.approx(N_UR, abs=4 * found.result["N_ur_N_s2"].se + 0.1)
    written = identified_vessel(found.vessel, found.result, date="2026-01-01")
    assert written.force_maps["t200"].astern_share == pytest.approx(0.75, abs=0.02)
    other = teleop_run(weak_astern(), 102, 60.0, uwb_hz=5.0, sigma_m=0.03)
    assert position_error_m(written, other) < 0.1 < position_error_m(FILE, other)


def test_a_boat_like_its_file_keeps_model_and_short_windows():
    found = chosen(teleop_run(FILE, 4, 150.0, uwb_hz=5.0, sigma_m=0.07))
    assert kept(found) == set() and found.method == WINDOWS and found.result.converged


def test_an_accelerometer_that_no_model_explains_costs_no_result():
    """0.3 m/s^2 of errors that last about a second (seed 1): short windows find no solution with them."""
    log = teleop_run(FILE, 1, 150.0, uwb_hz=5.0, sigma_m=0.07)
    rng = np.random.default_rng(1)
    wrong = {axis: pl.col(axis) + wandering(log, rng) for axis in ("ax_m_s2", "ay_m_s2")}
    found = chosen(Run(log.table.with_columns(**wrong), log.meta))
    windows = next(t for t in found.trials if t.method == WINDOWS)
    assert found.method == MULTI_STEP and windows.error == np.inf and found.result.converged
    assert found.result["X_uu_N_s2_m2"].value == pytest.approx(-12.0, rel=0.3)


def wandering(log: Run, rng: np.random.Generator, sigma: float = 0.3) -> pl.Series:
    """First-order Gauss-Markov process that forgets in a second."""
    t_s = log.table["t_s"].to_numpy()
    keep = np.exp(-np.median(np.diff(t_s)))
    values = sigma * rng.normal(size=len(t_s))
    for k in range(1, len(values)):
        values[k] = keep * values[k - 1] + np.sqrt(1 - keep**2) * values[k]
    return pl.Series(values)


def test_settings_that_state_the_method_are_obeyed():
    log = teleop_run(FILE, 6, 40.0)
    found = fit_chosen([log], FILE, FitSettings(horizon_s=5.0), lambda _text, _share: None)
    assert found.method == MULTI_STEP and found.result.horizon_s == 5.0 and found.trials == ()


@pytest.mark.parametrize(
    ("seconds", "horizon_s"), [(240.0, HORIZONS_S[0]), (60.0, HORIZONS_S[1]), (35.0, HORIZONS_S[2])]
)
def test_halves_of_one_log_are_alternate_blocks_as_long_as_it_allows(seconds, horizon_s):
    log = teleop_run(FILE, 7, seconds)
    halves = folds([log], FILE)
    assert halves is not None and halves.horizon_s == horizon_s
    first, second = ([run.measured_s() for run in runs] for runs in halves.runs)
    assert not set(np.concatenate(first)) & set(np.concatenate(second))


def test_four_logs_are_used_whole_and_a_short_log_has_no_halves():
    logs = [teleop_run(FILE, seed, 50.0) for seed in range(4)]
    halves = folds(logs, FILE)
    assert halves is not None
    assert sorted(run.data_hash for runs in halves.runs for run in runs) == sorted(log.data_hash for log in logs)
    assert folds([teleop_run(FILE, 8, 20.0)], FILE) is None


def test_only_what_the_file_lacks_is_tried():
    vessel = FILE
    for refinement in REFINEMENTS:
        assert refinement in missing(vessel)
        vessel = refinement.applied(vessel)
        assert refinement not in missing(vessel)
