"""A whole validation: every score of several models on held-out runs, as tables, pictures and report show them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.apply_sensor_errors import calibrated
from companion.logs.runs.run import LogProblem
from companion.logs.runs.splits import HeldOut
from sim.fitting.engine.smoothing import SmootherNoise
from sim.fitting.engine.split import JobError, LogUse, NamedLog, Split
from sim.fitting.validate.models import ConstantVelocity, ZeroVelocity
from sim.fitting.validate.protocol import Simulator
from sim.fitting.validate.scores import Score, SpeedBox, score
from sim.fitting.validate.stability import Stability, stability
from sim.fitting.validate.windows import (
    SHORTEST_S,
    HeldOutWindows,
    Reference,
    concatenated,
    cut_held_out,
    reference_motion,
)

NOT_JUDGED = "not judged"
"""Kind of the problem that nothing of what was to be held out of a log can be judged."""
BASELINES = (ConstantVelocity(), ZeroVelocity())
BASELINE_NAMES = tuple(model.name for model in BASELINES)


def judgeable(division: Split, vessel: VesselFile) -> Split:
    """`division` without what was held out but holds no window to judge models by; such logs are noted.

    Asked before any fit, which takes minutes. JobError where nothing is left to judge by.
    """
    outs, used, held_out = iter(division.held_out), [], []
    why: list[str] = []
    for use in division.used:
        out = next(outs) if use.held_out_s else None
        if out is None:
            used.append(use)
        elif not (reason := _unjudgeable(out, vessel)):
            used.append(use)
            held_out.append(out)
        else:
            why.append(f"{use.log.name}: {reason}")
            note = LogProblem(kind=NOT_JUDGED, text=f"{reason}; left out")
            used.append(LogUse(NamedLog(use.log.name, use.log.run.with_notes([note])), use.fitted_s, ()))
    if not held_out:
        raise JobError(f"{why[0]}. Hold out another log (--held-out), or other parts (--block)")
    return replace(division, held_out=tuple(held_out), used=tuple(used))


def _unjudgeable(out: HeldOut, vessel: VesselFile) -> str:
    """Why no window can be cut from what is held out, in words; empty where one can."""
    run, volts = calibrated(out.run, vessel), vessel.propulsion.nominal_voltage_V
    try:
        cut_held_out(
            run, reference_motion(run, SmootherNoise.of(vessel)), volts, horizon_s=SHORTEST_S, inside=out.inside
        )
    except ValueError as error:
        return str(error).removeprefix(f"{run.meta.source}: ")
    return ""


@dataclass(frozen=True)
class Validation:
    """Scores, stabilities and states (m, k, 6) in the order of the models, baselines last.

    held_out, references  runs that the windows were cut from, and their reference motions
    box                   speeds in the training data
    """

    vessel: str
    held_out: tuple[HeldOut, ...]
    references: tuple[Reference, ...]
    windows: HeldOutWindows
    box: SpeedBox
    scores: tuple[Score, ...]
    stabilities: tuple[Stability, ...]
    states: tuple[np.ndarray, ...]


def validate(
    models: Sequence[Simulator],
    held_out: Sequence[HeldOut],
    vessel: VesselFile,
    noise: SmootherNoise,
    *,
    box: SpeedBox | None = None,
    horizon_s: float = 60.0,
    stride_s: float = 5.0,
    seed: int = 0,
    say: Callable[[str, float], None] = lambda _text, _share: None,
) -> Validation:
    """Score `models` and both baselines on windows of `horizon_s`, one every `stride_s`.

    box    speeds in the training data; None: those of the held-out runs
    seed   of the stability test
    say    called with progress: text, share

    ValueError where a run is too short for a window, or where two models share a name.
    """
    contestants = [*models, *BASELINES]
    if len({model.name for model in contestants}) < len(contestants):
        raise ValueError("every model needs a name of its own")
    volts = vessel.propulsion.nominal_voltage_V
    say("what the boat did", 0.0)
    references = tuple(reference_motion(part.run, noise) for part in held_out)
    pairs = list(zip(held_out, references, strict=True))
    cuts = [
        cut_held_out(p.run, ref, volts, horizon_s=horizon_s, stride_s=stride_s, inside=p.inside) for p, ref in pairs
    ]
    seconds = [
        cut_held_out(p.run, ref, volts, horizon_s=1.0, stride_s=1.0, shortest_s=1.0, inside=p.inside)
        for p, ref in pairs
    ]
    windows, second_windows = concatenated(cuts), concatenated(seconds)
    box = box or SpeedBox.of(windows.truth[..., 3:])
    scored, stabilities = [], []
    for i, model in enumerate(contestants):
        say(model.name, 0.2 + 0.8 * i / len(contestants))
        scored.append(score(model, windows, box, second_windows))
        stabilities.append(stability(model, vessel, box, seed))
    return Validation(
        vessel=vessel.name,
        held_out=tuple(held_out),
        references=references,
        windows=windows,
        box=box,
        scores=tuple(one for one, _ in scored),
        stabilities=tuple(stabilities),
        states=tuple(states for _, states in scored),
    )
