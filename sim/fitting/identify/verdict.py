"""Which model to believe, why, what needs attention, and what to drive next: in figures and plain sentences.

    relative error of a model = geometric mean over the five channels at 10 and 20 s of
                                rms error on held-out runs / rms error of the better baseline

1: no better than a guess without a model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from companion.logs.runs.as_if_blank import DEAD_SENSOR
from companion.logs.runs.problems import BIASING, problem_sentences
from companion.logs.runs.run import LogProblem
from sim.fitting.engine.free_parameters import SURROUNDINGS
from sim.fitting.engine.parameters import WARP
from sim.fitting.engine.split import OTHER_BOAT, UNCERTAIN
from sim.fitting.engine.wind import is_measured
from sim.fitting.identify.advice import advice
from sim.fitting.identify.chosen_fit import ChosenFit
from sim.fitting.identify.plausible import implausible
from sim.fitting.identify.refinements import TEXTS, WIND, nothing_of
from sim.fitting.identify.result import COLOURED, Estimate, FitResult, OpenDirection
from sim.fitting.identify.vessel_out import not_written, written_otherwise
from sim.fitting.validate.protocol import CHANNELS
from sim.fitting.validate.scores import Score, best_baseline
from sim.fitting.validate.study import BASELINE_NAMES, NOT_JUDGED, Validation
from sim.fitting.validate.table import lost_to_baselines

NAMES = {
    "base": "base file",
    "taylor": "Taylor",
    "smoothed": "Taylor smoothed",
    "peer": "pysindy",
    "structured": "structured",
}
"""Names of the models. Taylor: by the paper's pipeline; smoothed: the same series from the RTS smoother."""
KEEP = "Keep the vessel file that you started from."
JUDGED_S = (10, 20)
"""Horizons of the relative error."""
SAME = 1.05
"""Relative errors closer than this factor count as equal; assumed."""
NEEDED = (
    ("M11_kg",), ("M22_kg",), ("M33_kg_m2",),
    ("X_u_N_s_m", "X_uu_N_s2_m2"), ("Y_v_N_s_m", "Y_vv_N_s2_m2"), ("N_r_N_m_s", "N_rr_N_m_s2"),
    ("dead_time_s", "lag_s"),
)  # fmt: skip
"""The data must determine one of each group: else the boat's speed or its response to thrust is the prior's."""
NUISANCE = (*WARP, *(p.name for _, p in SURROUNDINGS))
"""Parameters that are no property of boat or sensors."""
DOUBTFUL = (*BIASING, *UNCERTAIN, DEAD_SENSOR, OTHER_BOAT, NOT_JUDGED)
"""Kinds of log problems that can bias a fit unnoticed, or by which it or its judgement lacks something."""


@dataclass(frozen=True)
class IdentificationVerdict:
    """The verdict.

    believe         name of the model, or None
    relative_error  by model, baselines left out
    lines           the verdict in sentences
    attention       what must be looked at before the model is used; may be empty
    advice          undetermined parameters, and the manoeuvre that carries information on them
    """

    believe: str | None
    relative_error: dict[str, float]
    lines: tuple[str, ...]
    attention: tuple[str, ...]
    advice: tuple[tuple[tuple[str, ...], str], ...]


def verdict(
    chosen: ChosenFit, validation: Validation, problems: Mapping[str, Sequence[LogProblem]]
) -> IdentificationVerdict:
    """Verdict on a structured fit, from the scores of all models on held-out data and the problems of the logs.

    The structured model is believed where it is within the factor `SAME` of the best; no model if none is below 1.
    """
    errors = {s.name: relative_error(s, validation.scores) for s in validation.scores if s.name not in BASELINE_NAMES}
    nearest = min(errors, key=lambda name: errors[name])
    if errors[NAMES["structured"]] <= SAME * errors[nearest]:
        nearest = NAMES["structured"]
    believe = nearest if errors[nearest] < 1 else None
    structured = chosen.result
    lines = [_believe(believe, errors), *_given(chosen, validation), *_distances(validation, errors)]
    lines += [*_refined(chosen), *_open(structured), *not_written(structured)]
    attention = [
        *_fit_doubts(structured),
        *(f"{name}: too short to predict {chosen.horizon_s:g} s ahead in it: left out." for name in chosen.too_short),
        *implausible(chosen.vessel, structured),
        *written_otherwise(chosen.vessel, structured),
        *_model_doubts(errors, validation),
        *problem_sentences(problems, DOUBTFUL),
    ]
    next_ones = advice(_undetermined(structured), chosen.vessel)
    return IdentificationVerdict(believe, errors, tuple(lines), tuple(attention), tuple(next_ones))


def judged_horizons(score: Score) -> list[int]:
    """The horizons of `JUDGED_S` that the held-out runs reach."""
    return [h for h in JUDGED_S if h in score.horizons_s]


def relative_error(score: Score, scores: Sequence[Score]) -> float:
    """Relative error (module docstring); inf where a run has diverged beyond all bounds."""
    ratios = [
        score.rms[channel][score.horizons_s.index(h)] / best_baseline(scores, BASELINE_NAMES, channel, h)
        for channel in CHANNELS
        for h in judged_horizons(score)
    ]
    return float(np.exp(np.mean(np.log(ratios)))) if np.isfinite(ratios).all() else np.inf


def _undetermined(structured: FitResult) -> list[str]:
    """Names of parameters of boat and sensors that the data leave open, of those that the method fits."""
    return [p.name for p in _of_boat(structured) if not p.determined]


def _of_boat(structured: FitResult) -> list[Estimate]:
    """Estimates of boat and sensors that the method fits."""
    return [p for p in structured.parameters if p.name not in (*NUISANCE, *structured.held)]


def common_scale(structured: FitResult) -> OpenDirection | None:
    """The undetermined direction in which all forces and inertias change together, if there is one."""
    heads = ("M11_kg", "M22_kg")
    return next((d for d in structured.directions if all(abs(d.parts.get(h, 0.0)) > 0.5 for h in heads)), None)


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %" if np.isfinite(share) and share < 100 else "beyond all bounds"


def _believe(believe: str | None, errors: Mapping[str, float]) -> str:
    """The sentence that names the model to believe."""
    others = ", ".join(f"{name} {_percent(e)}" for name, e in errors.items() if name != believe)
    if believe is None:
        return f"Believe none of the models: on held-out data none is nearer than a guess without a model ({others})."
    head = {
        NAMES["structured"]: "Believe the structured model (vessel.toml).",
        NAMES["base"]: KEEP,
    }.get(believe, f"{believe} comes nearest, but `aritra run` drives with vessel files only.")
    return (
        f"{head} Its error on held-out data, 10 and 20 s ahead, is {_percent(errors[believe])} of that of the better "
        f"guess without a model; {others}."
    )


def _refined(chosen: ChosenFit) -> list[str]:
    """Sentences on refinements that the logs asked for, and on those that were kept but may be nothing."""
    doubtful = nothing_of(chosen.result, chosen.refinements)
    texts = {name: text for name, text in TEXTS.items() if name in chosen.refinements}
    asked = "; ".join(text for name, text in texts.items() if name not in doubtful)
    kept = "; ".join(text for name, text in texts.items() if name in doubtful)
    lines = [f"The logs ask for what the vessel file lacked, and vessel.toml has: {asked}."] if asked else []
    if kept:
        lines.append(
            f"Kept as well, for halves of the logs were predicted better with it, but not surely there: {kept}."
        )
    if left_out := "; ".join(TEXTS[name] for name in chosen.left_out):
        lines.append(
            "Left out again, for halves of the logs were predicted better with it, but all together show nothing: "
            f"{left_out}."
        )
    return lines


def _given(chosen: ChosenFit, validation: Validation) -> list[str]:
    """A sentence where predictions were given what nobody knows beforehand."""
    if WIND not in chosen.vessel.terms or not any(is_measured(part.run) for part in validation.held_out):
        return []
    return [
        "These predictions were given the measured wind, which blows where a file has [terms.wind]; vessel.toml has no "
        "wind of its own, for that is the day's."
    ]


def _distances(validation: Validation, errors: Mapping[str, float]) -> list[str]:
    """Sentences on the position errors of all models after 10 and 30 s."""
    lines = []
    for h in (h for h in (10, 30) if h in validation.scores[0].horizons_s):
        at = {s.name: s.rms["position"][s.horizons_s.index(h)] for s in validation.scores}
        distances = ", ".join(f"{name} {at[name]:.3g} m" if at[name] < 1e4 else f"{name} gone" for name in errors)
        idle = best_baseline(validation.scores, BASELINE_NAMES, "position", h)
        count = validation.scores[0].count[validation.scores[0].horizons_s.index(h)]
        lines.append(
            f"Distance from the true place after {h} s without any measurement (rms of {count} runs): {distances}; "
            f"the better guess without a model {idle:.3g} m."
        )
    return lines


def _open(structured: FitResult) -> list[str]:
    """Sentences on undetermined parameters, and on the common scale of forces and inertias."""
    boat, left = _of_boat(structured), _undetermined(structured)
    line = f"The data determine {len(boat) - len(left)} of {len(boat)} parameters of boat and sensors"
    lines = [f"{line}; open: {', '.join(left)}." if left else f"{line}."]
    if held := [name for name in structured.held if name not in NUISANCE]:
        lines.append(f"Held at the vessel file's values by this method, multi-step output error: {', '.join(held)}.")
    if (scale := common_scale(structured)) is not None and scale.share_of_prior > 0.9:
        gains = [p for p in structured.parameters if p.name.startswith("gain_")]
        width = max((p.ci95[1] - p.ci95[0]) / 2 / p.value for p in gains)
        lines.append(
            "Motion shows forces only in proportion to inertia. How large both are in newtons and kilograms is as well "
            f"known as the thruster map of the vessel file, here +- {100 * width:.1f} % (95 %); it makes no difference "
            "to how the boat moves. A weighing or a pull at the bollard would settle it."
        )
    return lines


def _fit_doubts(structured: FitResult) -> list[str]:
    """Doubts about the fit itself: convergence, whiteness, parameters that the controller needs."""
    doubts = []
    if not structured.converged:
        doubts.append(
            f"The structured fit did not converge in {structured.iterations} steps: its values are not final."
        )
    if not structured.white:
        channels = ", ".join(c.name for c in structured.channels if abs(c.lag1) >= COLOURED)
        doubts.append(
            f"The residuals of the structured fit hang together ({channels or 'slightly'}): the model leaves something "
            "out, and its intervals are too narrow."
        )
    determined = {p.name for p in structured.parameters if p.determined}
    for group in NEEDED:
        if not determined & set(group):
            what = " or ".join(group)
            doubts.append(f"The data do not determine {what}, which the controller needs: it stays what was believed.")
    return doubts


def _model_doubts(errors: Mapping[str, float], validation: Validation) -> list[str]:
    """Doubts from the held-out data: a better model, a better baseline, divergence."""
    name = NAMES["structured"]
    doubts, mine = [], errors[name]
    for other, error in errors.items():
        if other != name and mine > SAME * error:
            doubts.append(
                f"On held-out data {other} is nearer than the structured model: {_percent(error)} against "
                f"{_percent(mine)} of the better baseline's error."
            )
    score = next(s for s in validation.scores if s.name == name)
    if lost := lost_to_baselines(score, validation.scores, judged_horizons(score)):
        doubts.append(f"The structured model does not beat the better baseline in: {', '.join(lost)}.")
    stable = next(s for s in validation.stabilities if s.name == name)
    if score.diverged[-1] or stable.free_diverged:
        doubts.append("The structured model runs away from the speeds of the fitted data: see Stability.")
    return doubts
