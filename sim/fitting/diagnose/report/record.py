"""Output files of a diagnosis, as bytes by name: findings.json, three vessel files, the report. No I/O here."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence

import msgspec
import numpy as np

from companion.core.model.vessel_text import vessel_toml
from sim.fitting.diagnose.job import Diagnosis
from sim.fitting.diagnose.report import findings as form
from sim.fitting.diagnose.report.sentences import sentences
from sim.fitting.diagnose.vessel_edits.public_form import sentence
from sim.fitting.diagnose.vessel_edits.refitted_vessel import ReportedCause
from sim.fitting.wiring import record as wiring_record

RANKED = 12


def outputs(
    diagnosis: Diagnosis,
    vessel_text: str,
    versions: Mapping[str, str],
    command: Sequence[str],
    stamp: str,
    pictured: bool = True,
) -> dict[str, bytes]:
    """All output files. `vessel_text`: text of the base file; `command`: words of the command line; `stamp`: UTC time.

    Without `pictured` the report is left out.
    """
    logs = ", ".join(used.log.name for used in diagnosis.split.used if used.fitted_s)
    head = f"By `aritra diagnose` {stamp} from {logs}; {form.REPORT} and {form.FINDINGS} beside this file.\n"
    headings = {
        form.REFITTED: "Base numbers refitted, without any cause.",
        form.NUMBERS: "Base numbers as they fit beside the causes, which are not in this file.",
        form.EXTENDED: "Base numbers with the causes: the simulation that the logs ask for.",
    }
    vessels = dict(
        zip(headings, (diagnosis.files.refitted, diagnosis.files.numbers, diagnosis.files.extended), strict=True)
    )
    files = {name: vessel_toml(vessel, head + headings[name]).encode() for name, vessel in vessels.items()}
    if diagnosis.wiring.vessel_changed:
        files[wiring_record.VESSEL] = vessel_toml(diagnosis.base, wiring_record.COMMENT).encode()
    if diagnosis.identifiability is not None and (manoeuvre := diagnosis.identifiability.file):
        files[form.MANOEUVRE] = manoeuvre.encode()
    if pictured:
        from sim.fitting.diagnose.report.page import report  # noqa: PLC0415 - matplotlib is slow to load

        files[form.REPORT] = report(diagnosis).encode()
    record = findings(diagnosis, vessel_text, versions, command)
    files[form.FINDINGS] = msgspec.json.format(msgspec.json.encode(record, enc_hook=_plain), indent=1) + b"\n"
    return files


def _plain(value: object) -> object:
    """Scalars of numpy as Python's; TypeError for other types."""
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} has no place in findings.json")


def findings(
    diagnosis: Diagnosis, vessel_text: str, versions: Mapping[str, str], command: Sequence[str]
) -> form.Findings:
    """The content of findings.json."""
    used = [u for u in diagnosis.split.used if u.fitted_s]
    return form.Findings(
        verdict=diagnosis.verdict,
        summary=tuple(sentences(diagnosis)),
        wiring=diagnosis.wiring,
        causes=(
            *(form.wiring_cause(f) for f in diagnosis.wiring.corrected if f.thrusters),
            *(_cause(named) for named in diagnosis.causes),
        ),
        ambiguous_with=diagnosis.ambiguous_with,
        withdrawn=diagnosis.withdrawn,
        depends_on=diagnosis.adequacy.depends_on if diagnosis.adequacy is not None else (),
        equivalence_class={n.effect.name: n.effect.same_as for n in diagnosis.causes if n.effect.same_as},
        ranking=tuple(_ranking(diagnosis)),
        adequacy=diagnosis.adequacy,
        identifiability=diagnosis.identifiability.record if diagnosis.identifiability is not None else None,
        visible_from={k: form.DetectionLimit(size=size, unit=unit) for k, (size, unit) in diagnosis.visible.items()},
        held_out=tuple(_held_out(diagnosis)),
        one_step_nats={name: _number(nats) for name, nats in diagnosis.held_out.nats.items()},
        noise_card=_noise(diagnosis),
        not_in_file=diagnosis.files.not_in_file,
        logs=tuple(_log(diagnosis, i) for i in range(len(diagnosis.split.used))),
        data_hash=hashlib.sha256("".join(u.log.run.data_hash for u in used).encode()).hexdigest(),
        base=diagnosis.base.name,
        base_sha256=hashlib.sha256(vessel_text.encode()).hexdigest(),
        seed=diagnosis.seed,
        runtime_s=diagnosis.runtime_s,
        versions=dict(versions),
        command=tuple(command),
    )


def _cause(named: ReportedCause) -> form.CauseRecord:
    size, unit = named.smallest
    return form.CauseRecord(
        name=named.effect.name,
        sentence=sentence(named.effect.name, named.numbers),
        parameters={
            k: form.ParameterRecord(value=n.value, se=n.se, ci95=n.ci95, unit=n.unit) for k, n in named.numbers.items()
        },
        evidence_nats=named.candidate.nats,
        size=named.candidate.size,
        size_low=named.candidate.lower,
        smallest_size=size,
        smallest_unit=unit,
        form_doubtful=named.form_doubtful,
    )


def _ranking(diagnosis: Diagnosis) -> list[form.RankRecord]:
    """The best variant of each name at the last step, best first, at most `RANKED`."""
    names = {e.id: e.name for e in diagnosis.fit.effects}
    best: dict[str, form.RankRecord] = {}
    for c in diagnosis.selection.ranking:
        one = form.RankRecord(name=names[c.id], evidence_nats=c.nats, size=c.size)
        if one.name not in best or best[one.name].evidence_nats < c.nats:
            best[one.name] = one
    return sorted(best.values(), key=lambda r: -r.evidence_nats)[:RANKED]


def _held_out(diagnosis: Diagnosis) -> list[form.HeldOutRecord]:
    return [
        form.HeldOutRecord(
            horizon_s=e.horizon_s,
            channel=e.channel,
            unit=e.unit,
            base=_number(e.rms["base"]),
            refit=_number(e.rms["refit"]),
            extended=_number(e.rms["extended"]),
            ci={k: (_number(low), _number(high)) for k, (low, high) in (e.ci95 | {"gain": e.gain_ci95}).items()},
            gain=_number(e.gain),
            windows=e.windows,
        )
        for e in diagnosis.held_out.errors
    ]


def _noise(diagnosis: Diagnosis) -> form.NoiseCard:
    noise = diagnosis.selection.final.noise
    heading, rate, x, y = noise.white
    return form.NoiseCard(
        source=f"reference log {diagnosis.reference}"
        if diagnosis.ambient
        else "the logs themselves: no reference log was given",
        heading_rad=heading,
        yaw_rate_rad_s=rate,
        accel_x_m_s2=x,
        accel_y_m_s2=y,
        position_m=noise.fix_m,
        latent=_three(noise.latent),
        latent_base=_three(diagnosis.refit.noise.latent),
        ambient=_three(diagnosis.ambient.latent) if diagnosis.ambient else None,
    )


def _log(diagnosis: Diagnosis, i: int) -> form.FindingsLog:
    used = diagnosis.split.used[i]
    run = used.log.run
    return form.FindingsLog(
        name=used.log.name,
        data_hash=run.data_hash,
        duration_s=run.duration_s,
        fitted_s=used.fitted_s,
        held_out_s=used.held_out_s,
        problems=tuple(p.text for p in diagnosis.problems[used.log.name]),
    )


def _three(values: Sequence[float]) -> tuple[float, float, float]:
    x, y, n = (float(v) for v in values)
    return x, y, n


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
