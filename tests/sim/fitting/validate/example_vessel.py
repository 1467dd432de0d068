"""The example boat and the noise of its smoother."""

from sim.fitting.engine.smoothing import SmootherNoise
from tests.support.vessel_fixtures import boat

VESSEL = boat("aritra")
NOISE = SmootherNoise.of(VESSEL)
