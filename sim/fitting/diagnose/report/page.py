"""The HTML report of a diagnosis: one self-contained page, sentences first."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from sim.fitting.diagnose.job import Diagnosis
from sim.fitting.diagnose.report import pictures
from sim.fitting.diagnose.report.confusion_picture import confusion
from sim.fitting.diagnose.report.sentences import sentences, size_text
from sim.fitting.diagnose.selection.candidate_score import LEAST_EVIDENCE_NATS
from sim.fitting.diagnose.selection.held_out import CHANNELS, MODELS
from sim.fitting.diagnose.selection.identifiability import MEDIUM
from sim.fitting.diagnose.selection.residual_forces import (
    ResidualForces,
    autocorrelation,
    pulse_widths_and_voltage,
    residual_forces,
)
from sim.fitting.diagnose.vessel_edits.public_form import smallest_size
from sim.fitting.identify.report.tables import intervals
from sim.fitting.validate.report import Section, page
from sim.fitting.validate.table import ScoreTable

CONFUSED = 20  # pairs that the report lists
Pictures = tuple[tuple[Figure, str], ...]
"""Figures with their captions."""
LOOK = ("ambiguous", "partial", "unknown")
PLAIN = ("cross_flow", "voltage_exponent")
"""Effects whose numbers without a unit are not shares."""
LINE = "Line: how the force of the model changes with the causes, along the same motion. Sensor causes change none."
Z975 = 1.959964


def report(diagnosis: Diagnosis) -> str:
    """The page as HTML text."""
    before, after = residual_forces_before_and_after(diagnosis)
    maps = ((pictures.over_basin(before, after), "Mean residual force in cells of the basin, as arrows."),)
    doubt = diagnosis.adequacy is not None and not diagnosis.adequacy.passed
    sections = [
        Section("What the simulation gets wrong", tuple(sentences(diagnosis)), look=diagnosis.verdict in LOOK),
        *(_adequacy(diagnosis, maps) if doubt else []),
        *_causes(diagnosis),
        _held_out(diagnosis),
        _residuals(diagnosis, before, after, () if doubt else maps),
        _evidence(diagnosis),
        *([] if doubt else _adequacy(diagnosis)),
        *_distinguishability(diagnosis),
        _detection_limits(diagnosis),
        _noise(diagnosis),
        _logs(diagnosis),
    ]
    return page(f"Diagnosis of {diagnosis.base.name}", sections, diagnosis.split.about(diagnosis.base))


def residual_forces_before_and_after(diagnosis: Diagnosis) -> tuple[ResidualForces, ResidualForces]:
    """Residual forces of the refitted base, with the force that the causes add; and those of the final model."""
    final, given = diagnosis.selection.final, diagnosis.refit.theta
    ids = {n.fitted for n in diagnosis.causes} | set(given)
    acts = {"hull", "thrust", "water", "force", "maps", "pwm"}
    changed = [e for e in diagnosis.fit.effects if e.id in final.point.theta and (e.id in ids or acts & set(e.hooks))]
    changed = changed if diagnosis.causes else []
    more = {e.id: final.point.theta[e.id] - given.get(e.id, 0.0) for e in changed}
    before = residual_forces(diagnosis.fit, diagnosis.refit_point, diagnosis.refit.noise, more, changed)
    return before, residual_forces(diagnosis.fit, final.point, final.noise, {}, [])


def _causes(diagnosis: Diagnosis) -> list[Section]:
    """Causes: equations, table of parameters, figure of sizes."""
    if not diagnosis.causes:
        return []
    rows, spans = [], []
    for n in diagnosis.causes:
        c, (least, unit) = n.candidate, n.smallest
        for key, number in n.numbers.items():
            low, high = number.ci95
            cells = (f"{number.value:.4g}", f"{low:.4g} to {high:.4g}", "" if number.unit == "1" else number.unit)
            rows.append(
                (n.effect.name, key, *cells, f"{c.nats:.0f}", size_text(least, "" if n.effect.name in PLAIN else unit))
            )
        if not n.numbers:
            rows.append((n.effect.name, "", "", "", "", f"{c.nats:.0f}", ""))
        half = (c.size - c.lower) / 1.644854 * Z975
        spans.append((n.effect.name, c.size - half, c.size, c.size + half))
    head = ("cause", "parameter", "value", "95 % interval", "unit", "evidence [nats]", "smallest size worth a name")
    equations = tuple(
        f"{n.effect.name}: {n.effect.equation}; looks like: {n.effect.signature}." for n in diagnosis.causes
    )
    return [
        Section(
            "The causes",
            equations,
            tables=(ScoreTable(head, tuple(rows)),) if rows else (),
            figures=((pictures.sizes(spans), "Only what lies right of the dashed line is named, however sure."),),
        )
    ]


def _held_out(diagnosis: Diagnosis) -> Section:
    """Held-out errors by channel and horizon, and replayed windows."""
    errors = diagnosis.held_out.errors
    rows = []
    for e in errors:
        if e.blocks > 1:
            cells = [f"{e.rms[m]:.3g} ({e.ci95[m][0]:.3g} to {e.ci95[m][1]:.3g})" for m in MODELS]
            gain = f"{100 * e.gain:.0f} % ({100 * e.gain_ci95[0]:.0f} to {100 * e.gain_ci95[1]:.0f})"
        else:
            cells, gain = [f"{e.rms[m]:.3g}" for m in MODELS], f"{100 * e.gain:.0f} % (too short to say how sure)"
        rows.append((f"{e.channel} [{CHANNELS[e.channel]}], {e.horizon_s} s", *cells, gain))
    table = ScoreTable(
        ("rms error of readings", "as given", "refitted", "with the causes", "gain over refitted"), tuple(rows)
    )
    nats = diagnosis.held_out.nats
    likely = (
        f"One-step log likelihood of {diagnosis.held_out.samples} held-out readings: as given {nats['base']:.0f}, "
        f"refitted {nats['refit']:.0f}, with the causes {nats['extended']:.0f} nats."
    )
    return Section(
        "What it is worth, on data that no fit has seen",
        (likely,),
        tables=(table,),
        figures=(
            (pictures.held_out(errors), "Open loop under the logged commands; bars: 95 %."),
            (
                pictures.tracks(diagnosis.held_out.replays),
                "The window whose error is the median, and one of the worst.",
            ),
        ),
        note="What sensors should say so long after the start of a window, against what they said; noise is in all.",
    )


def _residuals(diagnosis: Diagnosis, before: ResidualForces, after: ResidualForces, maps: Pictures) -> Section:
    pwm, volts = pulse_widths_and_voltage(diagnosis.fit.physics)
    speeds = {name: before.x[:, i] for i, name in enumerate(("u [m/s]", "v [m/s]", "r [rad/s]"), 3)}
    if np.isfinite(volts).any():
        speeds["battery [V]"] = volts
    thrusters = {f"{t.name} [us]": pwm[:, i] for i, t in enumerate(diagnosis.base.thrusters)}
    return Section(
        "What the model leaves over",
        figures=(
            (pictures.over_time(before, after), "Latent force with 2 sigma: what the equations lack, over time."),
            (pictures.against(before, speeds), f"The same of the refitted base over speeds and voltage. {LINE}"),
            (pictures.against(before, thrusters), "And over the pulse width of each thruster."),
            (pictures.over_heading(before), "And over heading: on the dark ring it is zero, outside it positive."),
            *maps,
            (
                _whiteness(diagnosis),
                "Correlation of one-step errors: in the grey band they tell nothing of each other.",
            ),
        ),
    )


def _whiteness(diagnosis: Diagnosis):
    final = diagnosis.selection.final.point
    samples = {
        n: int(np.isfinite(final.residuals[..., i]).sum()) for i, n in enumerate(("heading", "yaw rate", "a_x", "a_y"))
    }
    samples |= {"north": len(final.fix_residuals), "east": len(final.fix_residuals)}
    return pictures.whiteness(autocorrelation(diagnosis.refit_point), autocorrelation(final), samples)


def _evidence(diagnosis: Diagnosis) -> Section:
    """Evidence of the named causes and of the other candidates."""
    names = {e.id: e.name for e in diagnosis.fit.effects}
    others: dict[str, tuple[float, float]] = {}
    for c in diagnosis.selection.ranking:
        others[names[c.id]] = max((c.nats, c.size), others.get(names[c.id], (-np.inf, 0.0)))
    named = {n.effect.name: n.candidate.nats for n in diagnosis.causes}
    return Section(
        "Evidence",
        figures=(
            (
                pictures.evidence(named, others, LEAST_EVIDENCE_NATS),
                "Logarithmic beyond 10. Grey beyond the line: not surely larger than the smallest size worth a name, "
                "or no better as one cause than as one of many small imperfections. Beside the bars: the size, in "
                "units of that.",
            ),
        ),
        note="Each against its own absence, all others free within their bands. 9 nats: odds of 8 000 to one.",
    )


def _adequacy(diagnosis: Diagnosis, maps: Pictures = ()) -> list[Section]:
    """Checks of adequacy."""
    a = diagnosis.adequacy
    if a is None:
        return []
    rows = tuple(
        (
            c.name,
            f"{c.value:.3g}",
            f"{c.limit:.3g}",
            "yes" if c.passed else "**no**",
            "" if c.decides else "for information",
        )
        for c in sorted(a.checks, key=lambda c: (not c.decides, c.passed))
    )
    return [
        Section(
            "Is anything left?",
            tables=(ScoreTable(("test", "value", "limit", "passed", ""), rows),),
            figures=maps,
            note="Nats: how much better the logs are explained if smooth functions of that kind are let in, whatever "
            "their cause, beside small ones of every kind.",
        )
    ]


def _distinguishability(diagnosis: Diagnosis) -> list[Section]:
    """Pairs that these logs cannot separate, heat map, manoeuvre."""
    result = diagnosis.identifiability
    if result is None:
        return []
    close = result.pairwise.confused
    lines = [f"These logs cannot tell {a} from {b} ({max(nats, 0):.1f} nats)." for a, b, nats in close[:CONFUSED]]
    if len(close) > CONFUSED:
        lines.append(f"So it is with {len(close) - CONFUSED} pairs more.")
    if result.pairwise.hidden:
        lines.append(f"These logs might not have shown, even of medium size: {', '.join(result.pairwise.hidden)}.")
    figure = confusion(result.pairwise)
    return [
        Section(
            "What these logs can tell apart",
            (*lines, result.record.manoeuvre)
            if result.record.manoeuvre
            else tuple(lines) or ("These logs tell apart every pair of causes that they show well.",),
            figures=((figure, "Red: these logs cannot tell the two apart."),) if figure is not None else (),
            note=f"Each cause as if it were there with {MEDIUM:g} times the smallest size worth a name, in the "
            "direction that shows least; every other within its tolerance band.",
        )
    ]


def _detection_limits(diagnosis: Diagnosis) -> Section:
    """Sizes from which these logs would have shown each effect."""
    by_name = {e.name: e for e in diagnosis.fit.effects}
    rows = []
    for name, (size, unit) in diagnosis.visible.items():
        least, least_unit = smallest_size(by_name[name])
        plain = name in PLAIN
        rows.append((name, size_text(size, "" if plain else unit), size_text(least, "" if plain else least_unit)))
    return Section(
        "What these logs would have shown",
        tables=(ScoreTable(("effect", "from this size on", "smallest size worth a name"), tuple(rows)),),
        note="A true size that these logs would have named on average; much larger ones are not there. Not in the "
        "table: what was named, what these logs would not have shown at any size, and what is looked for in other ways "
        "(rate limits, swapped thrusters, waves, gusts, fixes without line of sight).",
    )


def _noise(diagnosis: Diagnosis) -> Section:
    """Noise card: estimated and stated."""
    final, stated = diagnosis.selection.final.noise, diagnosis.fit.physics.vessel.sensors
    rows = [
        ("heading [rad]", f"{final.white[0]:.3g}", f"{stated.imu.heading_sigma_rad:.3g}"),
        ("yaw rate [rad/s]", f"{final.white[1]:.3g}", f"{stated.imu.gyro_sigma_rad_s:.3g}"),
        ("a_x, a_y [m/s^2]", f"{final.white[2]:.3g}, {final.white[3]:.3g}", f"{stated.imu.accel_sigma_m_s2:.3g}"),
        ("position [m]", f"{final.fix_m:.3g}", f"{stated.position_sigma_m:.3g}"),
    ]
    latent = [("with the causes", final.latent), ("refitted base", diagnosis.refit.noise.latent)]
    latent += [("reference log", diagnosis.ambient.latent)] if diagnosis.ambient else []
    more = tuple(
        (f"latent acceleration [m/s^2, m/s^2, rad/s^2], {n}", ", ".join(f"{v:.2g}" for v in values), "")
        for n, values in latent
    )
    remarks = (
        () if diagnosis.ambient else ("No reference log: ambient noise is what the model with its causes leaves over.",)
    )
    return Section("Noise card", remarks, tables=(ScoreTable(("one sigma", "found", "vessel file"), (*rows, *more)),))


def _logs(diagnosis: Diagnosis) -> Section:
    rows = []
    for used in diagnosis.split.used:
        problems = "; ".join(p.text for p in diagnosis.problems[used.log.name][:4]) or "-"
        run = used.log.run
        spans = (intervals(used.fitted_s), intervals(used.held_out_s))
        rows.append((used.log.name, f"{run.duration_s:.0f} s", *spans, problems, run.data_hash[:12]))
    head = ("log", "length", "fitted [s]", "held out [s]", "problems", "data")
    held = f"Held out: {diagnosis.split.rule}."
    return Section("The logs", (held,), tables=(ScoreTable(head, tuple(rows)),), text=True)
