"""Fixes from ranges, all cycles at once: scipy and the true place are the oracles."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares

from companion.boat.load_run import EXAMPLES
from companion.core.configuration.site_file import load_site
from companion.logs.readers.positions import SPREAD_M, cycle_fixes

SITE = load_site((EXAMPLES / "sites" / "basin.toml").read_text(), name="basin.toml")
PLACES = np.array([(a.north_m, a.east_m, a.down_m) for a in SITE.anchors])
TAG_DOWN_M = -0.4
IDS = [a.id for a in SITE.anchors]


def ranges_to(tag: np.ndarray) -> np.ndarray:
    """Distances (n, anchors) of tags (n, 2)."""
    full = np.column_stack([tag, np.full(len(tag), TAG_DOWN_M)])
    return np.linalg.norm(full[:, None, :] - PLACES, axis=2)


def found(z: np.ndarray) -> np.ndarray:
    return np.column_stack(cycle_fixes({k: z[:, i] for i, k in enumerate(IDS)}, SITE, TAG_DOWN_M))


@given(st.lists(st.tuples(st.floats(0.5, 29.5), st.floats(0.5, 29.5)), min_size=1, max_size=20))
def test_without_noise_the_place_itself_comes_back(places):
    tag = np.array(places)
    np.testing.assert_allclose(found(ranges_to(tag)), tag, atol=1e-3)


def test_with_noise_and_a_wild_range_it_is_scipys_cauchy_fit():
    rng = np.random.default_rng(11)
    tag = rng.uniform(3, 27, (100, 2))
    z = ranges_to(tag) + rng.normal(0, 0.05, (100, 4))
    wild = np.arange(100) % 3 == 0
    z[wild, rng.integers(0, 4, 100)[wild]] += rng.uniform(2, 8, 100)[wild]
    got = found(z)
    assert np.isfinite(got).all()
    near = np.linalg.norm(got - tag, axis=1) < 0.4
    assert near[~wild].all() and near.sum() >= 98  # with one of four wild, three may agree on another place
    for k in np.flatnonzero(near):
        fit = least_squares(lambda p, k=k: z[k] - ranges_to(p[None, :])[0], tag[k], loss="cauchy", f_scale=SPREAD_M / 2)
        np.testing.assert_allclose(got[k], fit.x, atol=5e-3)


def test_too_few_or_contradicting_ranges_give_no_fix():
    tag = np.array([[10.0, 12.0]] * 3)
    z = ranges_to(tag)
    z[0, :2] = np.nan
    z[1, 0] = np.nan
    z[2] += [5.0, -4.0, 6.0, 0.0]
    got = found(z)
    assert np.isnan(got[0]).all()
    np.testing.assert_allclose(got[1], tag[1], atol=1e-3)
    assert np.isnan(got[2]).all()
    strange = cycle_fixes({"FFFF": np.array([1.0, 2.0])}, SITE, TAG_DOWN_M)
    assert np.isnan(strange).all() and strange[0].shape == (2,)
