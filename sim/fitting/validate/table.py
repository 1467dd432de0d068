"""Table of all scores, a column for each model and a row for each score; and its content as sentences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim.fitting.engine.smoothing import RATE_HZ
from sim.fitting.validate.protocol import CHANNELS, UNITS
from sim.fitting.validate.scores import LAGS, SCORE_S, SPEEDS, Score, best_baseline
from sim.fitting.validate.study import BASELINE_NAMES, Validation

SHOWN_S = (5, 10, 20, 30, 60)
Row = tuple[str, ...]


@dataclass(frozen=True)
class ScoreTable:
    """Rows of text under a head. A cell `**text**` is bold: the best of its row."""

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def markdown(self) -> str:
        """As Markdown, columns aligned."""
        widths = [max(len(row[i]) for row in (self.head, *self.rows)) for i in range(len(self.head))]
        lines = [
            "| " + " | ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)) + " |"
            for row in (self.head, *self.rows)
        ]
        return "\n".join([lines[0], "|" + "|".join("-" * (w + 2) for w in widths) + "|", *lines[1:]])


def table(validation: Validation) -> ScoreTable:
    """All scores of all models. The smallest error of a row is bold; "gone": not finite."""
    rows = (
        *error_rows(validation.scores),
        *other_rows(validation.scores),
        *white_rows(validation.scores),
        *stability_rows(validation),
    )
    return ScoreTable(("figure", *(s.name for s in validation.scores)), rows)


def error_rows(scores: Sequence[Score], horizons_s: Sequence[int] = SHOWN_S) -> list[Row]:
    """Rms error of each channel at each horizon."""
    rows = []
    for channel in CHANNELS:
        for h in (h for h in horizons_s if h in scores[0].horizons_s):
            values = [s.rms[channel][s.horizons_s.index(h)] for s in scores]
            rows.append((f"{channel}, rms error after {h} s [{UNITS[channel]}]", *_bold_least(values)))
    return rows


def other_rows(scores: Sequence[Score]) -> list[Row]:
    """Medians of the position error, robust to a few diverged runs; NRMSE and R2 of speeds."""
    rows = []
    for h in (h for h in SHOWN_S if h in scores[0].horizons_s):
        values = [s.median["position"][s.horizons_s.index(h)] for s in scores]
        rows.append((f"position, median error after {h} s [m]", *_bold_least(values)))
    for name in SPEEDS:
        rows.append((f"{name}, NRMSE over {SCORE_S} s", *(_number(s.nrmse[name]) for s in scores)))
        rows.append((f"{name}, R2 over {SCORE_S} s", *(_r2(s.r2[name]) for s in scores)))
    return rows


def white_rows(scores: Sequence[Score]) -> list[Row]:
    """Ljung-Box test of the errors after 1 s."""
    rows = []
    for name in SPEEDS:
        cells = [f"{_p(s.white[name].p)} ({s.white[name].lag1:+.2f})" for s in scores]
        rows.append((f"{name}, 1 s residuals: Ljung-Box p of {LAGS} lags (lag 1)", *cells))
    return rows


def stability_rows(validation: Validation) -> list[Row]:
    """Shares of runs that diverge or come to rest."""
    stable = validation.stabilities
    return [
        ("runs diverged by the end", *(percent(s.diverged[-1]) for s in validation.scores)),
        ("random thrust: runs that diverge", *(percent(s.driven_diverged) for s in stable)),
        ("no thrust: runs that diverge", *(percent(s.free_diverged) for s in stable)),
        ("no thrust: runs that come to rest", *(percent(s.free_at_rest) for s in stable)),
    ]


def percent(share: float) -> str:
    """Whole per cent; neither some are told as none, nor nearly all as all."""
    if 0 < share <= 0.005:
        return "under 1 %"
    return "over 99 %" if 0.995 <= share < 1 else f"{100 * share:.0f} %"


def _bold_least(values: Sequence[float]) -> list[str]:
    texts, least = [_number(v) for v in values], int(np.argmin(values))
    return [f"**{text}**" if i == least else text for i, text in enumerate(texts)]


def _number(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) and value < 1e4 else "gone"


def _r2(value: float) -> str:
    return f"{value:.3f}" if value > -1e3 else "gone"


def _p(p: float) -> str:
    return f"{p:.2f}" if p >= 0.01 else "< 0.01"


def sentences(validation: Validation) -> list[str]:
    """The table as sentences: the data, the nearest model, comparison with the baselines, divergence, whiteness."""
    models = [s for s in validation.scores if s.name not in BASELINE_NAMES]
    w = validation.windows
    whole = "; ".join(sorted({ref.source for ref in validation.references}))
    spans = [
        high - low
        for part, ref in zip(validation.held_out, validation.references, strict=True)
        for low, high in part.inside or [(float(ref.t_s[0]), float(ref.t_s[-1]))]
    ]
    logs = len(validation.held_out)
    longest_s = (np.isfinite(w.truth[..., 0]).sum(axis=1).max() - 1) / RATE_HZ
    lines = [
        f"{len(w.x0)} open-loop runs of up to {longest_s:.0f} s, cut from {sum(spans):.0f} s of {logs} "
        f"log{'s' * (logs > 1)} that no fit has seen, were simulated from the measured state with "
        f"the measured commands. Compared with {whole}."
    ]
    for h in (h for h in (10, 30) if h in validation.scores[0].horizons_s):
        best = min(models, key=lambda s: s.rms["position"][s.horizons_s.index(h)])
        mine = best.rms["position"][best.horizons_s.index(h)]
        idle = best_baseline(validation.scores, BASELINE_NAMES, "position", h)
        lines.append(
            f"After {h} s the nearest model is {best.name}: {_number(mine)} m from the true place (rms), against "
            f"{_number(idle)} m for the better of the two baselines, which know no model."
        )
    lines += [_against_baselines(s, validation.scores) for s in models]
    for s, stable in zip(validation.scores, validation.stabilities, strict=True):
        if s.name not in BASELINE_NAMES and (s.diverged[-1] or stable.driven_diverged or stable.free_at_rest < 1):
            lines.append(
                f"{s.name}: {percent(s.diverged[-1])} of the held-out runs and {percent(stable.driven_diverged)} "
                f"of runs under random thrust diverge; without thrust {percent(stable.free_at_rest)} come to rest "
                f"within a minute (a boat always does)."
            )
    coloured = [s.name for s in models if any(white.p < 0.01 for white in s.white.values())]
    if coloured:
        lines.append(
            f"The 1 s residuals of {', '.join(coloured)} are not white: each error tells something of the next, so "
            f"there is more in the data than the model holds, or the comparison itself is smoothed."
        )
    return lines


def lost_to_baselines(s: Score, scores: Sequence[Score], horizons_s: Sequence[int] = (10, 20)) -> list[str]:
    """Channels and horizons, as text, in which a model is no better than the better baseline."""
    return [
        f"{channel} at {h} s"
        for h in horizons_s
        if h in s.horizons_s
        for channel in CHANNELS
        if not s.rms[channel][s.horizons_s.index(h)] < best_baseline(scores, BASELINE_NAMES, channel, h)
    ]


def _against_baselines(s: Score, scores: Sequence[Score]) -> str:
    lost = lost_to_baselines(s, scores)
    if not lost:
        at = " and ".join(str(h) for h in (10, 20) if h in s.horizons_s)
        return f"{s.name} beats both baselines in every channel at {at} s."
    return f"{s.name} does not beat the better baseline in: {', '.join(lost)}."
