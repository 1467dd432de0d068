"""Benefit of a diagnosis in closed loop: missions of the true boat with the vessel file as it was, refitted, extended.

    true boat -> two teleoperation logs -> diagnose -> vessel files, written and loaded -> missions on the stepped clock

The plant is the true boat; filter, guidance, NMPC and allocation use one of the vessel files. The same seed gives the
same start, sensor noise and weather for every file. The estimator's error as one number: each rms over its goal,

    E = sqrt(mean[(p / 0.10 m)^2, (u / 0.05 m/s)^2, (v / 0.05 m/s)^2, (psi / 2 deg)^2])
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace

from companion.core.configuration.vessel_file import VesselFile
from companion.core.messages import GroundTruth, GuidanceReference, StateEstimate
from companion.core.model.load_vessel import load_vessel
from companion.core.model.vessel_text import vessel_toml
from companion.core.pilot.pilot import PilotSettings
from companion.logs.runs.run import Run
from sim.fitting.diagnose.job import Diagnosis, diagnose
from sim.studies.boats.draw import TICK_S
from sim.studies.driving.identified import LIMIT_S, BelievedModel, driven_runs
from sim.world.plant import perturbed
from sim.world.score import TrueTrack, estimation, track_of, tracking
from sim.world.stepped import SteppedRun

LOG_S = 300.0
GOALS = {"position_rmse_m": 0.10, "u_rmse_m_s": 0.05, "v_rmse_m_s": 0.05, "heading_rmse_deg": 2.0}
"""Of the main job."""
TRUTH = "true_"
NEAR_M = 1.0
"""The true boat has passed a waypoint if it came this near: twice the mission's circle. The estimate does not count:
with dead thrusters a boat's own estimate passes them all.
"""


@dataclass(frozen=True)
class Trip:
    """One mission. NaN: the boat never got under way.

    cross_track_rms_m  finished: on the straight parts of the legs; else distance to the present leg, over the whole run
    rmse               estimation errors over the whole run, keys of `GOALS`
    missed             number of waypoints that the true boat did not pass
    """

    belief: str
    seed: int
    cross_track_rms_m: float
    rmse: Mapping[str, float]
    missed: int
    seconds: float

    @property
    def finished(self) -> bool:
        """Whether the true boat passed all waypoints in time."""
        return self.missed == 0

    @property
    def estimator_error(self) -> float:
        """E of the module docstring; 1 where every goal is just met."""
        return float(np.sqrt(np.mean([(self.rmse[k] / goal) ** 2 for k, goal in GOALS.items()])))


@dataclass(frozen=True)
class DiagnosedBoat:
    """Result of a diagnosis of the true boat's logs: vessel files by name, written and loaded again."""

    verdict: str
    named: tuple[str, ...]
    not_in_file: Mapping[str, str]
    vessels: Mapping[str, VesselFile]


def imperfect(vessel: VesselFile, rng: np.random.Generator) -> VesselFile:
    """A boat like `vessel` with small deviations, each within half of the smallest size that a diagnosis names.

    Inertia, damping, gains: 2 % (uniform); dead time, lag, latency: 10 ms; tag: 1 cm; heading: 0.2 deg. The IMU was
    calibrated before each run: its biases are drawn with sigmas of 0.01 m/s^2 and 0.001 rad/s. All assumed.
    """
    boat = perturbed(vessel, rng, 0.02)
    dead, lag, late, ahead, aside, turn = (float(s) for s in rng.uniform(-1.0, 1.0, 6))
    propulsion, imu, uwb = boat.propulsion, boat.sensors.imu, boat.sensors.tag
    delay_s = round((propulsion.dead_time_s + 0.01 * dead) / TICK_S) * TICK_S
    propulsion = replace(propulsion, dead_time_s=max(delay_s, 0.0), lag_s=max(propulsion.lag_s + 0.01 * lag, TICK_S))
    imu = replace(
        imu,
        heading_offset_rad=imu.heading_offset_rad + math.radians(0.2 * turn),
        accel_bias_sigma_m_s2=0.01,
        gyro_bias_sigma_rad_s=0.001,
    )
    uwb = replace(uwb, latency_s=max(uwb.latency_s + 0.01 * late, 0.0), x_m=uwb.x_m + 0.01 * ahead,
                  y_m=uwb.y_m + 0.01 * aside)  # fmt: skip
    return replace(boat, propulsion=propulsion, sensors=replace(boat.sensors, imu=imu, uwb=uwb))


def mended(logs: Sequence[Run], base: VesselFile, say: Callable[[str], None] = lambda _: None) -> DiagnosedBoat:
    """Diagnose the logs with `base`; its vessel files `base`, `refitted`, `extended` as a user would load them."""
    found: Diagnosis = diagnose(logs, base, say=lambda step, text, share: say(f"{step} {text} {100 * share:.0f} %"))
    files = {"refitted": found.files.refitted, "extended": found.files.extended}
    loaded = {name: load_vessel(vessel_toml(vessel), name=f"{name}.toml") for name, vessel in files.items()}
    names = tuple(n.effect.name for n in found.causes)
    return DiagnosedBoat(str(found.verdict), names, found.files.not_in_file, {"base": base, **loaded})


def trips(
    true: VesselFile,
    believed: VesselFile,
    settings: PilotSettings,
    seeds: Sequence[int],
    *,
    name: str = "",
    limit_s: float = LIMIT_S,
) -> list[Trip]:
    """Missions of the true boat, one a seed, by a pilot with the vessel file `believed`; `settings`: all else."""
    runs = driven_runs(true, BelievedModel(name, believed), settings, seeds, limit_s=limit_s)
    return [_scored(run, name, seed) for seed, run in runs]


def _scored(run: SteppedRun, name: str, seed: int) -> Trip:
    """The scores of one mission."""
    track = track_of(run.of(StateEstimate), run.of(GuidanceReference), run.of(GroundTruth))
    points = np.array(run.pilot.settings.mission.path.points)
    missed = int((away_m(track, points) > NEAR_M).sum())
    cross = off_leg_m(track, points) if missed else tracking(track, points)["cross_track_rms_m"]
    known = estimation(track) if len(track.t_s) else {}
    rmse = {k: known.get(k, math.nan) for k in GOALS}
    return Trip(name, seed, cross, rmse, missed, run.world.t_ns * 1e-9)


def away_m(track: TrueTrack, points: np.ndarray) -> np.ndarray:
    """Least distance of the true boat to each waypoint [m], (k,); infinite where it never got under way."""
    return np.linalg.norm(track.truth[:, None, :2] - points, axis=2).min(axis=0, initial=math.inf)


def off_leg_m(track: TrueTrack, points: np.ndarray) -> float:
    """Rms distance [m] of the true boat from its present leg, a line segment; the first begins at the start."""
    if not track.on_leg.any():
        return math.nan
    ends = np.vstack([track.truth[:1, :2], points])
    start, end = ends[track.leg[track.on_leg] + 1], ends[track.leg[track.on_leg] + 2]
    along, away = end - start, track.truth[track.on_leg, :2] - start
    share = np.clip((along * away).sum(axis=1) / (along**2).sum(axis=1), 0.0, 1.0)
    return float(np.sqrt(((away - share[:, None] * along) ** 2).sum(axis=1).mean()))


def pooled(found: Sequence[Trip]) -> dict[str, float]:
    """Rms over missions: `cross_track_rms_m`, `estimator_error` and the keys of `GOALS`."""

    def rms(values: Sequence[float]) -> float:
        return float(np.sqrt(np.mean(np.square(values))))

    return {
        "cross_track_rms_m": rms([t.cross_track_rms_m for t in found]),
        "estimator_error": rms([t.estimator_error for t in found]),
        **{k: rms([t.rmse[k] for t in found]) for k in GOALS},
    }
