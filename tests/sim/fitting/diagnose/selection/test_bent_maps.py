"""A thrust map that is bent otherwise ahead than astern is no asymmetry; an asymmetry is none of its bends. Seed 21."""

import pytest
from msgspec.structs import replace

from companion.core.configuration.vessel_file import RotorCurve, RotorMap, VesselFile
from companion.core.model.load_vessel import load_vessel
from companion.core.model.vessel_text import vessel_toml
from sim.fitting.diagnose.catalogue import catalogue, propulsion
from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.posterior.noise import stated_noise
from sim.fitting.diagnose.posterior.physics import EffectPhysics
from sim.fitting.diagnose.selection.greedy_selection import Selector
from sim.world.teleop_log import teleop_run
from tests.sim.fitting.diagnose.posterior_fixture import VESSEL
from tests.support.vessel_fixtures import boat

ASTERN = "astern_asymmetry"


def curved(c: RotorCurve, share: float) -> RotorCurve:
    """The same speed at full command, `share` more in proportion near none."""
    return replace(c, c1_rps=c.c1_rps * (1 + c.q * share), c2_rps=c.c2_rps - c.c1_rps * c.q * share)


def mapped(**keys) -> VesselFile:
    true = boat("aritra")
    maps = {k: replace(m, **{key: of(m) for key, of in keys.items()}) for k, m in true.force_maps.items()}
    assert all(isinstance(m, RotorMap) for m in maps.values())
    return replace(true, force_maps=maps)


def selected(true: VesselFile):
    """Selection by the file of the sound boat on a log of `true`."""
    run = teleop_run(true, 21, 120.0, uwb_hz=5.0, sigma_m=0.07)
    fit = PosteriorFit(EffectPhysics([run], VESSEL, 1.0), catalogue(VESSEL, [run]), stated_noise(VESSEL))
    return Selector(fit).run()


@pytest.mark.long
def test_a_bent_map_is_fitted_as_bent_and_names_no_asymmetry():
    found = selected(mapped(ahead=lambda m: curved(m.ahead, 0.08), astern=lambda m: curved(m.astern, -0.08)))
    assert found.causes == []
    assert 0.05 < found.base.point.theta["base:bend"][0] < 0.1


@pytest.mark.parametrize("end", ["lower", "upper"])
def test_a_map_that_is_bent_as_far_as_it_may_be_can_be_written_and_loaded(end):
    (bend,) = (e for e in propulsion.base(VESSEL) if e.id == "base:bend")
    share = getattr(bend.parameters[0], end)
    bent = bend.hooks["maps"]({"share": share}, VESSEL)
    maps = load_vessel(vessel_toml(bent), name="bent").force_maps.values()
    assert min(c.c2_rps for m in maps for c in (m.ahead, m.astern)) > 0.01  # rounding took it below zero


@pytest.mark.long
def test_thrusters_that_give_less_astern_at_every_command_are_named():
    found = selected(mapped(k_astern_N_s2=lambda m: 0.82 * m.k_astern_N_s2))
    assert [c.id for c in found.causes] == [ASTERN]
    assert abs(found.final.point.theta[ASTERN][0] + 0.18) < 0.04
