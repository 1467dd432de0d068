"""Accelerations that differ by a factor from what positions show: another unit is refused, any other factor told."""

import polars as pl
import pytest

from companion.logs.runs.run import Run
from sim.fitting.diagnose.preparation.swapped_columns import reject_swapped_columns, strange_scale
from sim.fitting.engine.split import JobError
from tests.evidence.diagnose import survive


def good() -> Run:
    return survive.log("aritra", "", survive.SEED, survive.SECONDS, 5.0, False)


def scaled(factor: float) -> Run:
    run = good()
    table = run.table.with_columns(ax_m_s2=pl.col("ax_m_s2") / factor, ay_m_s2=pl.col("ay_m_s2") / factor)
    return Run(table.with_columns(phi_rad=pl.lit(None, pl.Float64), theta_rad=pl.lit(None, pl.Float64)), run.meta)


def test_a_factor_that_is_no_units_is_told_and_not_refused():
    """A valid log of spins of a real boat showed 0.298."""
    reject_swapped_columns(scaled(0.298))
    (problem,) = strange_scale(scaled(0.298))
    assert problem.kind == "disagree" and "leave both columns blank" in problem.text
    assert strange_scale(good()) == []


@pytest.mark.parametrize(("factor", "unit"), [(9.80665, "g"), (0.01, "mg")])
def test_accelerations_in_another_unit_are_refused_with_the_way_round(factor, unit):
    with pytest.raises(JobError, match=rf"they are in {unit}; write them in m/s\^2, or leave both columns blank"):
        reject_swapped_columns(scaled(factor))
