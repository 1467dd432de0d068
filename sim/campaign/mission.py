"""One mission on the stepped clock, and its figures against the truth."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from companion.boat.load_run import RunSetup, setup_of
from companion.core.control.nmpc import Nmpc
from companion.core.messages import GroundTruth, GuidanceReference, OverrideLease, StateEstimate, Tick
from companion.core.pilot.pilot import Pilot, PilotSettings
from sim.campaign.case_files import CaseSetup, check_start
from sim.campaign.file import Missions
from sim.campaign.runners.job import Figure
from sim.world.score import TrueTrack, end_heading, estimation, station, track_of, tracking
from sim.world.stepped import SteppedRun
from sim.world.stepped_controller import stepped_controller
from sim.world.world import World, WorldSetup

KEPT = 2
"""Boats whose compiled pilot and NMPC a worker keeps; they take some 100 MB each; assumed."""
JUDGED = ("cross_track_rms_m", "surge_rms_error_m_s", "overshoot_m", "position_rmse_m", "u_rmse_m_s", "v_rmse_m_s",
              "velocity_rmse_m_s", "heading_rmse_deg", "nees", "station_error_m", "station_error_deg")  # fmt: skip


def mission_figures(case: CaseSetup, settings: Missions, seed: int) -> dict[str, Figure]:
    """Drive it; what came of it. Figures that cannot be said (it never drove, it has no straight part) are None."""
    assert case.setup is not None, "missions come with a run file"
    check_start(case.setup.pilot.site, case.world)
    mind, nmpc = _mind(tuple(sorted(case.setup.files.items())))
    start = (case.world.north_m, case.world.east_m, math.radians(case.world.psi_deg))
    world = WorldSetup(
        case.truth,
        case.setup.pilot.site,
        start=start,
        weather=case.weather,
        mismatch=case.world.mismatch,
        faults=case.faults,
        voltage_v=case.world.voltage_v,
        drift_ppm=case.world.drift_ppm,
    )
    run = SteppedRun(World(world, seed), mind, nmpc.solve)

    def settled(run: SteppedRun) -> bool:
        since = run.state.guidance.settled_ns
        if run.state.guidance.phase != "done" or since is None:
            return False
        return run.world.t_ns - since > settings.station_s * 1e9

    finished = run.run(settled, settings.limit_s)
    return {"finished": finished, **_scored(run, case.setup, settings.station_s if finished else None)}


def _scored(run: SteppedRun, setup: RunSetup, station_s: float | None) -> dict[str, Figure]:
    passed = len(run.state.guidance.passed)
    leases = run.of(OverrideLease)
    driven = [lease for lease in leases if lease.source != "neutral"]
    track = track_of(run.of(StateEstimate), run.of(GuidanceReference), run.of(GroundTruth))
    out: dict[str, Figure] = {
        "waypoints_missed": len(setup.pilot.mission.path.points) - passed,
        "unleased": unleased([m.index for m in run.of(Tick)], [m.index for m in leases]),
        "mode": run.state.helm.mode,
        "simulated_s": run.world.t_ns * 1e-9,
        "plan_share": sum(lease.source == "plan" for lease in driven) / len(driven) if driven else None,
    }
    return out | judged(track, setup.pilot, station_s)


def unleased(ticks: list[int], leases: list[int]) -> bool:
    """Whether a tick did not end in exactly one lease; the last may still be open."""
    return leases != ticks[: len(leases)] or len(ticks) - len(leases) > 1


def judged(track: TrueTrack, settings: PilotSettings, station_s: float | None) -> dict[str, Figure]:
    """Tracking, station over the last `station_s` (None: it never came to it; boats that drift keep none), estimate."""
    if not len(track.t_s):
        return dict.fromkeys(("farthest_m", *JUDGED))
    points = np.array(settings.mission.path.points)
    away = np.linalg.norm(track.truth[:, None, :2] - points, axis=2).min(axis=0)
    known: Mapping[str, float] = tracking(track, points) | estimation(track)
    if station_s is not None and settings.guidance.end == "station":
        known = known | station(track, (*points[-1], end_heading(settings.mission)), station_s)
    figures: dict[str, Figure] = {"farthest_m": float(away.max())}
    return figures | {name: known.get(name) for name in JUDGED}


@lru_cache(KEPT)
def _mind(files: tuple[tuple[str, str], ...]) -> tuple[Pilot, Nmpc]:
    """Pilot and NMPC of a setup: compiled once in each worker, machine code kept on disk."""
    settings = setup_of(dict(files), {name: name for name, _ in files}).pilot
    return Pilot(settings), stepped_controller(settings)
