"""Simulated logs and the boat they are of, for the tests of the diagnosis."""

from __future__ import annotations

from functools import cache

from sim.fitting.diagnose.catalogue import catalogue
from sim.fitting.diagnose.catalogue.effect import Effect
from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.posterior.noise import stated_noise
from sim.fitting.diagnose.posterior.physics import EffectPhysics
from sim.studies.boats.draw import in_still_air
from sim.world.teleop_log import teleop_run
from tests.support.vessel_fixtures import boat

VESSEL = in_still_air(boat("aritra"))


@cache
def short(seed: int = 21, seconds: float = 40.0):
    return teleop_run(boat("aritra"), seed, seconds, uwb_hz=5.0, sigma_m=0.07)


@cache
def bench() -> tuple[PosteriorFit, dict[str, Effect]]:
    fit = PosteriorFit(EffectPhysics([short()], VESSEL, 1.0), catalogue(VESSEL, [short()]), stated_noise(VESSEL))
    return fit, {e.id: e for e in fit.effects}
