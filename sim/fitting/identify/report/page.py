"""The report on an identification: one self-contained page, the verdict first."""

from __future__ import annotations

import numpy as np

from sim.fitting.engine.parameters import WARP
from sim.fitting.identify.job import Identification
from sim.fitting.identify.report.figures import parameters
from sim.fitting.identify.report.tables import (
    CAPTION,
    choices_table,
    held_out_table,
    logs_table,
    parameter_table,
    problems_table,
    residual_table,
    stability_table,
    stamps_table,
    taylor_lines,
    taylor_table,
    trials_table,
    white_table,
)
from sim.fitting.identify.result import FitResult, OpenDirection
from sim.fitting.identify.verdict import JUDGED_S, NAMES
from sim.fitting.validate.divergence import divergence_table
from sim.fitting.validate.figures import divergence, training_log
from sim.fitting.validate.report import Section, every_figure, page, pictures
from sim.fitting.validate.table import sentences


def identify_report(identification: Identification) -> str:
    """The page, as text."""
    wiring = identification.wiring
    sections = [Section("Signs and sides", wiring.lines, look=True)] if wiring.lines else []
    sections.append(Section("What to believe", identification.verdict.lines))
    if identification.verdict.attention:
        sections.append(Section("Look at this first", identification.verdict.attention, look=True))
    sections += [
        _what_to_drive(identification),
        _parameters(identification),
        *_trials(identification),
        *_taylor(identification),
        _held_out(identification),
        pictures(identification.validation, identification.identified, _structured(identification)),
        _departures(identification),
        _fitted(identification),
        _whiteness(identification),
        Section(
            "Stability",
            ("The energy of a boat without thrust in still water can only fall: a free run that speeds up is wrong.",),
            tables=(stability_table(identification.validation),),
            note="100 runs each, from random states inside the speeds of the fitted data, 60 s.",
        ),
        _logs(identification),
        _choices(identification),
        every_figure(identification.validation),
    ]
    about = identification.split.about(identification.base)
    return page(f"Identification of {identification.base.name}", sections, about)


def _structured(identification: Identification) -> int:
    return [s.name for s in identification.validation.scores].index(NAMES["structured"])


def _what_to_drive(identification: Identification) -> Section:
    lines = [f"{', '.join(names)}: {manoeuvre}." for names, manoeuvre in identification.verdict.advice]
    lines += identification.wiring.open_lines
    return Section("What to drive next", tuple(lines) or ("Every parameter of boat and sensors is determined.",))


def _parameters(identification: Identification) -> Section:
    no_matter = (*WARP, *identification.structured.held)
    open_ones = [d for d in identification.structured.directions if next(iter(d.parts)) not in no_matter]
    lines = [_direction(d) for d in open_ones[:4]]
    return Section(
        "Structured model: parameters",
        tuple(lines),
        tables=(parameter_table(identification.structured, identification.model, identification.chosen.settings),),
        note="Prior sigma left: 100 % says that the data told nothing, 0 % that the prior did not matter. Mass and I_z "
        "cannot be told from added mass by motion: M11, M22, M33 are what counts. warp_*: how range biases and "
        "surveying bend the positions; current_*, wind_*: of the day. Neither is in the vessel file. Such a hull has: "
        "roughly, by mass, length and draft of the file (bold: outside). Without "
        "dimension: over rho/2 and powers of the length, and of U = 1 m/s (SNAME 1950).",
        figures=(
            (
                parameters(identification.structured, identification.model, identification.chosen.settings),
                "Identified over believed; grey: what such a hull has, roughly. Couplings, which may change sign, are "
                "in the table only.",
            ),
        ),
    )


def _trials(identification: Identification) -> list[Section]:
    if not identification.chosen.trials:
        return []
    return [
        Section(
            "How model and method were chosen",
            (f"Kept: {identification.chosen.method}, because {identification.chosen.why}.",),
            tables=(trials_table(identification),),
            note="Each was fitted to one half of the fitted data and judged by its predictions of the other, up to "
            f"{identification.chosen.horizon_s:g} s ahead: errors of position, heading, u, v, r over those of the "
            "model as it is. None: it ran away, has no solution, or did not converge. Held-out data played no part.",
        )
    ]


def _direction(direction: OpenDirection) -> str:
    parts = ", ".join(f"{value:+.2g} {name}" for name, value in list(direction.parts.items())[:8])
    more = " .." if len(direction.parts) > 8 else ""
    share = 100 * min(direction.share_of_prior, 1.0)
    return f"A combination that the data leave open ({share:.0f} % of its prior sigma is left): {parts}{more}."


def _taylor(identification: Identification) -> list[Section]:
    return [
        Section(
            f"{one.name}: 23 terms for each axis, as the paper's Table 2",
            tuple(taylor_lines(one)),
            tables=(taylor_table(one),),
            note="Coefficient and standard error, SI with forces in kgf and kgf m (1 kgf = 9.80665 N), about 0.5 m/s.",
        )
        for one in identification.series
    ]


def _held_out(identification: Identification) -> Section:
    seconds = identification.split.held_out_length_s
    few = (
        f"Runs begin every 5 s and overlap: {seconds:.0f} s hold {seconds / JUDGED_S[-1]:.0f} of {JUDGED_S[-1]} s that "
        "share nothing. So much the figures below can be trusted."
    )
    return Section(
        "On data that no fit has seen",
        (*sentences(identification.validation), few),
        tables=(held_out_table(identification.validation, identification.verdict.relative_error),),
        note=CAPTION,
    )


def _departures(identification: Identification) -> Section:
    return Section(
        "How runs depart and diverge",
        tables=(divergence_table(identification.departures),),
        figures=(
            (divergence(identification.departures), "Left: share of runs that have diverged. Right: median distance."),
        ),
        note="Median distance from the true place, and share of runs that have diverged by then.",
    )


def _fitted(identification: Identification) -> Section:
    motion = identification.motion
    liveliest = int(np.argmax([np.mean(s.nu**2) for s in motion.smoothed]))
    paper = motion.paper[liveliest] if motion.paper else None
    figure = training_log(motion.runs[liveliest], paper, motion.smoothed[liveliest])
    caption = f"The fitted part with the greatest speeds: {motion.runs[liveliest].meta.source} (Figures 5 and 6)."
    return Section("The fitted data", figures=((figure, caption),))


def _whiteness(identification: Identification) -> Section:
    s = identification.structured
    return Section(
        "Residuals",
        (
            f"Structured fit: {s.samples} samples and {s.fixes} positions, {s.iterations} steps, {s.seconds:.1f} s, "
            f"{'converged' if s.converged else 'not converged'}. {_whiteness_of(s)}",
        ),
        tables=(residual_table(s), white_table(identification.validation)),
        note="Ljung-Box p below 0.01 says that an error tells something of the next. With enough data every model of "
        "a real boat fails this test; it says that there is more to be had, not how much.",
    )


def _whiteness_of(result: FitResult) -> str:
    if result.horizon_s:
        return (
            f"Errors of predictions hang together within {result.horizon_s:g} s; its intervals count each such stretch "
            "as one sample."
        )
    end = "are white" if result.white else "are not white: its intervals are too narrow"
    return f"Its residuals on the fitted data {end}."


def _logs(identification: Identification) -> Section:
    problems = problems_table(identification)
    return Section(
        "The logs and what is wrong with them",
        () if problems.rows else ("No problems found.",),
        tables=(logs_table(identification), problems) if problems.rows else (logs_table(identification),),
        text=True,
    )


def _choices(identification: Identification) -> Section:
    return Section(
        "Every choice, and when it was made",
        (
            "None was made on the held-out data: these were simulated once, after everything had been fitted.",
            "Beforehand: it stands in the code or in the vessel file. Fitted parts: the fit found it in its own data.",
        ),
        tables=(choices_table(identification), stamps_table(identification)),
        text=True,
    )
