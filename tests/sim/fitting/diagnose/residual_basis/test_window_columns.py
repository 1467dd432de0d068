"""Columns of the residual basis against those of the engine."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from companion.core.model.manoeuvring import mass_matrix
from sim.fitting.diagnose.catalogue.effect import Effect
from sim.fitting.diagnose.report.sentences import WORDS
from sim.fitting.diagnose.residual_basis import FunctionGroup, append_groups, groups_at
from sim.fitting.engine.noise import BIAS_AX, LATENT, OFFSET, L
from tests.sim.fitting.diagnose.adequacy_fixture import UNIT, VESSEL, clean


def shifted(effect_nodes: np.ndarray) -> FunctionGroup:
    return FunctionGroup(("time",), Effect("one", "generic", "one", "", UNIT, {}), effect_nodes[:, :, None])


def _heading(p, scene, y):
    out = y.copy()
    out[..., 0] += p["a"]
    return out


def _surge(p, scene, y):
    out = y.copy()
    out[..., 2] += p["a"]
    return out


def _push(p, scene):
    return p["a"] * np.ones((*scene.t_s.shape, 1)) * (mass_matrix(VESSEL) @ np.array([0.3, -0.2, 0.5]))


def _east(p, sight, place):
    return place + p["a"] * np.array([0.0, 1.0])


@pytest.mark.parametrize(
    ("hooks", "entry", "value"),
    [
        ({"imu": _heading}, OFFSET, 1.0),
        ({"imu": _surge}, BIAS_AX, 1.0),
        ({"force": _push}, LATENT, np.array([0.3, -0.2, 0.5])),
        ({"tag": _east}, 1, 1.0),
    ],
)
def test_what_moves_a_node_is_what_the_engine_would_have_made_of_it(hooks, entry, value):
    """Oracle: the engine's own column of an effect that does the same."""
    fit, model = clean()
    effect = Effect("same", "test", "", "", UNIT, hooks)
    wanted = fit.lineariser.point(
        fit.effects, model.point.theta, model.point.z, model.noise, [effect], model.point.state
    )
    nodes = np.zeros((len(model.point.z), L))
    nodes[:, entry] = value
    found = append_groups(model.point, (shifted(nodes),))
    whole = np.zeros_like(found.chain.B[:, :, -1]) + wanted.chain.B[:, :, 0]
    scale = np.abs(whole).max(axis=0) + 1e-9
    assert (np.abs(found.chain.B[:, :, -1] - whole) <= 0.03 * scale).all()
    assert found.chain.D[-1, -1] == pytest.approx(wanted.chain.D[0, 0], rel=0.03)
    assert found.chain.d[-1] == pytest.approx(wanted.chain.d[0], rel=0.05, abs=0.05 * np.sqrt(wanted.chain.D[0, 0]))
    off = np.abs(found.ties.G[:, :, -1] - wanted.ties.G[:, :, 0]).max(axis=0)
    assert (off <= 0.03 * np.abs(wanted.ties.G[:, :, 0]).max() + 1e-9).all()


def test_groups_have_known_words_and_do_something():
    fit, model = clean()
    groups = groups_at(fit.physics, model.point)
    assert len({g.effect.id for g in groups}) == len(groups)
    for group in groups:
        assert {w.partition(":")[0] for w in group.words} <= set(WORDS)
        assert (group.nodes is None) == bool(group.effect.hooks)
        nodes = group.of_means(fit.physics, model.point, fit.effects).nodes
        assert nodes is not None and nodes.shape == (*model.point.z.shape, len(group.effect.parameters))
        assert (np.abs(nodes).max(axis=(0, 1)) > 0).all() and np.isfinite(nodes).all()


def test_shares_of_the_hull_are_of_the_hull_as_it_is_found():
    """A hull with half as much drag again: a share of it is half as much again."""
    fit, model = clean()
    (drag,) = (g for g in groups_at(fit.physics, model.point) if g.effect.equation == "damping")
    fouled = {**model.point.theta, "hull_fouling": np.array([0.5])}
    state = fit.physics.move(fit.effects, fouled, model.point.z, model.point.state)
    point = dataclasses.replace(model.point, theta=fouled, state=dataclasses.replace(state, x=model.point.state.x))
    before, after = (drag.of_means(fit.physics, p, fit.effects).nodes for p in (model.point, point))
    more = 1.5 / (1 + model.point.theta["hull_fouling"][0])
    np.testing.assert_allclose(after, more * before, atol=0.02 * np.abs(before).max())


def test_a_force_that_does_not_vary_within_windows_is_its_mean():
    fit, model = clean()
    pushed = FunctionGroup(("speed",), Effect("one", "generic", "one", "", UNIT, {"force": _push}))
    nodes = pushed.of_means(fit.physics, model.point, fit.effects).nodes
    assert nodes is not None
    np.testing.assert_allclose(nodes[:, LATENT, 0], np.tile([0.3, -0.2, 0.5], (len(nodes), 1)), rtol=0.02)
    assert not np.delete(nodes, LATENT, axis=1).any()
