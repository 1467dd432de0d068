"""Without roll and pitch, what a boat reads of its leaning makes no cause. Seed 21."""

from types import SimpleNamespace

import numpy as np
import polars as pl
import pytest
from scipy.signal import lfilter

from companion.logs.runs.run import Run
from sim.fitting.diagnose.catalogue import catalogue
from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.posterior.noise import UNKNOWN_LEAN, dependence, stated_noise
from sim.fitting.diagnose.posterior.physics import EffectPhysics
from sim.fitting.diagnose.selection import held_out_support
from sim.fitting.diagnose.selection.greedy_selection import Selector
from tests.sim.fitting.diagnose.posterior_fixture import VESSEL, short

LEAN = 0.15


def leaning(run: Run) -> Run:
    """`run` of a boat that leans with its acceleration, and of whose roll and pitch nothing is known."""
    more = [(pl.col(c) * (1 + LEAN)).alias(c) for c in ("ax_m_s2", "ay_m_s2")]
    return Run(run.table.drop("phi_rad", "theta_rad").with_columns(more), run.meta)


def fit_of(run: Run) -> PosteriorFit:
    return PosteriorFit(EffectPhysics([run], VESSEL, 1.0), catalogue(VESSEL, [run]), stated_noise(VESSEL, [run]))


def test_without_roll_and_pitch_lean_is_free_and_no_cause_and_accelerometers_count_for_little():
    fit = fit_of(leaning(short(seconds=60.0)))
    base = Selector(fit).base()
    assert min(base.noise.white[2:]) >= UNKNOWN_LEAN
    assert base.point.theta["base:accel_x"][0] == pytest.approx(LEAN, abs=0.15)
    ranking = Selector(fit).screen(base)
    assert [c.id for c in ranking if c.accepted] == []


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.8])
def test_the_effective_sample_size_is_that_of_a_first_order_autoregression(rho):
    """n over effective n = (1 + rho) / (1 - rho): Bartlett (1935)."""
    white = np.random.default_rng(3).standard_normal((20_000, 2))
    series = lfilter([np.sqrt(1 - rho**2)], [1, -rho], white, axis=0)
    assert dependence(series) == pytest.approx((1 + rho) / (1 - rho), rel=0.12)


def error(horizon_s, low):
    return SimpleNamespace(horizon_s=horizon_s, gain_ci95=(low, 0.5))


@pytest.mark.parametrize(
    ("levelled", "low", "nats", "gone"),
    [(True, -0.1, 0.0, False), (False, -0.1, 5.0, True), (False, 0.05, 0.0, False), (False, -0.1, 40.0, False)],
)
def test_a_cause_stays_where_held_out_readings_need_it(levelled, low, nats, gone, monkeypatch):
    model = SimpleNamespace(final=SimpleNamespace(point=SimpleNamespace(theta={}), noise=None))
    monkeypatch.setattr(held_out_support, "Selector", lambda fit: SimpleNamespace(without=lambda s, ids: model))
    selection = SimpleNamespace(final=model.final, causes=[SimpleNamespace(id="uwb_scale")])
    found = SimpleNamespace(errors=[error(10, low), error(20, 0.3)], nats={"refit": 0.0, "extended": nats})
    fit = SimpleNamespace(physics=SimpleNamespace(levelled=levelled))
    out = held_out_support.unsupported(fit, selection, lambda one, other: found)  # type: ignore[arg-type]
    assert out == ({"uwb_scale"} if gone else set())
