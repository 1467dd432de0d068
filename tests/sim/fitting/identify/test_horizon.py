"""Multi-step output error on logs of poses alone: a boat with blades off neutral, turned units and a bent pitch curve.

Made with another integrator than the fit's (`VesselSimulator`, thruster lag as a state), noise of a motion capture.
"""

import numpy as np
import polars as pl
import pytest
from msgspec.structs import replace

from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.load_vessel import load_vessel
from companion.core.model.vessel_text import vessel_toml
from companion.logs.runs.run import Run, RunMeta
from sim.fitting.engine.parameters import Parameters, file_values
from sim.fitting.engine.windows import StructuredFitError
from sim.fitting.identify.horizon import HorizonFit, horizon_target, with_tag_fixed
from sim.fitting.identify.result import FitResult, fit_structured
from sim.fitting.identify.structured_fit import FitSettings
from sim.fitting.identify.vessel_out import identified_vessel
from sim.fitting.validate.models import VesselSimulator
from sim.fitting.validate.protocol import STEP_S, Commands
from sim.world.teleop_log import teleop_run
from tests.support.vessel_fixtures import boat

FILE = boat("cse1")
TRIMS = {"port_surge": -30, "port_sway": 10, "starboard_surge": 20, "starboard_sway": -15}
TURNED = {"port_surge": -8.0, "port_sway": 82.0, "starboard_surge": 25.0, "starboard_sway": 115.0}
GAINS = {"port_surge": 1.5, "port_sway": 0.9, "starboard_surge": 1.2, "starboard_sway": 1.1, "bow": 3.0}
CURVE, N_UR = 0.5, -1.5
SIGMA_M, SIGMA_RAD = 0.001, 0.002


def true_boat() -> VesselFile:
    thrusters = tuple(
        replace(t, gain=GAINS[t.name], trim_us=TRIMS.get(t.name, 0), azimuth_deg=TURNED.get(t.name, t.azimuth_deg))
        for t in FILE.thrusters
    )
    maps = FILE.force_maps | {"voith_schneider": replace(FILE.force_maps["voith_schneider"], curve=CURVE)}
    terms = {"speed_damping": {"N_ur_N_s2": N_UR, "source": "test"}}
    return replace(FILE, thrusters=thrusters, force_maps=maps, terms=terms)


def sailed(vessel: VesselFile, seed: int, seconds: float) -> Run:
    """Joystick: a push of each thruster now and then; the propellers' setting changes twice."""
    rng = np.random.default_rng(seed)
    k, n = round(seconds / STEP_S), len(vessel.thrusters)
    held = np.repeat(rng.uniform(-0.8, 0.8, (k // 60 + 1, n)) * (rng.random((k // 60 + 1, n)) < 0.5), 60, axis=0)[:k]
    pwm = 1500.0 + 400.0 * held
    setting = np.where(np.arange(k) < k / 3, 0.4, np.where(np.arange(k) < 2 * k / 3, 0.5, 0.3))
    commands = Commands(pwm[None], np.full((1, k), 12.0), pwm[None, :40], {"vsp_speed": setting[None]})
    x = VesselSimulator("true", vessel).simulate(np.zeros((1, 6)), commands)[0, :k]
    blank = pl.Series([None] * k, dtype=pl.Float64)
    noise = rng.normal(size=(k, 3)) * (SIGMA_M, SIGMA_M, SIGMA_RAD)
    psi = (x[:, 2] + noise[:, 2] + np.pi) % (2 * np.pi) - np.pi
    columns = {"t_s": STEP_S * np.arange(k)} | {f"pwm_{t.name}": pwm[:, i] for i, t in enumerate(vessel.thrusters)}
    columns |= dict.fromkeys(("battery_v", "r_rad_s", "ax_m_s2", "ay_m_s2"), blank)
    columns |= {"psi_rad": psi, "north_m": x[:, 0] + noise[:, 0], "east_m": x[:, 1] + noise[:, 1]}
    return Run(pl.DataFrame({**columns, "setting_vsp_speed": setting}), RunMeta(source=f"sailed {seed}"))


@pytest.fixture(scope="module")
def run() -> Run:
    return sailed(true_boat(), 1, 300.0)


@pytest.fixture(scope="module")
def result(run: Run) -> FitResult:
    return fit_structured([run], FILE)


def test_poses_alone_are_fitted_over_many_seconds_and_converge(result: FitResult) -> None:
    assert result.horizon_s > 0 and result.converged and result.iterations < 20
    inertial = teleop_run(boat("aritra"), 1, 30.0)
    assert fit_structured([inertial], boat("aritra"), FitSettings(iterations=1)).horizon_s == 0


def test_trims_azimuths_curve_and_speed_damping_come_back(result: FitResult) -> None:
    """Forces are known but for a common scale, so gains only relative to their mean."""
    for name, trim in TRIMS.items():
        assert result[f"trim_{name}_us"].value == pytest.approx(trim, abs=8), name
    for name, azimuth in TURNED.items():
        assert result[f"azimuth_{name}_deg"].value == pytest.approx(azimuth, abs=3), name
    assert result["curve_voith_schneider"].value == pytest.approx(CURVE, abs=0.06)
    found = np.array([result[f"gain_{name}"].value for name in GAINS])
    np.testing.assert_allclose(
        found / found.mean(), np.array(list(GAINS.values())) / np.mean(list(GAINS.values())), rtol=0.08
    )
    assert result["N_ur_N_s2"].value / result["M33_kg_m2"].value == pytest.approx(N_UR / file_values(FILE)[2], rel=0.35)


def test_a_setting_that_the_log_does_not_state_bends_the_gains(run: Run, result: FitResult) -> None:
    blind = fit_structured([Run(run.table.drop("setting_vsp_speed"), run.meta)], FILE)
    spread = [f.channels[0].sigma for f in (result, blind)]
    assert spread[1] > 3 * spread[0]


def test_the_identified_file_predicts_another_log_of_the_day(result: FitResult) -> None:
    """Within a few centimetres over 10 s with the day's trims; without them the boat drifts off its prediction."""
    far = {}
    for session in (True, False):
        vessel = identified_vessel(FILE, result, date="2026-01-01", session=session)
        assert load_vessel(vessel_toml(vessel), name="identified.toml") == vessel
        rng = np.random.default_rng(2)
        pwm = 1500.0 + 400.0 * np.repeat(rng.uniform(-0.6, 0.6, (20, 4, 5)), 50, axis=1)
        commands = Commands(pwm, np.full((20, 200), 12.0), pwm[:, :40])
        ends = [VesselSimulator("m", v).simulate(np.zeros((20, 6)), commands)[:, -1, :2] for v in (vessel, true_boat())]
        far[session] = float(np.sqrt(((ends[0] - ends[1]) ** 2).sum(axis=1).mean()))
    assert far[True] < 0.1 and far[False] > 1.5 * far[True]


def test_scores_are_the_derivative_of_the_cost(run: Run) -> None:
    parameters = with_tag_fixed(Parameters(FILE))
    fit = HorizonFit(horizon_target([Run(run.table[:1200], run.meta)], FILE), parameters)
    mean, spread = parameters.prior
    w = mean + 0.1 * spread * np.sin(np.arange(len(mean)))
    here = fit.point(w)
    gradient = here.scores.sum(axis=0) + (w - mean) / spread**2
    for i in np.flatnonzero(spread > 1e-3):
        h = 0.02 * spread[i] * (np.arange(len(w)) == i)
        numeric = (fit.point(w + h).cost - fit.point(w - h).cost) / 2
        size = np.sqrt(h @ here.H @ h)  # forces jump within steps of 0.1 s: what dead time does is not smooth
        assert numeric == pytest.approx(gradient @ h, rel=0.03, abs=0.03 * size), parameters.names[i]


def test_a_model_that_runs_away_is_no_step_forward_and_no_start(run: Run) -> None:
    """Windows that are not finite once counted as unknown, which made a runaway the best of all models."""
    wild = replace(FILE, terms={"speed_damping": {"N_ur_N_s2": -900.0, "source": "test"}})
    with pytest.raises(StructuredFitError, match=f"{FILE.name}: .* runs away within a window; look at its damping"):
        fit_structured([run], wild)
    fit = HorizonFit(horizon_target([run], wild), with_tag_fixed(Parameters(wild)))
    assert fit.point(fit.parameters.prior[0]).cost == np.inf
