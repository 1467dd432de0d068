"""The structured fit on simulated logs: estimates, intervals, and the identified vessel file."""

from functools import partial

import numpy as np
import polars as pl
import pytest
from msgspec.structs import replace

from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.load_vessel import load_vessel
from companion.core.model.manoeuvring import mass_matrix
from companion.core.model.vessel_text import vessel_toml
from companion.logs.runs.run import Run
from sim.fitting.engine.free_parameters import PriorSigmas
from sim.fitting.engine.noise import noise_of
from sim.fitting.engine.parameters import HULL, file_values
from sim.fitting.identify.result import FitResult, fit_structured
from sim.fitting.identify.structured_fit import UNMEASURED, FitSettings, StructuredFit
from sim.fitting.identify.vessel_out import identified_vessel
from sim.studies.boats.campaign import figures, is_stable, one_boat
from sim.studies.boats.draw import draw_boat, in_still_air
from sim.world.teleop_log import BASIN_M, Habits, KeyboardPilot, teleop_run
from tests.support.vessel_fixtures import boat

TRUE = draw_boat(boat("aritra"), np.random.default_rng(11))
PRIOR = in_still_air(boat("aritra"))


@pytest.fixture(scope="module")
def run() -> Run:
    return teleop_run(TRUE, 11, 120.0)


@pytest.fixture(scope="module")
def result(run: Run) -> FitResult:
    return fit_structured([run], PRIOR)


def test_the_pilot_excites_all_axes_inside_the_basin_and_repeats_himself(run: Run) -> None:
    t, truth = run.samples("true_north_m", "true_east_m", "true_u_m_s", "true_v_m_s", "true_r_rad_s")
    assert truth[:, :2].min() > 0.5 and truth[:, :2].max() < BASIN_M - 0.5
    assert (truth[:, 2:].max(axis=0) > (0.3, 0.15, 0.3)).all() and (
        truth[:, 2:].min(axis=0) < (-0.3, -0.15, -0.3)
    ).all()
    assert len(t) == 3600
    assert teleop_run(TRUE, 11, 5.0).data_hash == teleop_run(TRUE, 11, 5.0).data_hash
    assert teleop_run(TRUE, 12, 5.0).data_hash != teleop_run(TRUE, 11, 5.0).data_hash


def test_two_minutes_find_the_boat(result: FitResult) -> None:
    truth = dict(zip([p.name for p in result.parameters], file_values(TRUE), strict=True))
    strong = [n for n in HULL if n not in ("Y_r_N_s", "N_v_N_s", "M23_kg_m", "X_u_N_s_m")]
    errors = [abs(result[n].value / truth[n] - 1) for n in strong]
    assert np.median(errors) < 0.03 and max(errors) < 0.08
    far = [
        p.name for p in result.parameters if abs(p.value - truth[p.name]) > 4 * p.se and not p.name.startswith("warp")
    ]
    assert not far
    assert all(0.9 < c.rms < 1.1 and abs(c.lag1) < 0.35 for c in result.channels)


def test_the_noise_of_a_mean_is_that_of_its_own_channel(run: Run) -> None:
    """30 samples of heading a second become ten, ten of the IMU stay as they are."""
    kept = run.samples("r_rad_s")[0][::3]
    slow = [pl.when(pl.col("t_s").is_in(kept)).then(pl.col(c)).alias(c) for c in ("r_rad_s", "ax_m_s2", "ay_m_s2")]
    mixed = StructuredFit([Run(run.table.with_columns(slow), run.meta)], PRIOR, FitSettings(window_s=2.0)).stated
    single = noise_of(PRIOR)
    assert mixed.white[0] == pytest.approx(single.white[0] / np.sqrt(3.0), rel=0.01)
    assert mixed.white[1:] == single.white[1:]


@pytest.mark.long
def test_means_of_three_samples_say_as_much_as_the_samples(run: Run, result: FitResult) -> None:
    sigmas = {hz: StructuredFit([run], PRIOR, FitSettings(inertial_hz=hz)).noise.white[0] for hz in (10.0, np.inf)}
    assert sigmas[np.inf] == noise_of(PRIOR).white[0] and sigmas[10.0] == pytest.approx(
        sigmas[np.inf] / 3**0.5, rel=0.01
    )
    whole = fit_structured([run], PRIOR, FitSettings(inertial_hz=np.inf))
    assert whole.samples > 2.9 * result.samples
    for mean, each in zip(result.parameters, whole.parameters, strict=True):
        lost = np.sqrt(abs(mean.se**2 - each.se**2))  # dead time and lag are told by what happens within a mean
        assert abs(mean.value - each.value) < 0.2 * each.se + 2 * lost, mean.name
        assert 0.95 < mean.se / each.se < 1.2, mean.name


def test_the_common_scale_of_force_and_inertia_is_named_as_undetermined(result: FitResult) -> None:
    widest = result.directions[0]
    assert widest.share_of_prior > 0.9
    shared = {n: part for n, part in widest.parts.items() if not n.startswith("warp")}
    assert {"M11_kg", "M22_kg", "X_uu_N_s2_m2", "gain_front_port", "gain_rear_starboard"} <= set(shared)
    assert np.allclose(list(shared.values()), 1.0, atol=0.1)


@pytest.mark.long
def test_two_logs_say_more_than_one(run: Run, result: FitResult) -> None:
    both = fit_structured([run, teleop_run(TRUE, 12, 120.0)], PRIOR)
    assert both.samples > 1.9 * result.samples
    assert both["Y_r_N_s"].se < 0.85 * result["Y_r_N_s"].se
    assert len(both.data_hashes) == 2


def test_a_sensor_that_is_off_does_not_bend_the_hull(run: Run, result: FitResult) -> None:
    """Accelerometer bias, heading offset: nuisances take them."""
    table = run.table.with_columns(run.table["ax_m_s2"] + 0.08, run.table["psi_rad"] * 1.0)
    moved = fit_structured([Run(table, run.meta)], PRIOR)
    for name in ("M11_kg", "M22_kg", "X_uu_N_s2_m2", "N_rr_N_m_s2"):
        assert moved[name].value == pytest.approx(result[name].value, abs=0.5 * result[name].se), name


def test_outliers_among_the_positions_are_outvoted(run: Run, result: FitResult) -> None:
    north = run.table["north_m"].to_numpy().copy()
    known = np.flatnonzero(np.isfinite(north))
    north[known[::15]] += 3.0
    broken = Run(run.table.with_columns(north_m=north).with_columns(north_m=_blank(north)), run.meta)
    found = fit_structured([broken], PRIOR)
    for name in ("M11_kg", "M22_kg", "X_uu_N_s2_m2", "Y_vv_N_s2_m2"):
        assert found[name].value == pytest.approx(result[name].value, abs=1.5 * result[name].se), name


def _blank(values: np.ndarray):
    import polars as pl

    return pl.Series(values, nan_to_null=True)


@pytest.mark.long
def test_a_disturbance_widens_the_intervals(result: FitResult) -> None:
    """Gusts and waves that the model does not know become latent acceleration, not false certainty."""
    from sim.world.environment import Weather

    rough = teleop_run(TRUE, 11, 120.0, weather=Weather(V_w_m_s=2.0, beta_w_deg=40.0, gustiness=0.5))
    found = fit_structured([rough], PRIOR)
    assert found.converged and max(found.latent_share) > 5 * max(result.latent_share)
    assert found["Y_v_N_s_m"].se > 1.5 * result["Y_v_N_s_m"].se
    far = [p.name for p, t in zip(found.parameters, file_values(TRUE), strict=True) if abs(p.value - t) > 4 * p.se]
    assert not far


@pytest.mark.long
def test_waves_within_a_window_make_it_shorter() -> None:
    """Two-second waves are not constant over two seconds: the fit sees it in its residuals and looks closer."""
    from sim.world.environment import Weather

    found = fit_structured([teleop_run(TRUE, 11, 60.0, weather=Weather(H_s_m=0.03))], PRIOR)
    assert found.window_s == 0.5 and found.white


def test_what_is_fixed_stays(run: Run) -> None:
    settings = FitSettings(overrides={"dead_time_s": (0.12, 0.0)}, latent=False, iterations=6)
    assert fit_structured([run], PRIOR, settings)["dead_time_s"].value == pytest.approx(0.12, rel=1e-3)


def test_the_vessel_file_loads_as_it_is_and_moves_as_the_fit_says(result: FitResult) -> None:
    vessel = identified_vessel(PRIOR, result, date="2026-01-01")
    again = load_vessel(vessel_toml(vessel, "made by a test"), name="identified.toml")
    assert again == vessel and is_stable(again)
    assert "identified 2026-01-01" in again.damping.source and result.data_hashes[0][:12] in again.inertia.source
    M = mass_matrix(again)
    fitted = [result[n].value for n in ("M11_kg", "M22_kg", "M33_kg_m2", "M23_kg_m")]
    np.testing.assert_allclose(M[[0, 1, 2, 1], [0, 1, 2, 2]], fitted, rtol=1e-4)


def test_a_boat_lighter_than_its_file_keeps_added_mass_of_the_right_sign(result: FitResult) -> None:
    heavy = replace(PRIOR, inertia=replace(PRIOR.inertia, mass_kg=90.0, I_z_kg_m2=40.0, y_g_m=0.01))
    vessel = identified_vessel(heavy, result, date="2026-01-01")
    assert vessel.inertia.X_udot_kg <= 0 and vessel.inertia.Y_vdot_kg <= 0 and vessel.inertia.N_rdot_kg_m2 <= 0
    assert "mass or I_z lowered" in vessel.inertia.source
    M = mass_matrix(vessel)
    np.testing.assert_allclose(M[0, 0], result["M11_kg"].value, rtol=1e-4)
    np.testing.assert_allclose(M[0, 2], mass_matrix(heavy)[0, 2], rtol=1e-5)


@pytest.mark.long
def test_force_in_newtons_is_known_no_better_than_the_thrusters(run: Run, result: FitResult) -> None:
    """The data fix ratios; the scale is as wide as the prior of the gains says: twice that, twice the interval."""
    wider = fit_structured([run], PRIOR, FitSettings(sigmas=PriorSigmas(gain=0.05)))
    for name in ("M11_kg", "M33_kg_m2", "N_rr_N_m_s2"):
        assert wider[name].se == pytest.approx(2 * result[name].se, rel=0.2), name
    assert result["M33_kg_m2"].se / result["M33_kg_m2"].value == pytest.approx(0.0125, rel=0.1)  # 2.5 % / sqrt(4)


@pytest.mark.long
def test_intervals_cover_and_models_are_stable() -> None:
    found = figures([one_boat(boat("aritra"), seed, 1.0, 0.10, train_s=300.0)[0] for seed in range(40, 44)])
    assert found.unstable == 0
    assert found.median_error < 0.03
    assert found.scale_free_coverage > 0.85
    assert found.open_loop_ratio < 1.5


def test_a_short_log_in_which_nothing_moves_says_nothing_of_the_compass() -> None:
    """A compass that is 0.1 rad off; two minutes of driving, and three logs of 13 s almost at rest; seeds 11 to 14."""
    imu = replace(TRUE.sensors.imu, heading_offset_rad=0.1)
    off = replace(TRUE, sensors=replace(TRUE.sensors, imu=imu))
    at_rest = partial(KeyboardPilot, habits=Habits(most=(0.5, 0.5, 0.2), home_n=0.5))
    logs = [teleop_run(off, 11, 120.0), *(teleop_run(off, seed, 13.0, pilot=at_rest) for seed in (12, 13, 14))]
    assert fit_structured(logs, PRIOR, UNMEASURED).heading_offset_rad == pytest.approx(0.1, abs=0.02)


def test_the_compass_of_an_unmeasured_boat_is_found_beyond_what_its_file_states() -> None:
    """0.09 cos psi - 0.04 sin psi, of which the file states a part; two minutes of driving, seed 15."""

    def turning(vessel: VesselFile, cos: float, sin: float) -> VesselFile:
        imu = replace(vessel.sensors.imu, hard_iron_cos_rad=cos, hard_iron_sin_rad=sin)
        return replace(vessel, sensors=replace(vessel.sensors, imu=imu))

    first = turning(PRIOR, 0.03, 0.01)
    found = fit_structured([teleop_run(turning(TRUE, 0.09, -0.04), 15, 120.0)], first, UNMEASURED)
    written = load_vessel(vessel_toml(identified_vessel(first, found, date="2026-01-01")), name="written").sensors.imu
    assert (written.hard_iron_cos_rad, written.hard_iron_sin_rad) == pytest.approx((0.09, -0.04), abs=0.015)


def test_thrust_that_is_lost_to_the_boats_speed_is_found_and_not_taken_for_hull() -> None:
    """A quarter per m/s, of which the file states a tenth; without it surge damping came out 2.3 times as large."""
    aritra = boat("aritra")

    def losing(loss_s_m: float):
        return replace(aritra, propulsion=replace(aritra.propulsion, advance_loss_s_m=loss_s_m))

    log = teleop_run(losing(0.25), 1, 90.0)
    found, blind = fit_structured([log], losing(0.1)), fit_structured([log], aritra)
    assert found["advance_loss_s_m"].value == pytest.approx(0.25, abs=0.01)
    assert found["X_u_N_s_m"].value == pytest.approx(-3.5, rel=0.15)
    assert blind["X_u_N_s_m"].value < -6.0
    written = load_vessel(vessel_toml(identified_vessel(losing(0.1), found, date="2026-01-01")), name="written")
    assert written.propulsion.advance_loss_s_m == pytest.approx(0.25, abs=0.01)
    assert identified_vessel(aritra, blind, date="2026-01-01").propulsion.advance_loss_s_m == 0.0
