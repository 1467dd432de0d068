"""The boat with GNSS and no UWB in its lake, on the stepped clock: with RTK as shipped, or with a plain receiver."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import msgspec
import numpy as np
from scipy.stats import chi2

from companion.boat.load_run import EXAMPLES, load_setup
from companion.core.control.nmpc import Actuation, Nmpc
from companion.core.geometry.frames import ssa
from companion.core.messages import Alert, GroundTruth, GuidanceReference, StateEstimate
from companion.core.model.manoeuvring import StructuredModel
from companion.core.pilot.pilot import Pilot, PilotSettings
from companion.jit import compile_loops
from sim.world.environment import Weather
from sim.world.score import TrueTrack, track_of, tracking
from sim.world.stepped import SteppedRun
from sim.world.world import World, WorldSetup

START = (8.0, 8.0, float(np.deg2rad(20.0)))
LIMIT_S = 260.0
ROUGH = {"weather": Weather(V_c_m_s=0.1, beta_c_deg=70.0, V_w_m_s=3.0, beta_w_deg=200.0, gustiness=0.2),
         "mismatch": 0.1}  # fmt: skip
PLAIN = {"position_sigma_m": 0.1, "position_wander_sigma_m": 1.5, "position_wander_time_s": 120.0, "fix": "3d"}
"""The comment of deploy/boats/lake.toml."""
PLAIN_ACCEPTANCE_M = 3.0


@cache
def lake(*, plain: bool) -> PilotSettings:
    """What `deploy/lake.toml` configures; plain: the other receiver, and waypoints that it can pass."""
    settings = load_setup(EXAMPLES / "lake.toml").pilot
    if not plain:
        return settings
    sensors = msgspec.structs.replace(
        settings.vessel.sensors, gnss=msgspec.structs.replace(settings.vessel.sensors.gnss, **PLAIN)
    )
    wide = tuple(replace(w, acceptance_m=PLAIN_ACCEPTANCE_M) for w in settings.mission.path.waypoints)
    mission = replace(settings.mission, path=replace(settings.mission.path, waypoints=wide))
    return replace(settings, vessel=msgspec.structs.replace(settings.vessel, sensors=sensors), mission=mission)


@cache
def controller(*, plain: bool) -> tuple[Pilot, Nmpc]:
    """Pilot and NMPC without wall time."""
    settings = lake(plain=plain)
    patient = msgspec.structs.replace(settings.nmpc, rescue_time_s=60.0)
    model, actuation = StructuredModel.of(settings.vessel), Actuation.of(settings.vessel)
    return Pilot(settings), Nmpc(model, actuation, patient, lambda: 0.0, settings.fence, compile_loops)


def lake_voyage(seed: int, *, plain: bool = False, **world) -> SteppedRun:
    """A run about to begin; `world`: fields of WorldSetup."""
    settings, (pilot, nmpc) = lake(plain=plain), controller(plain=plain)
    chosen = WorldSetup(settings.vessel, settings.site, **{"start": START, **world})
    return SteppedRun(World(chosen, seed), pilot, nmpc.solve)


def arrived(run: SteppedRun) -> bool:
    """On station for 3 s."""
    guided = run.state.guidance
    return guided.phase == "done" and guided.settled_ns is not None and run.world.t_ns - guided.settled_ns > 3e9


def alarms(run: SteppedRun) -> list[str]:
    """Texts of warnings and errors."""
    return [m.text for m in run.of(Alert) if m.level != "info"]


def lake_track(run: SteppedRun) -> TrueTrack:
    """Estimate and truth, tick by tick."""
    return track_of(run.of(StateEstimate), run.of(GuidanceReference), run.of(GroundTruth))


def lake_figures(run: SteppedRun) -> dict[str, float]:
    """Cross-track error against the truth, error of the position, mean NEES of pose and of velocity (3 each)."""
    track = lake_track(run)
    error = track.estimate - track.truth
    error[:, 2] = [ssa(float(e)) for e in error[:, 2]]
    points = np.array(run.pilot.settings.mission.path.points)
    position = float(np.sqrt((error[:, :2] ** 2).sum(axis=1).mean()))
    return {
        "cross_track_rms_m": tracking(track, points)["cross_track_rms_m"],
        "position_rmse_m": position,
        "nees_pose": nees(error, track.P, slice(0, 3)),
        "nees_velocity": nees(error, track.P, slice(3, 6)),
    }


def nees(error: np.ndarray, P: np.ndarray, part: slice) -> float:
    """Mean normalised estimation error squared of some states."""
    e = error[:, part]
    return float(np.einsum("ki,ki->k", e, np.linalg.solve(P[:, part, part], e[:, :, None])[:, :, 0]).mean())


def nees_band(seeds: int, dof: int = 3) -> tuple[float, float]:
    """95 % band of the mean NEES over runs, each run counted as one sample: its errors last as long as it does."""
    low, high = chi2.ppf([0.025, 0.975], dof * seeds) / seeds
    return float(low), float(high)
