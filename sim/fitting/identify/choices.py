"""Every choice that an identification rests on, as text: what, its value, and where it was made.

None is made on held-out data. The fit chooses window, noise and latent acceleration on the fitted parts; everything
else is stated in the code or on the command line before a log is opened.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

from sim.fitting.engine.smoothing import RATE_HZ
from sim.fitting.engine.split import LEAST_FIT_S
from sim.fitting.identify.job import SMOOTHER, Choices, Identification
from sim.fitting.identify.result import COLOURED, UNDETERMINED
from sim.fitting.identify.structured_fit import WINDOWS_S
from sim.fitting.identify.trials import NO_WORSE, WORTH
from sim.fitting.identify.verdict import JUDGED_S, SAME
from sim.fitting.identify.white_noise import FACTORS
from sim.fitting.taylor.lanczos import CUTOFF_HZ, HALF_WIDTH_S
from sim.fitting.taylor.regression import HAC_S
from sim.fitting.taylor.sindy import THRESHOLD
from sim.fitting.validate.protocol import STEP_S
from sim.fitting.validate.scores import SPREAD

BEFORE, USER, FITTED = "beforehand", "command line", "fitted parts"


@dataclass(frozen=True)
class Choice:
    """One choice. `made`: beforehand (code or vessel file), on the command line, or from the fitted parts."""

    what: str
    value: str
    made: str


def choices(identification: Identification) -> list[Choice]:
    """All choices of an identification, in the order of the report."""
    return [Choice(*row) for rows in (_data, _series, _structured, _judging) for row in rows(identification)]


def _data(identification: Identification) -> Iterator[tuple[str, str, str]]:
    """Choices on data and sensor noise."""
    chosen = identification.choices
    own = chosen.block_s is not None or any(not u.fitted_s for u in identification.split.used)
    yield "held out", identification.split.rule, USER if own else BEFORE
    yield "least length of what is fitted", f"{LEAST_FIT_S:g} s", BEFORE
    n = identification.noise
    yield (
        "noise of the sensors (smoothing, regressions, reference on held-out logs)",
        f"vessel file: position {n.position_m:g} m, heading {n.psi_rad:g} rad, yaw rate {n.r_rad_s:g} rad/s, "
        f"acceleration {n.accel_m_s2:g} m/s2; tag at {n.tag_arm_m[0]:g}, {n.tag_arm_m[1]:g} m, {n.latency_s:g} s late",
        BEFORE,
    )
    yield "how fast accelerations wander (smoother)", f"{n.jerk:g} m/s^2.5, {n.yaw_jerk:g} rad/s^2.5", BEFORE
    yield "seed", str(chosen.seed), USER if chosen.seed != Choices().seed else BEFORE


def _series(identification: Identification) -> Iterator[tuple[str, str, str]]:
    """Choices on the regressions."""
    if identification.series:
        yield (
            "samples of the regressions",
            f"{RATE_HZ:g} Hz, by {', and by '.join(s.pipeline for s in identification.series)}",
            BEFORE,
        )
        yield "Lanczos low-pass", f"cut-off {CUTOFF_HZ:g} Hz, half width {HALF_WIDTH_S:g} s", BEFORE
        yield "forces of the series", "thruster map and battery voltage as in the vessel file, acting at once", BEFORE
    if identification.series:
        yield "Taylor series", f"least squares, all terms; errors count as correlated over {HAC_S:g} s", BEFORE
    if identification.peer is not None:
        yield "pysindy", f"STLSQ, threshold {THRESHOLD:g}, on {SMOOTHER}'s speeds, its own differences", USER


def _structured(identification: Identification) -> Iterator[tuple[str, str, str]]:
    """Choices on the structured fit."""
    s, settings = identification.structured, identification.choices.settings
    windows = ", then ".join(f"{w:g}" for w in WINDOWS_S)
    chosen = "default" if settings.horizon_s is None else f"{settings.horizon_s:g} s"
    if s.horizon_s:
        yield (
            "structured fit",
            f"multi-step output error over {s.horizon_s:g} s: {identification.chosen.why}",
            FITTED,
        )
    else:
        yield (
            "window of the structured fit",
            f"{s.window_s:g} s (tried: {windows} s, if residuals are not white)",
            FITTED,
        )
    yield "refinements of the model", ", ".join(identification.chosen.refinements) or "none", FITTED
    tried = f"in trials on halves of the logs, it gains {100 * WORTH:g} % and neither half loses {100 * NO_WORSE:g} %"
    yield "a refinement is kept", f"where, {tried}", BEFORE
    yield "multi-step output error", f"where it predicts better by {100 * NO_WORSE:g} %; horizon: {chosen}", BEFORE
    sigmas = ", ".join(f"{f.name} {getattr(settings.sigmas, f.name):g}" for f in fields(settings.sigmas))
    yield "prior", f"centred on the vessel file; sigma (shares where positive): {sigmas}", BEFORE
    low, high = FACTORS
    sigmas_text = ", ".join(f"{c.name} {c.sigma:.3g}" for c in s.channels)
    yield "white noise of the structured fit", f"{sigmas_text}; {low:g} to {high:g} times the file's allowed", FITTED
    x, y, n = s.latent
    yield "latent acceleration", f"{x:.2g} m/s2, {y:.2g} m/s2, {n:.2g} rad/s2, by the evidence", FITTED
    yield "correlation time of the latent acceleration", f"{settings.latent_time_s:g} s", BEFORE
    yield "undetermined", f"a parameter that keeps more than {100 * UNDETERMINED:g} % of its prior sigma", BEFORE
    yield "residuals not white", f"correlation of neighbours beyond {COLOURED:g} (and its scatter)", BEFORE


def _judging(identification: Identification) -> Iterator[tuple[str, str, str]]:
    """Choices on the judgement."""
    judged = " and ".join(map(str, JUDGED_S))
    yield "open-loop runs", "one begins every 5 s, lasts up to 60 s, 10 s at least", BEFORE
    yield "commands of open-loop runs", f"sampled every {1000 * STEP_S:g} ms", BEFORE
    yield "judged by", f"rms error of five channels at {judged} s over that of the better baseline", BEFORE
    yield "counts as equal", f"relative errors within {100 * (SAME - 1):.0f} %", BEFORE
    yield "diverged", f"outside {SPREAD:g} times the range of speeds in the fitted parts, or not finite", BEFORE
