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
from sim.fitting.diagnose.selection.search import search_causes
from sim.fitting.diagnose.selection.smoothed_logs import ModelUnderTest
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


@pytest.mark.parametrize("name", ["imu_lever_arm", "imu_misalignment"])
def test_what_lean_does_to_accelerometers_in_turns_is_named_only_where_roll_and_pitch_are_known(name):
    level, leaned = fit_of(short()), fit_of(leaning(short()))
    assert name in {e.name for e in level.effects} and name not in {e.name for e in leaned.effects}
    with pytest.raises(ValueError, match=f"believe '{name}': only logs with roll and pitch"):
        search_causes(leaned, known_causes=[name])


def error(horizon_s, low, gain=0.1):
    return SimpleNamespace(horizon_s=horizon_s, gain=gain, gain_ci95=(low, 0.5))


class Elimination:
    """A fit, a selection of causes and their held-out scores: by the ids that are left, those of each cause."""

    def __init__(self, monkeypatch, families, scores, levelled=False, implausible_nats=0.0):
        self.scores, effects = scores, [SimpleNamespace(id=i, family=f) for i, f in families.items()]
        self.fit = SimpleNamespace(physics=SimpleNamespace(levelled=levelled), effects=effects)
        monkeypatch.setattr(held_out_support, "model_without", self._without)
        monkeypatch.setattr(held_out_support, "implausibility", lambda *_: implausible_nats)
        monkeypatch.setattr(held_out_support, "Selector", lambda fit: SimpleNamespace(without=self._left))

    def gone(self):
        names = "".join(e.id for e in self.fit.effects)
        return held_out_support.unsupported(self.fit, self._of(names), lambda one, other: self.scores[one])  # type: ignore[arg-type]

    def _of(self, names):
        final = SimpleNamespace(point=SimpleNamespace(theta={}), noise=None)
        return SimpleNamespace(final=final, causes=[SimpleNamespace(id=i) for i in names])

    def _without(self, fit, selection, gone):
        return "".join(c.id for c in selection.causes), gone

    def _left(self, selection, ids):
        return self._of("".join(c.id for c in selection.causes if c.id not in ids))


def scored(nats, *errors):
    return SimpleNamespace(errors=errors, nats={"refit": 0.0, "extended": nats})


@pytest.mark.parametrize(
    ("family", "near", "nats", "gone"),
    [
        ("sensors", error(10, -0.1), 5.0, True),
        ("sensors", error(10, 0.05), 0.0, False),
        ("sensors", error(10, -0.1), 40.0, False),
        ("propulsion", error(10, -0.1), 40.0, True),
        ("propulsion", error(10, 0.05), 0.0, False),
        ("propulsion", error(10, 0.001, gain=0.003), 0.0, True),
    ],
)
@pytest.mark.parametrize("levelled", [False, True])
def test_a_cause_stays_where_held_out_readings_need_it(family, near, nats, gone, levelled, monkeypatch):
    scores = {("a", "a"): scored(nats, near, error(20, 0.3))}
    out = Elimination(monkeypatch, {"a": family}, scores, levelled).gone()
    assert out == ({"a"} if gone and not levelled else set())


@pytest.mark.parametrize(("nats", "gone"), [(5.0, True), (7.0, False)])
def test_a_cause_stays_where_only_many_small_faults_together_foretell_as_well(nats, gone, monkeypatch):
    scores = {("a", "a"): scored(-2.0, error(10, -0.1))}
    assert Elimination(monkeypatch, {"a": "hull"}, scores, implausible_nats=nats).gone() == ({"a"} if gone else set())


def test_a_cause_goes_where_the_logs_are_decisively_less_likely_with_it_whatever_else_speaks_for_it(monkeypatch):
    for nats, gone in ((-13.0, {"a"}), (-11.0, set())):
        scores = {("a", "a"): scored(nats, error(10, 0.2))}
        assert Elimination(monkeypatch, {"a": "hull"}, scores, implausible_nats=40.0).gone() == gone


def test_many_small_faults_are_the_less_plausible_the_more_and_the_larger_they_are():
    """Two thrusters weak by 4 tolerance bands each: 1/2 (16 + 16) / 2^2 nats. What a cause sets is no small fault."""
    fit = fit_of(short())
    gains = [e for e in fit.effects if e.name.startswith("thruster_gain:")]
    cause = next(e for e in fit.effects if e.id == "payload")
    selection = SimpleNamespace(causes=[SimpleNamespace(id="payload")])
    rest = ModelUnderTest({e.id: -4 * e.tolerance() for e in gains[:2]}, fit.noise)
    whole = ModelUnderTest({cause.id: 50 * cause.tolerance()}, fit.noise)
    assert held_out_support.implausibility(fit, selection, rest, whole) == pytest.approx(4.0)  # type: ignore[arg-type]


def test_causes_are_taken_back_one_at_a_time_the_least_needed_first(monkeypatch):
    """Beside the false b the true a does not help; once b is gone, it does."""
    useless, useful = error(10, -0.1), error(10, 0.2)
    scores = {
        ("ab", "a"): scored(-3.0, useless),
        ("ab", "b"): scored(-50.0, useless),
        ("a", "a"): scored(30.0, useful),
    }
    assert Elimination(monkeypatch, {"a": "hull", "b": "sensors"}, scores).gone() == {"b"}


@pytest.mark.long
def test_held_out_readings_are_asked_of_a_model_without_the_cause_not_with_what_its_band_leaves_of_it():
    """A tolerance band lets a gyro that reads 9 % too much keep nearly all of it: every model foretold as well."""
    run = leaning(short(seconds=60.0))
    fit = fit_of(Run(run.table.with_columns(pl.col("r_rad_s") * 1.09), run.meta))
    selection = Selector(fit).fit_causes(Selector(fit).base(), ["gyro_scale"])
    assert selection.final.point.theta["gyro_scale"][0] == pytest.approx(0.09, abs=0.02)
    assert selection.base.point.theta["gyro_scale"][0] > 0.05
    assert abs(held_out_support.model_without(fit, selection, "gyro_scale").theta["gyro_scale"][0]) < 1e-3
    other = held_out_support.model_without(fit, selection, "uwb_scale")  # of no matter here: nothing else may change
    assert other.theta["gyro_scale"] == pytest.approx(selection.final.point.theta["gyro_scale"], abs=1e-5)
