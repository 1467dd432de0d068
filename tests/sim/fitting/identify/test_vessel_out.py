"""Fitted values as a vessel file: within its bounds, and told where that changes them."""

import numpy as np
import pytest
from msgspec.structs import replace

from companion.core.model.load_vessel import load_vessel
from companion.core.model.vessel_text import vessel_toml
from sim.fitting.engine.parameters import Parameters, file_values
from sim.fitting.identify.refinements import REFINEMENTS
from sim.fitting.identify.result import Estimate, FitResult
from sim.fitting.identify.vessel_out import identified_vessel, not_written, written_otherwise
from tests.support.vessel_fixtures import boat

VESSEL = next(r for r in REFINEMENTS if r.name == "speed_damping").applied(boat("aritra"))


def fitted(heading_offset_rad: float = 0.0, **values: float) -> FitResult:
    """A fit that found the file's own numbers, but `values`."""
    found = dict(zip(Parameters(VESSEL).names, file_values(VESSEL), strict=True)) | values
    estimates = tuple(
        Estimate(name=n, value=float(v), se=0.1, ci95=(v, v), unit="1", share_of_prior=0.1, determined=True)
        for n, v in found.items()
    )
    return FitResult(
        parameters=estimates, covariance=(), directions=(), latent=(0, 0, 0), latent_share=(0, 0, 0), window_s=2.0,
        channels=(), white=True, samples=100, fixes=10, iterations=5, converged=True, seconds=1.0, data_hashes=("a",),
        vessel="x", heading_offset_rad=heading_offset_rad,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("name", "value", "written", "told"),
    [
        ("uwb_latency_s", 1.05, 1.0, "fitted as 1.05, which no vessel file may hold, written as 1:"),
        ("uwb_latency_s", -0.02, 0.0, "positions would be ahead of the other sensors"),
        ("lag_s", 6.0, 5.0, "fitted as 6,"),
        ("dead_time_s", 2.5, 2.0, "written as 2:"),
        ("N_ur_N_s2", -1e4, -1000.0, "fitted as -1e+04,"),
        ("gain_rear_port", 12.0, 10.0, "written as 10:"),
        ("lag_s", 0.3, 0.3, ""),
    ],
)
def test_what_no_vessel_file_may_hold_is_written_within_its_bounds_and_told(name, value, written, told):
    """The file loads; before, the whole run was lost after the fit."""
    result = fitted(**{name: value})
    found = load_vessel(vessel_toml(identified_vessel(VESSEL, result, date="2026-01-01")), name="x")
    kept = {
        "uwb_latency_s": found.sensors.position.latency_s,
        "lag_s": found.propulsion.lag_s,
        "dead_time_s": found.propulsion.dead_time_s,
        "N_ur_N_s2": found.terms["speed_damping"]["N_ur_N_s2"],
        "gain_rear_port": {t.name: t.gain for t in found.thrusters}["rear_port"],
    }
    assert kept[name] == written
    lines = written_otherwise(VESSEL, result)
    assert [line.startswith(f"{name}: ") and told in line for line in lines] == [True] * bool(told)


def test_a_file_as_it_was_is_told_nothing_of():
    assert written_otherwise(VESSEL, fitted()) == []


@pytest.mark.parametrize(("off_deg", "in_file", "told"), [(0.5, 0.0, 0), (-2.9, 0.0, 1), (3.1, 3.1, 0)])
def test_a_heading_offset_that_hull_numbers_allow_for_is_in_the_file_or_told(off_deg, in_file, told):
    result = fitted(heading_offset_rad=float(np.radians(off_deg)))
    before = VESSEL.sensors.imu.heading_offset_rad
    found = identified_vessel(VESSEL, result, date="2026-01-01").sensors.imu.heading_offset_rad
    assert np.degrees(found - before) == pytest.approx(in_file, abs=0.01)
    lines = not_written(result)
    assert len(lines) == told and all("off by 2.9 degrees" in line for line in lines)


def test_a_pull_that_would_feed_energy_is_written_as_the_damping_holds_it_and_told():
    pulling = next(r for r in REFINEMENTS if r.name == "asymmetry").applied(VESSEL)
    result = fitted()
    wild = Estimate(
        name="N_uu_N_s2_m", value=-90.0, se=1.0, ci95=(-92, -88), unit="1", share_of_prior=0.1, determined=True
    )
    terms = [p for p in result.parameters if not p.name.startswith("N_uu_")]
    result = replace(result, parameters=(*terms, wild))
    written = load_vessel(vessel_toml(identified_vessel(pulling, result, date="2026-01-01")), name="x")
    assert written.terms["asymmetry"]["N_uu_N_s2_m"] == pytest.approx(-21.6, abs=0.1)
    (line,) = written_otherwise(pulling, result)
    assert line.startswith("N_uu_N_s2_m: fitted as -90 N s2/m, which would feed energy into the hull, written as -21.6")
