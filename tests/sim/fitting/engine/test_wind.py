"""Wind that a log measured moves the model of a fit, and of a simulation, as the same wind stated in the file does."""

from dataclasses import replace as changed

import numpy as np
import polars as pl
import pytest
from msgspec.structs import replace

from companion.logs.runs.run import Run
from sim.fitting.engine.free_parameters import SURROUNDINGS
from sim.fitting.engine.initial_guess import initial_nodes
from sim.fitting.engine.model import compile_model
from sim.fitting.engine.motion import WindowIntegrator
from sim.fitting.engine.parameters import Parameters, file_values
from sim.fitting.engine.smoothing import SmootherNoise
from sim.fitting.engine.wind import NEAR_S, measured_wind
from sim.fitting.engine.windows import cut_windows
from sim.fitting.identify.structured_fit import UNMEASURED, StructuredFit
from sim.fitting.validate.models import VesselSimulator
from sim.fitting.validate.windows import concatenated, cut_held_out, reference_motion
from sim.world.teleop_log import teleop_run
from tests.sim.fitting.windy import windy_log
from tests.support.vessel_fixtures import boat

FILE = boat("aritra")


def stating(speed_m_s: float, from_deg: float):
    wind = {"V_w_m_s": speed_m_s, "beta_w_deg": from_deg, "source": "test"}
    return replace(FILE, terms={"wind": wind})


def moved(vessel, run: Run, q: np.ndarray | None = None, surroundings: bool = False) -> np.ndarray:
    """States of all windows, by the file's numbers."""
    windows, parameters = cut_windows([run], vessel, 5.0), Parameters(vessel, surroundings=surroundings)
    W, K = windows.size
    move = WindowIntegrator(windows, parameters, compile_model(vessel, K, W, surroundings))
    q = file_values(vessel, surroundings) if q is None else q
    return move(q, initial_nodes(windows, parameters)).x


@pytest.fixture(scope="module")
def log() -> Run:
    return teleop_run(FILE, 3, 40.0, uwb_hz=2.0)


def test_what_is_measured_is_what_a_file_may_state(log):
    """From 40 degrees, and no wind at all: the windows are moved otherwise."""
    stated = moved(stating(4.0, 40.0), log)
    assert moved(stating(9.0, 200.0), windy_log(log, 4.0, 40.0)) == pytest.approx(stated, abs=1e-9)
    assert np.abs(moved(stating(0.0, 0.0), log) - stated).max() > 0.1


def test_it_stands_above_the_wind_that_is_fitted_with_the_surroundings(log):
    q = file_values(FILE, surroundings=True)
    names = Parameters(FILE, surroundings=True).names
    at = [names.index(p.name) for term, p in SURROUNDINGS if term == "wind"]
    q[at] = 4.0 * np.cos(np.radians(40.0)), 4.0 * np.sin(np.radians(40.0))
    fitted = moved(FILE, log, q, surroundings=True)
    q[at] = 1.0, -3.0
    assert moved(FILE, windy_log(log, 4.0, 40.0), q, surroundings=True) == pytest.approx(fitted, abs=1e-9)


def test_a_calm_that_was_measured_leaves_a_fit_its_slopes(log):
    """Wind is measured throughout, and for ten seconds there is none."""
    t_s = log.table["t_s"].to_numpy()
    calm = np.abs(t_s - t_s[0] - 20.0) < 5.0
    columns = {"V_w_m_s": pl.Series(np.where(calm, 0.0, 4.0)), "beta_w_deg": pl.Series(np.full(len(t_s), 40.0))}
    fit = StructuredFit([Run(log.table.with_columns(**columns), log.meta)], FILE, UNMEASURED)
    point = fit.begin()
    assert (np.hypot(*fit.windows.wind_m_s.T) == 0.0).any()
    assert np.isfinite(point.at.chain.D).all() and fit.step(point)[0] is not point
    assert not fit.parameters.prior[1][fit.parameters.names.index("wind_north_m_s")] > 1e-6  # nothing of it is fitted


def test_the_mean_of_a_window_is_by_time_whatever_other_logs_are_beside(log):
    """A wind that grows by 0.1 m/s each second, beside a log of three times the rate: middle of each window."""
    t_s = log.table["t_s"].to_numpy()
    columns = {"V_w_m_s": pl.Series(1.0 + 0.1 * (t_s - t_s[0])), "beta_w_deg": pl.Series(np.zeros(len(t_s)))}
    growing = Run(log.table.with_columns(**columns), log.meta)
    beside = teleop_run(FILE, 4, 40.0, imu_hz=100.0)
    windows = cut_windows([growing, beside], FILE, 5.0)
    own = windows.run == 0
    middle_s = windows.t_s[own][:, [0, -1]].mean(axis=1) - t_s[0]
    assert windows.wind_m_s[own][:, 0] == pytest.approx(1.0 + 0.1 * middle_s, abs=0.01)
    assert np.isnan(windows.wind_m_s[~own]).all()


def test_a_speed_without_a_direction_is_none(log):
    half = Run(log.table.with_columns(V_w_m_s=pl.lit(3.0)), log.meta)
    assert (moved(stating(4.0, 40.0), half) == moved(stating(4.0, 40.0), log)).all()


def test_a_boat_without_wind_in_its_file_is_moved_by_none(log):
    assert (moved(FILE, windy_log(log, 4.0, 40.0)) == moved(FILE, log)).all()


def test_simulations_of_held_out_windows_have_it_too(log):
    """One log with measured wind beside one without, each in 40 s of windows."""
    own = stating(2.0, 300.0)
    reference = reference_motion(log, SmootherNoise.of(FILE))
    pieces = [cut_held_out(run, reference, 14.8, horizon_s=15.0) for run in (windy_log(log, 4.0, 40.0), log)]
    both, m = concatenated(pieces), len(pieces[0].x0)
    got = VesselSimulator("measured", own).simulate(both.x0, both.commands)
    for vessel, part, piece in ((stating(4.0, 40.0), got[:m], pieces[0]), (own, got[m:], pieces[1])):
        expected = VesselSimulator("stated", vessel).simulate(piece.x0, changed(piece.commands, wind_m_s=None))
        assert part == pytest.approx(expected, abs=1e-9)
    still = VesselSimulator("no wind", FILE).simulate(both.x0, both.commands)
    assert np.abs(still[:m] - got[:m]).max() > 0.1


def test_between_samples_and_for_a_while_after_the_last_it_is_known(log):
    """One sample from the west, 2 m/s, at the beginning, and one from the north in the end."""
    n, t_s = log.table.height, log.table["t_s"].to_numpy()
    speed, angle = np.full(n, np.nan), np.full(n, np.nan)
    speed[[0, -1]], angle[[0, -1]] = 2.0, (-90.0, 0.0)
    columns = {"V_w_m_s": pl.Series(speed), "beta_w_deg": pl.Series(angle)}
    run = Run(log.table.with_columns(**columns).fill_nan(None), log.meta)
    ends = t_s[[0, -1]]
    wind = measured_wind(run, np.array([ends[0], ends.mean(), ends[1] + 0.9 * NEAR_S, ends[1] + 1.1 * NEAR_S]))
    assert wind[:3] == pytest.approx(np.array([(0.0, -2.0), (1.0, -1.0), (2.0, 0.0)]), abs=1e-9)
    assert np.isnan(wind[3]).all()
