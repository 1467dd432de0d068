"""Copies of parts are found whatever their clock; two missions along the same lines, and boats at rest, are not."""

import numpy as np
import polars as pl
import pytest

from companion.logs.runs.fingerprint import MOST, fingerprint, overlap
from companion.logs.runs.run import Run

CORNERS = np.array([[0, 0], [10, 0], [10, 10], [0, 10], [0, 0]])


def at(places: np.ndarray, step_m: float, first: int = 0, last: int | None = None) -> Run:
    """Positions (n, 2), told in steps of `step_m`, with a row without any after each; the clock begins at 0."""
    told = np.round(places / step_m)[first:last] * step_m
    t = np.arange(2.0 * len(told)) / 10
    north, east = (np.column_stack([column, np.full(len(told), np.nan)]).ravel() for column in told.T)
    zero = dict.fromkeys(("pwm_a", "battery_v", "psi_rad", "r_rad_s", "ax_m_s2", "ay_m_s2"), 0 * t)
    table = {"t_s": t} | zero | {"pwm_a": 1500 + 0 * t, "north_m": north, "east_m": east}
    return Run(pl.DataFrame(table).fill_nan(None))


def square(seed: int, count: int = 3000) -> np.ndarray:
    """A square of 10 m at 0.5 m/s and 5 Hz, over and over, 3 cm beside its sides."""
    rng = np.random.default_rng(seed)
    along = (0.1 * np.arange(count) + rng.uniform()) % 40
    line = np.column_stack([np.interp(along, [0, 10, 20, 30, 40], side) for side in CORNERS.T])
    return line + 0.03 * rng.normal(size=line.shape)


def same(one: Run, other: Run) -> bool:
    return overlap(fingerprint(one), fingerprint(other))


@pytest.mark.parametrize("step_m", [1e-9, 0.01, 0.1])
def test_a_part_is_found_and_another_mission_on_the_same_lines_is_none(step_m):
    whole, other = at(square(1), step_m), at(square(2), step_m)
    assert len(fingerprint(whole)) == MOST
    assert same(whole, at(square(1), step_m, 1000, 1200)) and same(at(square(1), step_m, 100, 130), whole)
    assert not same(whole, other) and not same(whole, at(square(2), step_m, 0, 100))


def test_what_overlaps_by_a_fifth_is_one_recording():
    places = square(1)
    assert same(at(places, 0.01, 0, 1000), at(places, 0.01, 800, 1800))
    assert not same(at(places, 0.01, 0, 1000), at(places, 0.01, 990, 2000))


@pytest.mark.parametrize("noise_m", [0.0, 0.002, 0.006])
def test_boats_at_rest_are_not_taken_for_each_other(noise_m):
    """Told in steps of a centimetre: always one place, or a few in turn."""
    one, other = (at(noise_m * np.random.default_rng(seed).normal(size=(500, 2)), 0.01) for seed in (1, 2))
    assert not same(one, other)
    assert not same(at(square(1), 0.01, 0, 5), at(square(1), 0.01, 0, 5)), "too few"
