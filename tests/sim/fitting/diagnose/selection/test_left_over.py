"""Faults put into simulated logs are found by what they depend on."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import polars as pl
import pytest
from msgspec.structs import replace

from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.run import Run
from sim.fitting.diagnose.selection.adequacy import (
    FAR_OUT,
    OFTEN,
    adequacy,
    outlier_check,
)
from sim.fitting.diagnose.selection.greedy_selection import Selection
from sim.fitting.diagnose.selection.masking import Masking
from tests.sim.fitting.diagnose.adequacy_fixture import clean, compass_off_by_place, faulty, other


@pytest.mark.long
def test_nothing_is_left_over_of_a_boat_that_is_as_the_file_says():
    fit, model = clean()
    found = adequacy(fit, Selection(model, model, [], []), None)
    report = found.adequacy
    assert report.passed and not report.depends_on and not found.doubtful and not found.withdrawn
    assert any(c.decides for c in report.checks) and any(not c.decides for c in report.checks)


def _ageing(run: Run) -> Run:
    """The accelerometer warms up: a_x gains 0.3 m/s^2 in the middle of the log."""
    t = run.table["t_s"].to_numpy()
    bump = 0.3 * np.exp(-(((t - t.mean()) / 15.0) ** 2))
    return Run(run.table.with_columns(ax_m_s2=pl.col("ax_m_s2") + pl.Series(bump)), run.meta)


def _leaning(run: Run) -> Run:
    """The tag's place is wrong by 0.3 m to the side that the boat turns to."""
    table = run.table.with_columns(pl.col("psi_rad", "r_rad_s").interpolate().forward_fill().backward_fill())
    side = 0.6 * table["r_rad_s"].to_numpy()
    psi = table["psi_rad"].to_numpy()
    return Run(run.table.with_columns(
        north_m=pl.col("north_m") - pl.Series(side * np.sin(psi)),
        east_m=pl.col("east_m") + pl.Series(side * np.cos(psi))), run.meta)  # fmt: skip


@pytest.mark.parametrize(
    ("fault", "word", "kind"),
    [
        (compass_off_by_place, "position", "heading error over position"),
        pytest.param(_ageing, "time", "a_x error over time", marks=pytest.mark.long),
        pytest.param(_leaning, "speed", "place error over speed", marks=pytest.mark.long),
    ],
)
def test_what_no_entry_explains_is_found_by_what_it_depends_on(fault, word, kind):
    fit, model = faulty(fault)
    report = adequacy(fit, Selection(model, model, [], []), None).adequacy
    assert not report.passed and report.depends_on[0] == word
    worst = max((c for c in report.checks if c.decides), key=lambda c: c.value)
    assert worst.name == f"{kind} [nats]"


def propelled(**more: float) -> Callable[[VesselFile], VesselFile]:
    return lambda vessel: replace(vessel, propulsion=replace(
        vessel.propulsion, **{k: (getattr(vessel.propulsion, k) or 0.0) + v for k, v in more.items()}))  # fmt: skip


@pytest.mark.parametrize(
    "more",
    [{"lag_s": 0.12}, *(pytest.param(m, marks=pytest.mark.long) for m in ({"dead_time_s": 0.12}, {"slew_N_s": 15.0}))],
)
def test_thrust_that_comes_later_is_told_from_drag(more):
    fit, model = other(propelled(**more), "lag", "dead_time", "rate_limit")
    report = adequacy(fit, Selection(model, model, [], []), None).adequacy
    assert not report.passed and report.depends_on[0] == "thruster"
    worst = max((c for c in report.checks if c.decides), key=lambda c: c.value)
    assert worst.name in ("past thrust, all [nats]", "thrust after changes, all [nats]")


def _obstructed(run: Run) -> Run:
    """One fix in fifteen is 1 m too far north. Seed 5."""
    off = np.random.default_rng(5).uniform(size=run.table.height) < 1 / 15
    return Run(run.table.with_columns(north_m=pl.col("north_m") + pl.Series(1.0 * off)), run.meta)


@pytest.mark.long
def test_fixes_far_out_are_something_left_over_unless_a_cause_explains_them():
    fit, model = faulty(_obstructed)
    selection = Selection(model, model, [], [])
    share = outlier_check(model.point)
    assert 0.04 < share.value < 0.09 and share.limit == OFTEN and f"{FAR_OUT:g}" in share.name
    report = adequacy(fit, selection, None).adequacy
    assert not report.passed and report.depends_on == ("position",)
    assert share.name not in {c.name for c in adequacy(fit, selection, None, Masking(outliers=True)).adequacy.checks}
    assert outlier_check(clean()[1].point).passed
