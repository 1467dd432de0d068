"""Scores of known errors: horizons, box, whiteness, divergence."""

from dataclasses import dataclass

import numpy as np
import pytest

from sim.fitting.taylor.abkowitz import C
from sim.fitting.validate.divergence import divergence_study, divergence_table
from sim.fitting.validate.models import TaylorSimulator, VesselSimulator
from sim.fitting.validate.protocol import Commands
from sim.fitting.validate.scores import SpeedBox, errors, score, whiteness
from sim.fitting.validate.windows import HeldOutWindows
from tests.sim.fitting.validate.example_vessel import VESSEL


@dataclass(frozen=True)
class Told:
    """A model that says what it is told to, at the command rate."""

    name: str
    x: np.ndarray

    def simulate(self, x0, commands):
        out = np.repeat(self.x, 2, axis=1)[:, : commands.pwm_us.shape[1] + 1]
        return np.concatenate([out, self.x[:, -1:]], axis=1)[:, : commands.pwm_us.shape[1] + 1]


def test_errors_tell_unknown_from_gone_and_wrap_the_heading():
    truth = np.zeros((1, 3, 6))
    truth[0, 2] = np.nan
    states = np.zeros((1, 3, 6))
    states[0, 0] = [3, 4, 2 * np.pi + 0.1, 0.5, 0, 0]
    states[0, 1:] = np.nan
    e = errors(states, truth)
    assert np.allclose(e[0, 0], [5, 0.1, 0.5, 0, 0])
    assert np.isinf(e[0, 1]).all()
    assert np.isnan(e[0, 2]).all()


def test_the_box():
    box = SpeedBox.of(np.array([[0.0, -1, 0], [1, 1, 2], [np.nan, 9, 9]]))
    assert np.array_equal(box.low, [0, -1, 0]) and np.array_equal(box.high, [1, 1, 2])
    inside = [[1.99, 2.99, 3.99], [-0.99, 0, 1]]
    outside = [[2.01, 0, 1], [0.5, 0, -2.01], [np.nan, 0, 0], [np.inf, 0, 0]]
    assert not box.left(np.array(inside)).any()
    assert box.left(np.array(outside)).all()


def test_scores_of_known_errors():
    """Four windows of 30 s: one exact, one 0.1 fast in u, one that ends after 12 s, one gone after 20 s."""
    rng = np.random.default_rng(0)
    truth = rng.normal(size=(4, 301, 6)) * [0, 0, 0, 0.2, 0.1, 0.1]
    states = truth.copy()
    states[1, :, 3] += 0.1
    truth[2, 121:] = np.nan
    states[3, 200:] = np.nan
    zero = np.zeros((4, 600, 4))
    windows = HeldOutWindows(truth[:, 0], truth, Commands(zero, zero[..., 0], zero[:, :1]), np.zeros(4))
    box = SpeedBox(np.full(3, -1.0), np.ones(3))
    found, _ = score(Told("told", states), windows, box)
    at = {h: i for i, h in enumerate(found.horizons_s)}
    assert found.horizons_s == (1, 2, 5, 10, 20, 30)
    assert list(found.count[[at[10], at[20]]]) == [4, 3]
    assert found.rms["u"][at[10]] == pytest.approx(0.05)
    assert np.isinf(found.rms["u"][at[20]])
    assert found.median["u"][at[20]] == pytest.approx(0.1)
    assert np.isinf(found.p90["u"][at[20]])
    assert found.diverged[at[10]] == 0.0
    assert found.diverged[at[20]] == pytest.approx(1 / 3)
    assert found.r2["u"] == -np.inf
    part = replace_windows(windows, slice(0, 2))
    found, _ = score(Told("told", states[:2]), part, box)
    u = truth[:2, :, 3]
    assert found.nrmse["u"] == pytest.approx(np.sqrt(0.005) / np.ptp(u))
    assert found.r2["u"] == pytest.approx(1 - 0.005 / u.var())
    assert found.r2["v"] == 1.0


def replace_windows(w, part):
    c = w.commands
    return HeldOutWindows(
        w.x0[part], w.truth[part], Commands(c.pwm_us[part], c.battery_v[part], c.before_us[part]), w.start_s[part]
    )


def test_whiteness_knows_white_from_coloured():
    rng = np.random.default_rng(1)
    k = 400
    white = rng.normal(size=(k, 3))
    coloured = white.copy()
    for i in range(1, k):
        coloured[i] += 0.5 * coloured[i - 1]
    zero = np.zeros((k, 20, 4))
    truth = np.zeros((k, 11, 6))
    windows = HeldOutWindows(truth[:, 0], truth, Commands(zero, zero[..., 0], zero[:, :1]), np.arange(k))
    for series, expected in ((white, True), (coloured, False)):
        states = np.zeros((k, 11, 6))
        states[:, :, 3:] = series[:, None]
        found = whiteness(Told("x", states), windows)
        assert all((f.p > 0.01) == expected for f in found.values())
        assert all(f.n == k for f in found.values())
        assert found["u"].lag1 == pytest.approx(0.0 if expected else 0.5, abs=0.1)


def test_divergence_counts_and_quantiles(found):
    printed = TaylorSimulator("printed", C, VESSEL)
    true, gone = divergence_study([VesselSimulator("true", VESSEL), printed], found.windows, found.box)
    assert true.diverged[-1] == 0.0 and np.isinf(true.first_s).all()
    assert gone.diverged[-1] == np.isfinite(gone.first_s).mean() > 0.0
    assert (np.diff(gone.diverged) >= 0).all()
    assert (np.diff(true.position_m, axis=1) >= 0).all()
    first, second = divergence_table([true, gone]).rows
    assert first[:2] == ("true", "0.00 m, 0 %") and second[-1] == "-"
