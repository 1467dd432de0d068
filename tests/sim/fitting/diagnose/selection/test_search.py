"""Causes found in simulated logs, and requests that are refused.

Logs are simulated (`teleop_run`, seeds stated); boats differ from the vessel file by one effect.
"""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import polars as pl
import pytest

from companion.logs.runs.run import Run
from sim.fitting.diagnose.catalogue import catalogue
from sim.fitting.diagnose.catalogue.effect import Effect, EffectParameter
from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.posterior.noise import stated_noise
from sim.fitting.diagnose.posterior.physics import EffectPhysics
from sim.fitting.diagnose.selection.greedy_selection import Selector
from sim.fitting.diagnose.selection.search import search_causes
from sim.world.environment import Weather
from sim.world.teleop_log import teleop_run
from tests.sim.fitting.diagnose.posterior_fixture import VESSEL, short
from tests.support.vessel_fixtures import boat


@pytest.mark.long
def test_causes_of_chance_that_are_there_for_sure_are_reported_however_small():
    """Of a calm log (seed 21), which shows none of them; a gusty wind stands for the wind."""
    fit = PosteriorFit(EffectPhysics([short()], VESSEL, 1.0), catalogue(VESSEL, [short()]), stated_noise(VESSEL))
    found = search_causes(fit, known_causes=("waves", "gusty_wind", "nlos"))
    assert {c.effect.name for c in found.causes} == {"waves", "gusty_wind", "nlos"}
    for cause in found.causes:
        se = np.sqrt(np.diag(cause.candidate.covariance))
        assert 0 <= cause.candidate.lower < 1 and 0 < se[0] < 10 * cause.effect.parameters[0].smallest


def test_causes_that_no_sensor_shows_are_refused():
    none = pl.lit(None, dtype=pl.Float64)
    deaf = Run(short().table.with_columns(ax_m_s2=none, ay_m_s2=none), short().meta)
    fit = PosteriorFit(EffectPhysics([deaf], VESSEL, 1.0), catalogue(VESSEL, [deaf]), stated_noise(VESSEL))
    with pytest.raises(ValueError, match="believe 'waves': accelerations alone show it, and these logs have none"):
        search_causes(fit, known_causes=("lag", "waves"))


def test_an_unknown_hook_is_refused():
    with pytest.raises(ValueError, match="unknown hook 'drag'"):
        Effect("x", "hull", "", "", (EffectParameter("p", "1", 1, 1, 1),), {"drag": lambda p: p})


def test_two_entries_of_one_name_are_refused():
    mine = Effect("lag", "hull", "", "", (EffectParameter("p", "1", 1, 1, 1),), {"force": lambda p, scene: 0.0})
    with pytest.raises(ValueError, match="'lag' is in the catalogue twice"):
        catalogue(VESSEL, [short()], [mine])


def found_in(true, seconds: float = 120.0, weather: Weather | None = None) -> dict[str, np.ndarray]:
    runs = [teleop_run(true, seed, seconds, uwb_hz=5.0, sigma_m=0.07, weather=weather) for seed in (31, 32)]
    fit = PosteriorFit(EffectPhysics(runs, VESSEL, 1.0), catalogue(VESSEL, runs), stated_noise(VESSEL))
    return {c.id: c.values for c in Selector(fit).run().causes}


@pytest.mark.long
def test_nothing_is_named_where_nothing_is_hidden():
    assert found_in(boat("aritra")) == {}


@pytest.mark.long
def test_a_weak_thruster_and_a_current_are_named_together_with_their_sizes():
    v = boat("aritra")
    weak = [msgspec.structs.replace(t, gain=0.75) if t.name == "rear_port" else t for t in v.thrusters]
    found = found_in(msgspec.structs.replace(v, thrusters=tuple(weak)), weather=Weather(V_c_m_s=0.08, beta_c_deg=60.0))
    assert set(found) == {"thruster_gain:rear_port", "current"}
    assert found["thruster_gain:rear_port"] == pytest.approx([-0.25], abs=0.03)
    assert found["current"] == pytest.approx([0.04, 0.0693], abs=0.004)


@pytest.mark.long
def test_late_positions_are_not_taken_for_lag():
    v = boat("aritra")
    uwb = msgspec.structs.replace(v.sensors.uwb, latency_s=v.sensors.uwb.latency_s + 0.15)
    found = found_in(msgspec.structs.replace(v, sensors=msgspec.structs.replace(v.sensors, uwb=uwb)))
    assert set(found) == {"uwb_latency"}
    assert found["uwb_latency"] == pytest.approx([0.15], abs=0.015)


def test_a_users_own_entry_acts_as_it_says():
    """From outside the package: a keel that pushes sideways in proportion to surge."""

    def keel(p, scene):
        out = np.zeros((*scene.t_s.shape, 3))
        out[..., 1] = p["k_N_s_m"] * scene.u_m_s
        return out

    mine = Effect(
        "keel", "hull", "Y += k u", "crabs", (EffectParameter("k_N_s_m", "N s/m", 20.0, 2.0, 0.6),), {"force": keel}
    )
    runs = [short()]
    own = PosteriorFit(EffectPhysics(runs, VESSEL, 1.0), catalogue(VESSEL, runs, [mine]), stated_noise(VESSEL))
    theta = {"keel": np.array([8.0])}
    state = own.physics.move(own.effects, theta, own.z0, None)
    plain = own.physics.move(own.effects, {}, own.z0, None)
    pushed = (state.tau - plain.tau)[..., 1]
    assert pushed == pytest.approx(8.0 * state.x[..., 3], abs=0.3)
    assert replace(mine, origin={"k_N_s_m": 1.0}).always_free is False
