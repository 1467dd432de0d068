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


def test_between_samples_it_is_known_for_a_while(log):
    """One sample from the west, 2 m/s, and later one from the north."""
    n = log.table.height
    t_s = log.table["t_s"].to_numpy()
    speed, angle = np.full(n, np.nan), np.full(n, np.nan)
    late = int(np.searchsorted(t_s, t_s[0] + 4 * NEAR_S))
    speed[[0, late]], angle[[0, late]] = 2.0, (-90.0, 0.0)
    columns = {"V_w_m_s": pl.Series(speed), "beta_w_deg": pl.Series(angle)}
    run = Run(log.table.with_columns(**columns).fill_nan(None), log.meta)
    wind = measured_wind(run, t_s[0] + np.array([0.0, 0.9 * NEAR_S, 1.1 * NEAR_S, 4 * NEAR_S]))
    assert wind[0] == pytest.approx((0.0, -2.0), abs=1e-9)
    assert np.isfinite(wind).all(axis=1).tolist() == [True, True, False, True]
    assert wind[3] == pytest.approx((2.0, 0.0), abs=1e-9)
