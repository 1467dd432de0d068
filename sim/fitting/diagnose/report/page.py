"""The report on a diagnosis: one self-contained page, plain sentences first."""

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
from sim.fitting.diagnose.vessel_edits.public_form import smallest
from sim.fitting.identify.report.tables import intervals
from sim.fitting.validate.report import Section, page
from sim.fitting.validate.table import ScoreTable

CONFUSED = 20  # pairs that the report lists
Pictures = tuple[tuple[Figure, str], ...]
"""Figures with what is said below them."""
LOOK = ("ambiguous", "partial", "unknown")
PLAIN = ("cross_flow", "voltage_exponent")
"""Whose numbers without a unit are no shares."""
LINE = "Line: how the force of the model changes with the causes, along the same motion. Sensor causes change none."
Z975 = 1.959964


def report(found: Diagnosis) -> str:
    """The page, as text."""
    before, after = residual_forces_before_and_after(found)
    maps = ((pictures.over_basin(before, after), "Mean residual force in cells of the basin, as arrows."),)
    doubt = found.adequacy is not None and not found.adequacy.passed
    sections = [
        Section("What the simulation gets wrong", tuple(sentences(found)), look=found.verdict in LOOK),
        *(_adequacy(found, maps) if doubt else []),
        *_causes(found),
        _held_out(found),
        _left_over(found, before, after, () if doubt else maps),
        _evidence(found),
        *([] if doubt else _adequacy(found)),
        *_apart(found),
        _visible(found),
        _noise(found),
        _logs(found),
    ]
    return page(f"Diagnosis of {found.base.name}", sections)


def residual_forces_before_and_after(found: Diagnosis) -> tuple[ResidualForces, ResidualForces]:
    """What the refitted base leaves over, with what the causes and numbers beside them change; what is left then."""
    final, given = found.selection.final, found.refit.theta
    ids = {n.fitted for n in found.causes} | set(given)
    acts = {"hull", "thrust", "water", "force", "maps", "pwm"}
    changed = [e for e in found.fit.effects if e.id in final.point.theta and (e.id in ids or acts & set(e.hooks))]
    changed = changed if found.causes else []
    more = {e.id: final.point.theta[e.id] - given.get(e.id, 0.0) for e in changed}
    before = residual_forces(found.fit, found.refit_point, found.refit.noise, more, changed)
    return before, residual_forces(found.fit, final.point, final.noise, {}, [])


def _causes(found: Diagnosis) -> list[Section]:
    if not found.causes:
        return []
    rows, spans = [], []
    for n in found.causes:
        c, (least, unit) = n.candidate, n.smallest
        for key, number in n.numbers.items():
            low, high = number.ci95
            told = (f"{number.value:.4g}", f"{low:.4g} to {high:.4g}", "" if number.unit == "1" else number.unit)
            rows.append(
                (n.effect.name, key, *told, f"{c.nats:.0f}", size_text(least, "" if n.effect.name in PLAIN else unit))
            )
        if not n.numbers:
            rows.append((n.effect.name, "", "", "", "", f"{c.nats:.0f}", ""))
        half = (c.size - c.lower) / 1.644854 * Z975
        spans.append((n.effect.name, c.size - half, c.size, c.size + half))
    head = ("cause", "parameter", "value", "95 % interval", "unit", "evidence [nats]", "smallest size worth a name")
    equations = tuple(f"{n.effect.name}: {n.effect.equation}; looks like: {n.effect.signature}." for n in found.causes)
    return [
        Section(
            "The causes",
            equations,
            tables=(ScoreTable(head, tuple(rows)),) if rows else (),
            figures=((pictures.sizes(spans), "Only what lies right of the dashed line is named, however sure."),),
        )
    ]


def _held_out(found: Diagnosis) -> Section:
    errors = found.held_out.errors
    rows = []
    for e in errors:
        told = [f"{e.rms[m]:.3g} ({e.ci95[m][0]:.3g} to {e.ci95[m][1]:.3g})" for m in MODELS]
        gain = f"{100 * e.gain:.0f} % ({100 * e.gain_ci95[0]:.0f} to {100 * e.gain_ci95[1]:.0f})"
        rows.append((f"{e.channel} [{CHANNELS[e.channel]}], {e.horizon_s} s", *told, gain))
    table = ScoreTable(
        ("rms error of readings", "as given", "refitted", "with the causes", "gain over refitted"), tuple(rows)
    )
    nats = found.held_out.nats
    likely = (
        f"One-step log likelihood of {found.held_out.samples} held-out readings: as given {nats['base']:.0f}, refitted "
        f"{nats['refit']:.0f}, with the causes {nats['extended']:.0f} nats."
    )
    return Section(
        "What it is worth, on data that no fit has seen",
        (likely,),
        tables=(table,),
        figures=(
            (pictures.held_out(errors), "Open loop under the logged commands; bars: 95 % by bootstrap."),
            (pictures.tracks(found.held_out.replays), "The window whose error is the median, and one of the worst."),
        ),
        note="What sensors should say so long after the start of a window, against what they said; noise is in all.",
    )


def _left_over(found: Diagnosis, before: ResidualForces, after: ResidualForces, maps: Pictures) -> Section:
    pwm, volts = pulse_widths_and_voltage(found.fit.physics)
    speeds = {name: before.x[:, i] for i, name in enumerate(("u [m/s]", "v [m/s]", "r [rad/s]"), 3)}
    if np.isfinite(volts).any():
        speeds["battery [V]"] = volts
    thrusters = {f"{t.name} [us]": pwm[:, i] for i, t in enumerate(found.base.thrusters)}
    return Section(
        "What the model leaves over",
        figures=(
            (pictures.over_time(before, after), "Latent force with 2 sigma: what the equations lack, over time."),
            (pictures.against(before, speeds), f"The same of the refitted base over speeds and voltage. {LINE}"),
            (pictures.against(before, thrusters), "And over the pulse width of each thruster."),
            (pictures.over_heading(before), "And over heading: on the dark ring it is nil, outside it positive."),
            *maps,
            (_whiteness(found), "Correlation of one-step errors: in the grey band they tell nothing of each other."),
        ),
    )


def _whiteness(found: Diagnosis):
    final = found.selection.final.point
    seen = {
        n: int(np.isfinite(final.residuals[..., i]).sum()) for i, n in enumerate(("heading", "yaw rate", "a_x", "a_y"))
    }
    seen |= {"north": len(final.fix_residuals), "east": len(final.fix_residuals)}
    return pictures.whiteness(autocorrelation(found.refit_point), autocorrelation(final), seen)


def _evidence(found: Diagnosis) -> Section:
    names = {e.id: e.name for e in found.fit.effects}
    others: dict[str, tuple[float, float]] = {}
    for c in found.selection.ranking:
        others[names[c.id]] = max((c.nats, c.size), others.get(names[c.id], (-np.inf, 0.0)))
    named = {n.effect.name: n.candidate.nats for n in found.causes}
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


def _adequacy(found: Diagnosis, maps: Pictures = ()) -> list[Section]:
    a = found.adequacy
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


def _apart(found: Diagnosis) -> list[Section]:
    told = found.identifiability
    if told is None:
        return []
    close = told.pairwise.confused
    lines = [f"These logs cannot tell {a} from {b} ({max(nats, 0):.1f} nats)." for a, b, nats in close[:CONFUSED]]
    if len(close) > CONFUSED:
        lines.append(f"So it is with {len(close) - CONFUSED} pairs more.")
    if told.pairwise.hidden:
        lines.append(f"These logs might not have shown, even of medium size: {', '.join(told.pairwise.hidden)}.")
    figure = confusion(told.pairwise)
    return [
        Section(
            "What these logs can tell apart",
            (*lines, told.record.manoeuvre)
            if told.record.manoeuvre
            else tuple(lines) or ("These logs tell apart every pair of causes that they show well.",),
            figures=((figure, "Red: these logs cannot tell the two apart."),) if figure is not None else (),
            note=f"Each cause as if it were there with {MEDIUM:g} times the smallest size worth a name, in the "
            "direction that shows least; every other within its tolerance band.",
        )
    ]


def _visible(found: Diagnosis) -> Section:
    by_name = {e.name: e for e in found.fit.effects}
    rows = []
    for name, (size, unit) in found.visible.items():
        least, least_unit = smallest(by_name[name])
        plain = name in PLAIN
        rows.append((name, size_text(size, "" if plain else unit), size_text(least, "" if plain else least_unit)))
    return Section(
        "What these logs would have shown",
        tables=(ScoreTable(("effect", "from this size on", "smallest size worth a name"), tuple(rows)),),
        note="A true size that these logs would have named on average; much larger ones are not there. Not in the "
        "table: what was named, what these logs would not have shown at any size, and what is looked for in other ways "
        "(rate limits, swapped thrusters, waves, gusts, fixes without line of sight).",
    )


def _noise(found: Diagnosis) -> Section:
    final, stated = found.selection.final.noise, found.fit.physics.vessel.sensors
    rows = [
        ("heading [rad]", f"{final.white[0]:.3g}", f"{stated.imu.heading_sigma_rad:.3g}"),
        ("yaw rate [rad/s]", f"{final.white[1]:.3g}", f"{stated.imu.gyro_sigma_rad_s:.3g}"),
        ("a_x, a_y [m/s^2]", f"{final.white[2]:.3g}, {final.white[3]:.3g}", f"{stated.imu.accel_sigma_m_s2:.3g}"),
        ("position [m]", f"{final.fix_m:.3g}", f"{stated.uwb.range_sigma_m:.3g}"),
    ]
    latent = [("with the causes", final.latent), ("refitted base", found.refit.noise.latent)]
    latent += [("reference log", found.ambient.latent)] if found.ambient else []
    more = tuple((f"latent acceleration, {n}", ", ".join(f"{v:.2g}" for v in values), "") for n, values in latent)
    said = () if found.ambient else ("No reference log: ambient noise is what the model with its causes leaves over.",)
    return Section("Noise card", said, tables=(ScoreTable(("one sigma", "found", "vessel file"), (*rows, *more)),))


def _logs(found: Diagnosis) -> Section:
    rows = []
    for used in found.split.used:
        told = "; ".join(p.text for p in found.problems[used.log.name][:4]) or "-"
        run = used.log.run
        spans = (intervals(used.fitted_s), intervals(used.held_out_s))
        rows.append((used.log.name, f"{run.duration_s:.0f} s", *spans, told, run.data_hash[:12]))
    head = ("log", "length", "fitted [s]", "held out [s]", "problems", "data")
    held = f"Held out: {found.split.rule}."
    return Section("The logs", (held,), tables=(ScoreTable(head, tuple(rows)),), text=True)
