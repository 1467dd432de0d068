"""Which file to believe: each predicts a manoeuvre that no fit has seen; and how a mission went by the boat's estimate.

error of a file = relative error of its open-loop predictions (`sim.fitting.identify.verdict`),
                  the day's current and wind given to all files alike
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.core.messages import GuidanceReference, StateEstimate
from companion.logs.log_file import LogFile
from companion.logs.runs.apply_sensor_errors import calibrated
from companion.logs.runs.run import Run
from companion.logs.runs.splits import HeldOut
from sim.fitting.engine.smoothing import SmootherNoise
from sim.fitting.identify.result import FitResult
from sim.fitting.identify.verdict import relative_error
from sim.fitting.identify.vessel_out import in_surroundings
from sim.fitting.validate.models import VesselSimulator
from sim.fitting.validate.study import validate
from sim.world.score import track_of, tracking

HORIZON_S, STRIDE_S = 20.0, 2.0
LEAST_S = HORIZON_S + 4 * STRIDE_S
"""Of manoeuvres that prove anything: five whole horizons; assumed. A boat at rest is foretold by any file."""
BETTER = 0.9
"""A file takes the place of another from this ratio of their errors on; assumed: on one flight less is chance. With
0.97 a false cause (centre of gravity) gained 7 % on the proof, and the mission was driven worse."""


@dataclass(frozen=True)
class Proof:
    """Errors of the files by name, and the name of the one to believe."""

    errors: Mapping[str, float]
    best: str


def proof(files: Mapping[str, VesselFile], run: Run, fit: FitResult, measured_by: VesselFile) -> Proof:
    """Judge `files` on the run; the first is believed until another is better. ValueError: too short a run.

    `measured_by`: the file whose sensors are taken to have measured the run, for all of them: no file judges itself.
    """
    changed_s = run.commands()[0][1:]  # after those that it began with
    flown_s = float(np.ptp(changed_s)) if len(changed_s) else 0.0
    if flown_s < LEAST_S:
        raise ValueError(
            f"its manoeuvres last {flown_s:.0f} s, and {LEAST_S:g} s are needed: take a --library with a longer "
            "zig-zag and multisine, remove that folder and give the same command again"
        )
    models = [VesselSimulator(name, in_surroundings(vessel, fit)) for name, vessel in files.items()]
    held_out, noise = [HeldOut(calibrated(run, measured_by))], SmootherNoise.of(measured_by)
    found = validate(models, held_out, measured_by, noise, horizon_s=HORIZON_S, stride_s=STRIDE_S)
    errors = {one.name: relative_error(one, found.scores) for one in found.scores[: len(files)]}
    best = next(iter(errors))
    for name, error in errors.items():
        best = name if error < BETTER * errors[best] else best
    return Proof(errors, best)


def driven(log: Path, points: Sequence[tuple[float, float]]) -> float:
    """Cross-track error of a mission, rms over the straight parts of its legs, by the boat's own estimate [m]."""
    estimates: list[StateEstimate] = []
    references: list[GuidanceReference] = []
    for message in LogFile(log).messages(StateEstimate, GuidanceReference):
        if isinstance(message, StateEstimate):
            estimates.append(message)
        elif isinstance(message, GuidanceReference):
            references.append(message)
    if not estimates or not any(r.phase != "idle" for r in references):
        return float("nan")
    return tracking(track_of(estimates, references, estimates), np.array(points))["cross_track_rms_m"]
