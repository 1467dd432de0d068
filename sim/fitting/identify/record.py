"""identify.json: results of an identification and what they rest on, for programs. Values not finite are null."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import msgspec
import numpy as np

from companion.core.model.vessel_text import vessel_toml
from companion.logs.runs.run import LogProblem
from sim.fitting.identify.choices import choices
from sim.fitting.identify.job import Identification, Taylor
from sim.fitting.identify.report.page import identify_report
from sim.fitting.identify.result import FitResult
from sim.fitting.identify.trials import Trial
from sim.fitting.taylor.taylor_file import AXES, TaylorFile, taylor_file, taylor_json
from sim.fitting.validate.divergence import Departure
from sim.fitting.validate.scores import Score
from sim.fitting.validate.stability import Stability
from sim.fitting.wiring import record as wiring_record

Number = float | None
Numbers = tuple[Number, ...]
VESSEL, TAYLOR, REPORT, RECORD = "vessel.toml", "taylor.json", "report.html", "identify.json"
OUTPUTS = (VESSEL, TAYLOR, REPORT, RECORD)


class _Struct(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base: an unknown key is an error."""


class IdentifyLog(_Struct, frozen=True, kw_only=True):
    """One log: intervals [s] on its own clock; `data_hash` as in docs/run-format.md."""

    name: str
    data_hash: str
    duration_s: float
    rows: int
    rates_hz: dict[str, float]
    fitted_s: tuple[tuple[float, float], ...]
    held_out_s: tuple[tuple[float, float], ...]
    problems: tuple[LogProblem, ...]


class ChoiceRecord(_Struct, frozen=True, kw_only=True):
    """One choice and where it was made: beforehand, on the command line, or from the fitted parts."""

    what: str
    value: str
    made: str


class StampRecord(_Struct, frozen=True, kw_only=True):
    """When a step was done."""

    what: str
    utc: str


class TaylorRecord(_Struct, frozen=True, kw_only=True):
    """One series. `file`: as taylor.json. `shift`: by axis, how far errors in u, v, r move each coefficient."""

    name: str
    file: TaylorFile
    rank: int
    condition: Number
    condition_scaled: Number
    vif: Numbers
    sigma: Numbers
    r2: Numbers
    shift: tuple[Numbers, ...]


class WhiteRecord(_Struct, frozen=True, kw_only=True):
    """Errors of predictions one second ahead: lag-1 correlation, Ljung-Box p, number."""

    lag1: Number
    p: Number
    n: int


class ModelRecord(_Struct, frozen=True, kw_only=True):
    """One model on the held-out runs: errors by channel over `horizons_s`; see sim.fitting.validate.scores."""

    name: str
    relative_error: Number
    horizons_s: tuple[int, ...]
    count: tuple[int, ...]
    diverged: Numbers
    rms: dict[str, Numbers]
    median: dict[str, Numbers]
    p90: dict[str, Numbers]
    nrmse: dict[str, Number]
    r2: dict[str, Number]
    white: dict[str, WhiteRecord]
    driven_diverged: float
    free_diverged: float
    free_at_rest: float
    departure_s: Numbers
    departure_m: tuple[Numbers, ...]
    departure_diverged: Numbers


class VerdictRecord(_Struct, frozen=True, kw_only=True):
    """The verdict as in the report. Any line of `attention` makes the exit code 1."""

    believe: str | None
    lines: tuple[str, ...]
    attention: tuple[str, ...]
    advice: tuple[tuple[tuple[str, ...], str], ...]


class TrialRecord(_Struct, frozen=True, kw_only=True):
    """One model that was tried on halves of the fitted data; errors over those of the model as it is, null: none."""

    method: str
    refinements: tuple[str, ...]
    error: Number
    halves: Numbers
    kept: bool


class Record(_Struct, frozen=True, kw_only=True):
    """The whole file. `files`: SHA-256 of the other outputs; `vessel_sha256`: that of the input vessel file."""

    format: Literal[1] = 1
    kind: Literal["aritra-identify"] = "aritra-identify"
    versions: dict[str, str]
    command: tuple[str, ...]
    seed: int
    vessel: str
    vessel_sha256: str
    stamps: tuple[StampRecord, ...]
    choices: tuple[ChoiceRecord, ...]
    wiring: wiring_record.WiringReport = wiring_record.WiringReport()
    logs: tuple[IdentifyLog, ...]
    structured: FitResult
    trials: tuple[TrialRecord, ...]
    chosen_because: str
    series: tuple[TaylorRecord, ...]
    pysindy: dict[str, tuple[float, ...]] | None
    reference: str
    held_out: tuple[ModelRecord, ...]
    verdict: VerdictRecord
    files: dict[str, str]


def outputs(
    identification: Identification, vessel_text: str, versions: Mapping[str, str], command: Sequence[str]
) -> dict[str, bytes]:
    """Content of every output file by name. `vessel_text`: the input vessel file; `command`: the command line."""
    logs = ", ".join(used.log.name for used in identification.split.used if used.fitted_s)
    stamp = identification.stamps[-1].utc
    comment = (
        f"Identified by `aritra identify` {stamp} from {logs}.\n"
        f"{identification.verdict.lines[0]}\nIntervals, choices and problems: {REPORT} and {RECORD} beside this file."
    )
    files = {VESSEL: vessel_toml(identification.identified, comment).encode()}
    if identification.series:
        files[TAYLOR] = taylor_json(_file(identification, identification.series[0])) + b"\n"
    if identification.wiring.vessel_changed:
        files[wiring_record.VESSEL] = vessel_toml(identification.base, wiring_record.COMMENT).encode()
    files[REPORT] = identify_report(identification).encode()
    hashes = {name: hashlib.sha256(data).hexdigest() for name, data in files.items()}
    made = record(identification, vessel_text, versions, command, hashes)
    files[RECORD] = msgspec.json.format(msgspec.json.encode(made), indent=1) + b"\n"
    return files


def record(
    identification: Identification,
    vessel_text: str,
    versions: Mapping[str, str],
    command: Sequence[str],
    files: Mapping[str, str],
) -> Record:
    """Content of identify.json; `files`: SHA-256 of the other outputs, by name."""
    validation, verdict = identification.validation, identification.verdict
    triples = zip(validation.scores, validation.stabilities, identification.departures, strict=True)
    peer = None
    if identification.peer is not None:
        peer = {axis: tuple(map(float, row)) for axis, row in zip(AXES, identification.peer, strict=True)}
    return Record(
        versions=dict(versions),
        command=tuple(command),
        seed=identification.choices.seed,
        vessel=identification.base.name,
        vessel_sha256=hashlib.sha256(vessel_text.encode()).hexdigest(),
        stamps=tuple(StampRecord(what=s.what, utc=s.utc) for s in identification.stamps),
        choices=tuple(ChoiceRecord(what=c.what, value=c.value, made=c.made) for c in choices(identification)),
        wiring=identification.wiring,
        logs=tuple(_log(identification, i) for i in range(len(identification.split.used))),
        structured=identification.structured,
        trials=tuple(_trial(trial) for trial in identification.chosen.trials),
        chosen_because=identification.chosen.why,
        series=tuple(_taylor(identification, one) for one in identification.series),
        pysindy=peer,
        reference="; ".join(sorted({r.source for r in validation.references})),
        held_out=tuple(_model(s, t, d, verdict.relative_error.get(s.name)) for s, t, d in triples),
        verdict=VerdictRecord(
            believe=verdict.believe, lines=verdict.lines, attention=verdict.attention, advice=verdict.advice
        ),
        files=dict(files),
    )


def _log(identification: Identification, i: int) -> IdentifyLog:
    used = identification.split.used[i]
    run = used.log.run
    return IdentifyLog(
        name=used.log.name,
        data_hash=run.data_hash,
        duration_s=run.duration_s,
        rows=run.table.height,
        rates_hz=run.rates_hz(),
        fitted_s=used.fitted_s,
        held_out_s=used.held_out_s,
        problems=tuple(identification.problems[used.log.name]),
    )


def _file(identification: Identification, one: Taylor) -> TaylorFile:
    logs = ", ".join(used.log.name for used in identification.split.used if used.fitted_s)
    return taylor_file(one.fit, f"{logs}; samples by {one.pipeline}")


def _taylor(identification: Identification, one: Taylor) -> TaylorRecord:
    fit = one.fit
    return TaylorRecord(
        name=one.name,
        file=_file(identification, one),
        rank=fit.rank,
        condition=_number(fit.condition),
        condition_scaled=_number(fit.condition_scaled),
        vif=_numbers(fit.vif),
        sigma=_numbers(fit.sigma),
        r2=_numbers(fit.r2),
        shift=tuple(_numbers(row) for row in one.shift),
    )


def _trial(trial: Trial) -> TrialRecord:
    return TrialRecord(
        method=trial.method,
        refinements=trial.refinements,
        error=_number(trial.error),
        halves=_numbers(np.array(trial.halves)),
        kept=trial.kept,
    )


def _model(score: Score, stable: Stability, departure: Departure, relative_error: float | None) -> ModelRecord:
    white = {k: WhiteRecord(lag1=_number(w.lag1), p=_number(w.p), n=w.n) for k, w in score.white.items()}
    return ModelRecord(
        name=score.name,
        relative_error=None if relative_error is None else _number(relative_error),
        horizons_s=score.horizons_s,
        count=tuple(map(int, score.count)),
        diverged=_numbers(score.diverged),
        rms={k: _numbers(v) for k, v in score.rms.items()},
        median={k: _numbers(v) for k, v in score.median.items()},
        p90={k: _numbers(v) for k, v in score.p90.items()},
        nrmse={k: _number(v) for k, v in score.nrmse.items()},
        r2={k: _number(v) for k, v in score.r2.items()},
        white=white,
        driven_diverged=stable.driven_diverged,
        free_diverged=stable.free_diverged,
        free_at_rest=stable.free_at_rest,
        departure_s=_numbers(departure.t_s),
        departure_m=tuple(_numbers(row) for row in departure.position_m),
        departure_diverged=_numbers(departure.diverged),
    )


def _number(value: Any) -> Number:
    return float(value) if np.isfinite(value) else None


def _numbers(values: np.ndarray) -> Numbers:
    return tuple(_number(v) for v in values)
