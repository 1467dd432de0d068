"""Sentences of a diagnosis for the terminal and the head of the report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from companion.logs.runs.as_if_blank import DEAD_SENSOR, HELD_READINGS
from companion.logs.runs.problems import BIASING, problem_sentences
from sim.fitting.diagnose.job import Diagnosis
from sim.fitting.diagnose.selection.held_out import LEAST_BLOCKS, HeldOutScore, OpenLoopError
from sim.fitting.diagnose.vessel_edits.public_form import sentence
from sim.fitting.engine.split import OTHER_BOAT, UNCERTAIN

SHOWN_S = 10
ROUGH, QUIET_M_S2 = 2.0, 0.01  # latent acceleration of an unusable reference over the logs', or this; assumed
TOLD = (*BIASING, *UNCERTAIN, DEAD_SENSOR, HELD_READINGS, OTHER_BOAT)
"""Kinds of problems of the logs that stand beside the verdict; all are in the report."""
WORTH = 0.1
"""Share of the held-out error below which other numbers are not worth another file; assumed."""
WORDS = {
    "time": "time",
    "position": "the place in the basin",
    "heading": "the heading",
    "speed": "the speed",
    "thruster": "a thruster",
    "voltage": "the battery's voltage",
    "load": "the load of all thrusters",
}
"""Text for the words of `depends_on`; `thruster:NAME` stands for one thruster."""


def sentences(diagnosis: Diagnosis) -> list[str]:
    """Sentences: verdict, causes, residual, withdrawn causes, rivals, gain on held-out logs, logs, what to do."""
    lines = [*diagnosis.wiring.lines, _verdict(diagnosis)]
    lines += [sentence(n.effect.name, n.numbers) for n in diagnosis.causes]
    if diagnosis.verdict in ("partial", "unknown"):
        lines += [_residual_dependence(diagnosis), *_doubtful(diagnosis)]
    lines += _withdrawn(diagnosis.withdrawn)
    lines += [f"These logs cannot tell {name} from {', '.join(others)}." for name, others in diagnosis.confused.items()]
    lines += [_same(n.effect.name, n.effect.same_as) for n in diagnosis.causes if n.effect.same_as]
    if diagnosis.causes:
        lines += [gain_sentence(diagnosis.held_out, len(diagnosis.causes)), *_outside(diagnosis)]
    if diagnosis.verdict == "none":
        lines += [*_detection_limits(diagnosis), kept_sentence(diagnosis.held_out)]
    if _rough_reference(diagnosis):
        lines.append(
            f"The reference log {diagnosis.reference} holds more force that nobody can foretell than the logs "
            "themselves: it was not calm, or something was wrong already. Faults may hide behind its noise; record "
            "another, or leave it out."
        )
    lines += problem_sentences(diagnosis.problems, TOLD)
    if diagnosis.identifiability is not None and diagnosis.identifiability.record.manoeuvre:
        lines.append(diagnosis.identifiability.record.manoeuvre)
    return [*lines, *diagnosis.wiring.open_lines]


def _rough_reference(diagnosis: Diagnosis) -> bool:
    if diagnosis.ambient is None:
        return False
    logs = np.maximum(np.array(diagnosis.refit.noise.latent), QUIET_M_S2)
    return bool((np.array(diagnosis.ambient.latent) > ROUGH * logs).any())


def _verdict(diagnosis: Diagnosis) -> str:
    count, logs = len(diagnosis.causes) + len(diagnosis.wiring.corrected), _logs(diagnosis)
    if diagnosis.verdict == "named" and not diagnosis.causes:
        return (
            f"{logs}: with that put right, nothing else is wrong with {diagnosis.base.name} that these logs can show."
        )
    are = "one cause is" if count == 1 else f"{count} causes are"
    they = "it explains" if count == 1 else "they explain"
    return {
        "none": f"{logs}: nothing is wrong with {diagnosis.base.name} that these logs can show.",
        "named": f"{logs}: {are} named, and {they} what the "
        f"simulation of {diagnosis.base.name} gets wrong.",
        "partial": f"{logs}: {are} named, but something is left over.",
        "ambiguous": f"{logs}: something is wrong, but these logs cannot tell which of several causes it is.",
        "unknown": f"{logs}: something is wrong that the catalogue cannot explain.",
    }[diagnosis.verdict]  # fmt: skip


def _logs(diagnosis: Diagnosis) -> str:
    used = [u for u in diagnosis.split.used if u.fitted_s]
    return f"{len(used)} log{'s' if len(used) > 1 else ''}, {diagnosis.split.fitted_length_s / 60:.1f} minutes"


def dependency_text(word: str) -> str:
    """Text for a word of `depends_on`."""
    head, _, tail = word.partition(":")
    return f"thruster {tail}" if tail else WORDS.get(head, head)


def _residual_dependence(diagnosis: Diagnosis) -> str:
    words = list(diagnosis.adequacy.depends_on) if diagnosis.adequacy is not None else []
    which = next((w for w in words if w.startswith("thruster:")), "thruster")
    words = list(dict.fromkeys(which if w == "thruster" else w for w in words))
    if not words:
        return "What is left over does not clearly depend on anything that was logged."
    others = f", perhaps on {' or '.join(dependency_text(w) for w in words[1:3])}" if len(words) > 1 else ""
    see = " (see the map)" if words[0] == "position" else ""
    return f"What is left over depends on {dependency_text(words[0])}{see}{others}."


def _withdrawn(withdrawn: Mapping[str, str]) -> list[str]:
    """One sentence for each reason, with the causes withdrawn for it."""
    lines = []
    for why in dict.fromkeys(withdrawn.values()):
        *others, last = (name for name, reason in withdrawn.items() if reason == why)
        what = f"{', '.join(others)} and {last} were" if others else f"{last} was"
        lines.append(f"{what} found in the fitted logs, but {'are' if others else 'is'} not named: {why}.")
    return lines


def _doubtful(diagnosis: Diagnosis) -> list[str]:
    names = [n.effect.name for n in diagnosis.causes if n.form_doubtful]
    return [f"What is left over is of the kind of {name}: it may be there in another form." for name in names]


def _same(name: str, others: Sequence[str]) -> str:
    return f"No log can tell {name} from {', '.join(others)}: they leave the same signature."


def error_at(held_out: HeldOutScore, channel: str, horizon_s: int) -> OpenLoopError | None:
    """Error of `channel` at `horizon_s`, or None where the held-out logs are too short."""
    return next((e for e in held_out.errors if e.channel == channel and e.horizon_s == horizon_s), None)


def gain_sentence(held_out: HeldOutScore, count: int) -> str:
    """What it is worth on held-out data that `count` causes were found."""
    error = error_at(held_out, "position", SHOWN_S)
    if error is None or not np.isfinite(error.gain):
        return "What removing this is worth could not be measured on the held-out logs."
    subject = "this error" if count == 1 else "these errors"
    before, after = error.rms["refit"], error.rms["extended"]
    low, high = (100 * g for g in error.gain_ci95)
    if low <= 0 <= high and error.blocks < LEAST_BLOCKS:
        return (
            f"What was held out is too short to say what removing {subject} is worth: the {SHOWN_S} s position error "
            f"is {before:.3g} m refitted and {after:.3g} m with the causes, in {_windows(error)}."
        )
    if low <= 0 <= high or abs(error.gain) < 0.01:
        return (
            f"Removing {subject} changes the {SHOWN_S} s position error on held-out data by little: {before:.3g} m "
            f"refitted, {after:.3g} m with the causes."
        )
    word, low, high = ("cuts", low, high) if error.gain > 0 else ("raises", -high, -low)
    doubt = "" if error.gain > 0 else " What explains the fitted logs does not carry over: do not rely on it."
    return (
        f"Removing {subject} {word} the {SHOWN_S} s position error on held-out data by {100 * abs(error.gain):.0f} % "
        f"(95 %: {low:.0f} to {high:.0f}): from {before:.3g} m, refitted within its tolerances, to {after:.3g} m; as "
        f"given it was {error.rms['base']:.3g} m.{doubt}"
    )


def kept_sentence(held_out: HeldOutScore) -> str:
    """Which file to use where nothing is wrong: the numbers may be better within their tolerances all the same."""
    error = error_at(held_out, "position", SHOWN_S)
    if error is None or not error.rms["refit"] < (1 - WORTH) * error.rms["base"]:
        return "Keep its file."
    better = (
        f"Its numbers refitted within their tolerances make the {SHOWN_S} s position error on held-out data "
        f"{error.rms['refit']:.3g} m instead of {error.rms['base']:.3g} m"
    )
    if error.refit_gain_ci95[0] > 0:
        return f"{better}: use refitted.toml."
    return f"{better}, which may be chance in {_windows(error)}: keep its file, or record more to be sure."


def _windows(error: OpenLoopError) -> str:
    """How much an error was measured on."""
    count = "counts" if error.blocks == 1 else "count"
    return f"{error.windows} windows of which {error.blocks} {count} as independent"


def _outside(diagnosis: Diagnosis) -> list[str]:
    return [f"{name} is not in extended.toml: {why}." for name, why in diagnosis.files.not_in_file.items()]


def _detection_limits(diagnosis: Diagnosis) -> list[str]:
    """Sentence with the detection limits of a few common effects."""
    wanted = (
        "thruster_gain",
        "current",
        "hull_fouling",
        "payload",
        "lag",
        "heading_offset",
        "uwb_latency",
        "gnss_latency",
    )
    limits = []
    for head in wanted:
        sizes = [v for name, v in diagnosis.visible.items() if name.partition(":")[0] == head]
        if sizes:
            size, unit = max(sizes)
            limits.append(f"{head} from {size_text(size, unit)} on")
    return [f"These logs would have shown {', '.join(limits)}."] if limits else []


def size_text(size: float, unit: str) -> str:
    """A size with its unit; shares (unit 1) in per cent."""
    return f"{100 * size:.2g} %" if unit == "1" else f"{size:.2g} {unit}".rstrip()
