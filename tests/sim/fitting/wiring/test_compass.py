"""Compass against course: made-up tracks whose heading errs as hard iron makes it, and right ones."""

from __future__ import annotations

import re

import numpy as np
import polars as pl
import pytest
from msgspec.structs import replace

from companion.logs.runs.run import Run, RunMeta
from sim.fitting.wiring.compass import compass_finding, hard_iron
from tests.support.vessel_fixtures import boat

BOAT = boat("twin")


def track(
    seed: int, error=lambda psi: 0.0 * psi, *, seconds: float = 300.0, speed: float = 1.0, fixes_hz: float = 2.0
) -> Run:
    """A boat that turns to and fro, ahead and astern, in a current of 0.1 m/s, with a lively sway of 3 cm/s.

    At one speed a current looks as hard iron does.
    """
    rng = np.random.default_rng(seed)
    dt = 0.1
    t = np.arange(0.0, seconds, dt)
    r = np.repeat(rng.normal(0.0, 0.25, len(t) // 50 + 1), 50)[: len(t)]
    psi = rng.uniform(-np.pi, np.pi) + np.cumsum(r) * dt
    u = speed * (0.4 + np.sin(2 * np.pi * t / 40.0))
    sway = np.zeros_like(t)
    for k in range(1, len(t)):
        sway[k] = 0.95 * sway[k - 1] + 0.03 * np.sqrt(1 - 0.95**2) * rng.normal()
    toward = rng.uniform(0, 2 * np.pi)
    north = np.cumsum(u * np.cos(psi) - sway * np.sin(psi) + 0.1 * np.cos(toward)) * dt
    east = np.cumsum(u * np.sin(psi) + sway * np.cos(psi) + 0.1 * np.sin(toward)) * dt
    measured = psi + error(psi) + rng.normal(0.0, 0.005, len(t))
    fix = np.arange(len(t)) % round(1 / (fixes_hz * dt)) == 0
    place = [pl.Series(np.where(fix, x + rng.normal(0.0, 0.03, len(t)), np.nan)).fill_nan(None) for x in (north, east)]
    blank = dict.fromkeys(("battery_v", "r_rad_s", "ax_m_s2", "ay_m_s2"), pl.lit(None, pl.Float64))
    table = pl.DataFrame({"t_s": t, "psi_rad": (measured + np.pi) % (2 * np.pi) - np.pi}).with_columns(
        north_m=place[0], east_m=place[1], pwm_port=pl.lit(1500.0), pwm_starboard=pl.lit(1500.0), **blank
    )
    return Run(table, RunMeta(source=f"track {seed}"))


@pytest.mark.parametrize(("a", "b"), [(0.14, 0.0), (-0.07, 0.1), (0.0, -0.12)])
def test_hard_iron_is_found_with_sign_and_size(a: float, b: float) -> None:
    runs = [track(seed, lambda psi: a * np.cos(psi) + b * np.sin(psi) + 0.03) for seed in (1, 2)]
    found = hard_iron(runs, BOAT)
    assert found is not None
    off = np.array([found.a - a, found.b - b])
    assert off @ np.linalg.solve(found.covariance, off) < 9.2  # 99 % of two numbers
    assert np.abs(off).max() < 0.04
    (finding,) = compass_finding({"one": runs[0], "two": runs[1]}, BOAT)
    assert finding.name == "compass:hard_iron"
    assert not finding.certain


def test_a_right_compass_is_not_accused() -> None:
    """Forty tracks of 60 to 300 s, each alone: 6 nats by chance are one in 400."""
    accused = [s for s in range(40) if compass_finding({"log": track(100 + s, seconds=60.0 + 6 * s)}, BOAT)]
    assert not accused


def test_an_error_of_half_the_worst_is_within_its_interval() -> None:
    inside = 0
    for seed in range(20):
        found = hard_iron([track(200 + seed, lambda psi: 0.05 * np.cos(psi))], BOAT)
        assert found is not None
        inside += abs(found.a - 0.05) < 2 * np.sqrt(found.covariance[0, 0])
    assert inside >= 18


def test_a_boat_that_hardly_moves_says_nothing() -> None:
    assert hard_iron([track(3, lambda psi: 0.14 * np.cos(psi), speed=0.2)], BOAT) is None


def test_what_the_file_states_already_is_not_told_again() -> None:
    imu = replace(BOAT.sensors.imu, hard_iron_cos_rad=0.14)
    stated = replace(BOAT, sensors=replace(BOAT.sensors, imu=imu))
    run = track(1, lambda psi: 0.14 * np.cos(psi))
    assert not compass_finding({"log": run}, stated)
    more = track(2, lambda psi: 0.14 * np.cos(psi) - 0.14 * np.sin(psi))
    (finding,) = compass_finding({"log": more}, stated)
    cos, sin = (float(x) for x in re.findall(r"rad = (-?[0-9.]+)", finding.advice))
    assert (cos, sin) == pytest.approx((0.14, -0.14), abs=0.05)


def test_a_log_of_an_instant_says_nothing() -> None:
    short = track(5, seconds=0.4, fixes_hz=10.0)
    assert hard_iron([short], BOAT) is None
    assert compass_finding({"long": track(6), "short": short}, BOAT) == []
