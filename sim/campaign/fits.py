"""One identification or diagnosis, of logs that are there or of a simulated drive, and its figures."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from msgspec.structs import replace

from companion.core.configuration.site_file import Site, load_site
from companion.core.configuration.tables import ConfigError
from companion.core.configuration.vessel_file import VesselFile
from companion.logs.readers.read_run import ReadOptions, read_run
from companion.logs.runs.run import Run
from sim.campaign.case_files import CaseSetup
from sim.campaign.file import Diagnose, Identify
from sim.campaign.runners.job import Figure, Work
from sim.fitting.diagnose import job as diagnosis
from sim.fitting.engine.parameters import Parameters, file_values
from sim.fitting.engine.split import NamedLog
from sim.fitting.identify import job as identification
from sim.world.environment import Weather, with_terms_of
from sim.world.teleop_log import teleop_run

TRUTH = "true_"
REFERENCE_SEED = 1_000_003
"""Added to the case's seed for the calm log, so that it is not the same drive."""
SHOWN_S = 10
"""Horizon of the held-out errors that become figures, as the reports of both commands have it."""


def identify_figures(case: CaseSetup, work: Work) -> dict[str, Figure]:
    """Fit the believed vessel; which model to believe, every parameter, and whether its interval holds the truth."""
    settings: Identify = work.settings
    logs, held_out = (
        _logs(case, work, settings.drive_s),
        [NamedLog(r.meta.source, r) for r in _read(work, case, "held_out")],
    )
    choices = identification.Choices(block_s=settings.block_s, taylor=settings.taylor, seed=work.seed)
    found = identification.identify(logs, held_out, case.vessel, choices, lambda: "")
    fit, verdict = found.structured, found.verdict
    out: dict[str, Figure] = {
        "believe": verdict.believe,
        "attention": len(verdict.attention),
        "converged": fit.converged,
        "white": fit.white,
        "iterations": fit.iterations,
    }
    out |= {f"relative_error_{name.replace(' ', '_')}": error for name, error in verdict.relative_error.items()}
    if settings.drive_s:
        names = Parameters(case.truth, unmeasured_imu=True).names
        true = dict(zip(names, file_values(case.truth, unmeasured_imu=True), strict=True))
        of_truth = [p for p in fit.parameters if p.name in true]  # current and wind are the day's
        sure = [p for p in of_truth if p.determined and not p.name.startswith("warp_")]
        held = [p.ci95[0] <= true[p.name] <= p.ci95[1] for p in sure]
        out["intervals_that_hold"] = float(np.mean(held)) if held else None
        out |= {f"{p.name}_true": float(true[p.name]) for p in of_truth}
    return out | {p.name: p.value for p in fit.parameters} | {f"{p.name}_se": p.se for p in fit.parameters}


def diagnose_figures(case: CaseSetup, work: Work) -> dict[str, Figure]:
    """Diagnose; the verdict, causes with their numbers, and what they gain on held-out data."""
    settings: Diagnose = work.settings
    logs = [log.run for log in _logs(case, work, settings.drive_s)]
    calm = _read(work, case, "reference")
    if settings.reference_s:
        calm = [_drive(case.vessel, case.vessel, work.seed + REFERENCE_SEED, settings.reference_s, Weather())]
    found = diagnosis.diagnose(
        logs, case.vessel, reference=calm[0] if calm else None, held_out=_read(work, case, "held_out"),
        block_s=settings.block_s, identifiability=None, seed=work.seed,
    )  # fmt: skip
    out: dict[str, Figure] = {
        "verdict": found.verdict,
        "causes": " + ".join(sorted(n.effect.name for n in found.causes)),
        "ambiguous_with": " + ".join(sorted(found.ambiguous_with)),
        "withdrawn": " + ".join(sorted(found.withdrawn)),
    }
    out |= {f"gain_{e.channel}": float(e.gain) for e in found.held_out.errors if e.horizon_s == SHOWN_S}
    for n in found.causes:
        out[f"{n.effect.name}.nats"] = float(n.candidate.nats)
        out |= {f"{n.effect.name}.{key}": float(number.value) for key, number in n.numbers.items()}
    return out


def _logs(case: CaseSetup, work: Work, drive_s: float | None) -> list[NamedLog]:
    if drive_s is None:
        return [NamedLog(run.meta.source, run) for run in _read(work, case, "log")]
    weather = with_terms_of(case.weather, case.truth)
    run = _drive(case.truth, case.vessel, work.seed, drive_s, weather)
    return [NamedLog(run.meta.source, run)]


def _drive(true: VesselFile, believed: VesselFile, seed: int, drive_s: float, weather: Weather) -> Run:
    """A log of the true boat by somebody at a keyboard who goes by the believed one; without the truth in it."""
    uwb = true.sensors.tag
    run = teleop_run(true, seed, drive_s, uwb_hz=uwb.rate_Hz, sigma_m=uwb.range_sigma_m, weather=weather,
                     believed=believed)  # fmt: skip
    return Run(run.table.select([c for c in run.table.columns if not c.startswith(TRUTH)]), run.meta)


def _read(work: Work, case: CaseSetup, role: str) -> list[Run]:
    """Logs of a role. ConfigError where one is no longer what the campaign began with."""
    beside, runs = ReadOptions(case.vessel, _site(work.texts, work.names)), []
    for path, digest in work.logs.get(role, ()):
        if hashlib.sha256(Path(path).read_bytes()).hexdigest() != digest:
            raise ConfigError(f"{path}: is not what it was when the campaign was read")
        run = read_run(Path(path), beside)
        runs.append(type(run)(run.table, replace(run.meta, source=path)))
    return runs


def _site(texts: Mapping[str, str], names: Mapping[str, str]) -> Site | None:
    return load_site(texts["site"], name=names["site"]) if "site" in texts else None
