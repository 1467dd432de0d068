"""Tables of the report on an identification: parameters, Taylor coefficients, residuals, logs, choices."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.problems import grouped
from companion.logs.runs.splits import Interval
from sim.fitting.engine.parameters import file_values
from sim.fitting.identify.choices import choices
from sim.fitting.identify.job import Identification, Taylor
from sim.fitting.identify.plausible import bands, without_dimension
from sim.fitting.identify.result import UNDETERMINED, FitResult
from sim.fitting.identify.structured_fit import FitSettings
from sim.fitting.identify.verdict import NAMES, judged_horizons
from sim.fitting.taylor.abkowitz_table import TERMS
from sim.fitting.taylor.taylor_file import AXES
from sim.fitting.validate.protocol import CHANNELS
from sim.fitting.validate.study import BASELINE_NAMES, Validation
from sim.fitting.validate.table import ScoreTable, error_rows, stability_rows, white_rows


def parameter_table(result: FitResult, model: VesselFile, settings: FitSettings) -> ScoreTable:
    """Value, interval, what the file believed, what such a hull can have, how much of the belief is left.

    `settings`: those of the fit.
    """
    allowed = bands(model)
    before = file_values(model, settings.surroundings, settings.unmeasured_imu)
    rows = []
    for p, believed in zip(result.parameters, before, strict=True):
        band, prime = allowed.get(p.name), without_dimension(p.name, p.value, model)
        outside = band is not None and not band[0] <= p.value <= band[1]
        share = f"{100 * min(p.share_of_prior, 1.0):.0f} %"
        rows.append(
            (
                p.name,
                _digits(p.value),
                f"{_digits(p.ci95[0])} to {_digits(p.ci95[1])}",
                p.unit,
                _digits(believed),
                ("**{}**" if outside else "{}").format(band_text(band)) if band else "",
                "" if prime is None else _digits(prime),
                share,
                "held at the file's value" if p.name in result.held else "yes" if p.determined else "**no**",
            )
        )
    head = (
        "parameter",
        "value",
        "95 % interval",
        "unit",
        "first guess",
        "such a hull has",
        "without dimension",
        "prior sigma left",
        "determined",
    )
    return ScoreTable(head, tuple(rows))


def band_text(band: tuple[float, float]) -> str:
    """Ends with two digits, without an exponent: 40 to 220."""
    return " to ".join(f"{float(f'{end:.2g}'):g}" for end in band)


def _digits(value: float) -> str:
    return f"{value:.4g}" if abs(value) >= 1e-3 else f"{value:.1e}" if value else "0"


def taylor_table(taylor: Taylor) -> ScoreTable:
    """Like the paper's Table 2: coefficient and standard error by axis, variance inflation. *: see `taylor_lines`."""
    fit = taylor.fit
    rows = []
    for j, term in enumerate(TERMS):
        cells = []
        for i in range(len(AXES)):
            star = " *" if abs(taylor.shift[i, j]) > fit.se_robust[i, j] else ""
            cell = f"{fit.C[i, j]:+.4f} ± {fit.se_robust[i, j]:.4f}{star}"
            cells.append(cell if fit.determined[i, j] else "**open**")
        vif = f"{fit.vif[j]:.1f}" if np.isfinite(fit.vif[j]) else "-"
        rows.append((f"C_{term}", *cells, vif))
    return ScoreTable(("term", *AXES, "VIF"), tuple(rows))


def taylor_lines(taylor: Taylor) -> list[str]:
    """What the regression says of itself."""
    fit, moved = taylor.fit, np.abs(taylor.shift) > taylor.fit.se_robust
    weak = (np.abs(fit.C) < 1.96 * fit.se_robust) & fit.determined
    high = [TERMS[j] for j in np.flatnonzero(np.nan_to_num(fit.vif) > 10)]
    r2_text = ", ".join(f"{axis} {r2:.3f}" for axis, r2 in zip(AXES, fit.r2, strict=True))
    return [
        f"{fit.n} samples by {taylor.pipeline}; rank {fit.rank} of {len(TERMS)}, condition {fit.condition:.3g} "
        f"({fit.condition_scaled:.3g} with columns of equal size). R2 of the accelerations: {r2_text}.",
        f"Of {fit.C.size} coefficients {int(weak.sum())} lie within two standard errors of zero, "
        f"{int((~fit.determined).sum())} are open. Variance inflation is above 10 for: {', '.join(high) or 'none'}.",
        f"Standard errors hold for errors of the accelerations that hang together; errors of u, v, r are not in them. "
        f"* marks the {int(moved.sum())} coefficients that such errors, as large as the smoother says, move by more "
        "than one standard error.",
    ]


def held_out_table(validation: Validation, errors: dict[str, float]) -> ScoreTable:
    """Relative error, then every channel at the horizons by which models are judged."""
    scores = validation.scores
    cells = [f"{100 * errors[s.name]:.3g} %" if errors.get(s.name, np.inf) < 100 else "gone" for s in scores]
    cells = ["-" if s.name in BASELINE_NAMES else text for s, text in zip(scores, cells, strict=True)]
    best = min(errors, key=lambda name: errors[name])
    cells = [f"**{text}**" if s.name == best else text for s, text in zip(scores, cells, strict=True)]
    rows = [("relative error (of the better baseline's)", *cells), *error_rows(scores, judged_horizons(scores[0]))]
    return ScoreTable(("on held-out data", *(s.name for s in scores)), tuple(rows))


def stability_table(validation: Validation) -> ScoreTable:
    """Who runs away, who comes to rest."""
    return ScoreTable(("stability", *(s.name for s in validation.scores)), tuple(stability_rows(validation)))


def residual_table(result: FitResult) -> ScoreTable:
    """White residuals of the structured fit by channel."""
    rows = [
        (c.name, str(c.count), f"{c.sigma:.4g}", f"{c.rms:.3f}", f"{c.lag1:+.3f}", f"+-{2 / np.sqrt(c.count):.3f}")
        for c in result.channels
    ]
    head = ("channel", "samples", "sigma found", "rms over sigma", "correlation of neighbours", "if white (95 %)")
    return ScoreTable(head, tuple(rows))


def white_table(validation: Validation) -> ScoreTable:
    """The errors one second on, of every model."""
    return ScoreTable(("on held-out data", *(s.name for s in validation.scores)), tuple(white_rows(validation.scores)))


def logs_table(identification: Identification) -> ScoreTable:
    """Which part of which log was used for what."""
    rows = []
    for used in identification.split.used:
        run = used.log.run
        rates = run.rates_hz()
        sensors = [
            f"{name} {rates[c]:.3g} Hz" for c, name in (("ax_m_s2", "IMU"), ("north_m", "positions")) if c in rates
        ]
        rows.append(
            (
                used.log.name,
                f"{run.duration_s:.1f} s; {', '.join(sensors)}",
                intervals(used.fitted_s),
                intervals(used.held_out_s),
                run.data_hash[:12],
            )
        )
    return ScoreTable(("log", "length, rates", "fitted [s]", "held out [s]", "data"), tuple(rows))


def intervals(spans: Sequence[Interval]) -> str:
    """As text; many blocks are counted."""
    if not spans:
        return "-"
    shown = ", ".join(f"{low:.0f} to {high:.0f}" for low, high in spans[:3])
    return shown + (f" .. {len(spans)} blocks" if len(spans) > 3 else "")


def problems_table(identification: Identification) -> ScoreTable:
    """What the logs themselves show, by kind; the first of each in words."""
    rows = []
    for name, ones in identification.problems.items():
        for kind, mine in grouped(ones).items():
            seconds = sum(p.length_s or 0.0 for p in mine)
            at = f" (first at {mine[0].t_s:.1f} s)" if mine[0].t_s is not None else ""
            rows.append((name, kind, str(len(mine)), f"{seconds:.1f}" if seconds else "-", mine[0].text + at))
    return ScoreTable(("log", "kind", "how often", "seconds", "the first"), tuple(rows))


def choices_table(identification: Identification) -> ScoreTable:
    """Every choice and when it was made."""
    return ScoreTable(("choice", "value", "made"), tuple((c.what, c.value, c.made) for c in choices(identification)))


def trials_table(identification: Identification) -> ScoreTable:
    """What was tried on halves of the fitted data."""
    rows = [
        (
            _bold_if(trial.kept, ", ".join(trial.refinements) or "the model as it is"),
            trial.method,
            *(f"{100 * e:.1f} %" if np.isfinite(e) else "none" for e in (trial.error, *trial.halves)),
        )
        for trial in identification.chosen.trials
    ]
    return ScoreTable(("model", "method", "error", "first half", "second half"), tuple(rows))


def _bold_if(kept: bool, text: str) -> str:
    return f"**{text}, kept**" if kept else text


def stamps_table(identification: Identification) -> ScoreTable:
    """The order in which things were done."""
    return ScoreTable(("step", "UTC"), tuple((s.what, s.utc) for s in identification.stamps))


CAPTION = (
    f"Bold: least of its row. {NAMES['base']}: the vessel file given. Channels: {', '.join(CHANNELS)}. A parameter is "
    f"determined if at most {100 * UNDETERMINED:.0f} % of its prior sigma is left."
)
