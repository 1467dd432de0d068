"""Do logged roll and pitch level the accelerometers, or follow the boat's own acceleration?

An AHRS without GPS takes part of the specific force for gravity (observed on ArduPilot's: 0.7 degrees). Levelled by
it, the accelerometers lose just what they should show. Beside the refitted base the share of the logged tilt that is no
tilt is estimated in one step, with lean and scale as free as in logs without roll and pitch:

    a_levelled = a (1 + scale) + lean - share g sin(tilt)
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from companion.logs.runs.run import LogProblem, Run
from sim.fitting.diagnose.catalogue.effect import parameter_slices
from sim.fitting.diagnose.catalogue.sensors import accelerometers, false_tilt
from sim.fitting.diagnose.posterior.evidence import Prior
from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.selection.model import CandidateModel
from sim.fitting.engine.noise import Noise
from sim.fitting.engine.windows import reads_lean

TILT = ("phi_rad", "theta_rad")
"""Columns that level accelerometers."""
FALSE_SHARE, SURE = 0.3, 15.0
"""Least share on both axes, and over its standard error, from which roll and pitch are left out; assumed. The noise of
a sound attitude is no tilt either, but small."""


def without_tilt(run: Run) -> Run:
    """The run without roll and pitch."""
    return Run(run.table.drop(TILT, strict=False), run.meta, run.whole)


def tilt_is_false(fit: PosteriorFit, base: CandidateModel, stated: Noise) -> bool:
    """Whether roll and pitch of the logs of `fit` follow the acceleration, at the refitted `base`.

    `stated`: noise of the accelerometers as the file has it, for what is asked here enlarges their residuals.
    """
    level = fit.physics.windows.level
    if not level.any():
        return False
    tested = (*accelerometers(fit.physics.vessel, levelled=False), *false_tilt())
    ids = {e.id for e in tested}
    free = [*(e for e in base.free if e.id not in ids), *tested]
    fit.noise = replace(base.noise, white=(*base.noise.white[:2], *stated.white[2:]))
    theta = {k: v for k, v in base.point.theta.items() if k not in ids}
    reduced = fit.reduced(fit.point(theta, base.point.z, free, base.point).without_columns(), free)
    posterior, at = (
        reduced.posterior(Prior(fit.prior(free, frozenset()).sigma, np.zeros(len(reduced.b)))),
        parameter_slices(free),
    )
    shares = [
        (posterior.values[at[e.id]][0], posterior.covariance[at[e.id], at[e.id]][0, 0] ** 0.5) for e in false_tilt()
    ]
    return all(value > FALSE_SHARE and value > SURE * se for value, se in shares)


def tilt_problems(run: Run, found_false: bool) -> list[LogProblem]:
    """What to tell of a log without roll and pitch, or whose roll and pitch were `found_false`."""
    if found_false:
        why = "roll and pitch follow the boat's own acceleration, as of an AHRS without GPS; they are left out, and"
    elif not reads_lean(run):
        return []
    else:
        why = "no roll and pitch: log phi_rad and theta_rad if you can; without them"
    return [LogProblem(kind="disagree" if found_false else "missing", text=f"{why} accelerometers count for little")]
