"""Missions of one true boat by pilots with different models of it.

The plant is the true boat; filter, guidance, NMPC and allocation use the pilot's model. The same seed gives the same
start, sensor noise and weather for every pilot, so that pilots can be compared run by run.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.core.control.nmpc import Actuation, Nmpc
from companion.core.messages import GroundTruth, GuidanceReference, OverrideLease, StateEstimate
from companion.core.model.integrate import VesselModel
from companion.core.model.manoeuvring import StructuredModel
from companion.core.model.thrusters import configuration_matrix
from companion.core.pilot.pilot import Pilot, PilotSettings
from companion.jit import compile_loops
from sim.fitting.taylor.abkowitz import AbkowitzModel
from sim.world.environment import Weather
from sim.world.score import estimation, track_of, tracking
from sim.world.stepped import SteppedRun
from sim.world.world import World, WorldSetup

LIMIT_S = 240.0
"""A mission of the main job takes about 105 s; a boat still under way after so long is stopped."""


@dataclass(frozen=True)
class BelievedModel:
    """The models of a pilot: `vessel` in filter, guidance and allocation; Taylor coefficients (3, 23) in the NMPC.

    `taylor` None: the NMPC plans with the structured model of `vessel` too.
    """

    name: str
    vessel: VesselFile
    taylor: np.ndarray | None = None

    @property
    def model(self) -> VesselModel:
        """The model of the NMPC."""
        if self.taylor is None:
            return StructuredModel.of(self.vessel)
        lag_s = self.vessel.propulsion.lag_s
        return AbkowitzModel(configuration_matrix(self.vessel), lag_s, coefficients=self.taylor)


@dataclass(frozen=True)
class Driven:
    """One mission. `missed`: waypoints not passed; `plans`: share of driven ticks whose lease came from a plan.

    `cross_track_rms_m` and `surge_rms_error_m_s` on the straight parts of legs, as far as the boat came.
    """

    belief: str
    seed: int
    cross_track_rms_m: float
    surge_rms_error_m_s: float
    overshoot_m: float
    position_rmse_m: float
    missed: int
    plans: float
    seconds: float


def start_of(seed: int, centre: tuple[float, float] = (8.0, 8.0)) -> tuple[float, float, float]:
    """North, east [m] and heading [rad] within 0.5 m and 35 degrees, as in the main job's evidence."""
    rng = np.random.default_rng([seed, 7])
    north, east = centre[0] + rng.uniform(-0.5, 0.5), centre[1] + rng.uniform(-0.5, 0.5)
    return float(north), float(east), float(rng.uniform(-0.6, 0.6))


def missions(
    true: VesselFile,
    belief: BelievedModel,
    settings: PilotSettings,
    seeds: Sequence[int],
    *,
    weather: Weather | None = None,
    limit_s: float = LIMIT_S,
) -> list[Driven]:
    """One mission a seed, scored; arguments as of `driven_runs`."""
    runs = driven_runs(true, belief, settings, seeds, weather=weather, limit_s=limit_s)
    return [_scored(run, belief.name, seed) for seed, run in runs]


def driven_runs(
    true: VesselFile,
    belief: BelievedModel,
    settings: PilotSettings,
    seeds: Sequence[int],
    *,
    weather: Weather | None = None,
    limit_s: float = LIMIT_S,
) -> Iterator[tuple[int, SteppedRun]]:
    """One mission a seed; filter and NMPC are built once. `settings`: mission, site, control; its vessel is unused."""
    mine = replace(settings, vessel=belief.vessel)
    pilot = Pilot(mine)
    nmpc = Nmpc(belief.model, Actuation.of(belief.vessel), mine.nmpc, time.perf_counter, mine.fence, compile_loops)
    for seed in seeds:
        setup = WorldSetup(true, settings.site, start=start_of(seed), weather=weather or Weather())
        run = SteppedRun(World(setup, seed), pilot, nmpc.solve)
        run.run(lambda run: run.state.guidance.phase in ("station", "done"), limit_s)
        yield seed, run


def _scored(run: SteppedRun, name: str, seed: int) -> Driven:
    """The scores of one mission."""
    track = track_of(run.of(StateEstimate), run.of(GuidanceReference), run.of(GroundTruth))
    points = np.array(run.pilot.settings.mission.path.points)
    along = tracking(track, points)
    leases = [m for m in run.of(OverrideLease) if m.source != "neutral"]
    return Driven(
        belief=name,
        seed=seed,
        cross_track_rms_m=along["cross_track_rms_m"],
        surge_rms_error_m_s=along["surge_rms_error_m_s"],
        overshoot_m=along["overshoot_m"],
        position_rmse_m=estimation(track)["position_rmse_m"] if len(track.t_s) else math.nan,
        missed=len(points) - len(run.state.guidance.passed),
        plans=sum(m.source == "plan" for m in leases) / max(1, len(leases)),
        seconds=run.world.t_ns * 1e-9,
    )
