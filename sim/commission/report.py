"""The report of a commissioning: what came of it, what each stage told, which file to believe, what is left to do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from companion.core.configuration.site_file import Site
from companion.core.messages import StateEstimate
from companion.logs.log_file import LogError, LogFile
from companion.logs.series import KNOWN, broken
from sim.commission.belief import BoatBelief
from sim.commission.job import BEGINNING, NEW, OLD, CommissionOutcome
from sim.commission.journal import LOG, FlightJournal, stage_of
from sim.commission.stages import STAGES
from sim.fitting.identify.report.tables import parameter_table
from sim.fitting.identify.structured_fit import UNMEASURED
from sim.fitting.identify.vessel_out import COMPASS_RAD
from sim.fitting.validate.report import Section, page
from sim.fitting.validate.table import ScoreTable
from sim.fitting.wiring.compass import HARD_IRON
from sim.fitting.wiring.record import WiringFinding


def verdict(outcome: CommissionOutcome) -> list[str]:
    """What came of it, in sentences."""
    minutes = sum(record.seconds for _, record in outcome.flights) / 60
    lines = [f"{'Commissioned' if outcome.reached else 'Not commissioned'} after {minutes:.1f} minutes of flight."]
    if outcome.why:
        lines.append(f"Why not: {outcome.why}.")
    if outcome.proof:
        errors = ", ".join(f"{name} {error:.0%}" for name, error in outcome.proof.errors.items())
        lines.append(
            f"Error of predictions on a manoeuvre that no fit has seen (100 %: no better than without a model): "
            f"{errors}. To be believed: {outcome.proof.best}."
        )
    driven = {name: record.cross_track_rms_m for name, record in outcome.flights if record.cross_track_rms_m}
    new = outcome.proof is None or outcome.proof.best != BEGINNING
    for name, what in ((OLD, "With the first file"), (NEW, "With the new file" if new else "With the first file")):
        if name in driven:
            lines.append(
                f"{what} the mission's cross-track error was {driven[name]:.3f} m rms, by the boat's estimate."
            )
    return lines


def person(outcome: CommissionOutcome) -> list[str]:
    """What only a person can do, in sentences."""
    belief, fit = outcome.belief, outcome.belief.fit
    if fit is None:
        return [_wiring(finding) for finding in belief.wiring.findings]
    lines = [_wiring(finding) for finding in belief.wiring.findings if finding.name != HARD_IRON]  # the fit has it
    if abs(fit.heading_offset_rad) > COMPASS_RAD:
        lines.append(
            f"The heading is off by {np.degrees(fit.heading_offset_rad):.0f} degrees. The new file says so; better "
            "still, calibrate the compass, and look whether the autopilot is mounted straight."
        )
    if (iron_deg := _hard_iron_deg(belief)) > np.degrees(COMPASS_RAD):
        lines.append(
            f"The heading errs by up to {iron_deg:.0f} degrees, by how the boat is turned, beyond what the first file "
            "has. The new file says so; better still, calibrate the compass where the boat sails, away from iron."
        )
    lines.append(
        "Weigh the boat: motion shows forces only over inertia, so mass and thrust may be too large or too small "
        "together. It makes no difference to how the boat drives."
    )
    return lines


def _hard_iron_deg(belief: BoatBelief) -> float:
    """Largest error of the heading by how the boat is turned, as believed, beyond what the first file has."""
    new, old = belief.vessel.sensors.imu, belief.first.sensors.imu
    off = new.hard_iron_cos_rad - old.hard_iron_cos_rad, new.hard_iron_sin_rad - old.hard_iron_sin_rad
    return float(np.degrees(np.hypot(*off)))


def _wiring(finding: WiringFinding) -> str:
    nats = f" ({finding.nats:g} nats over the file)" if finding.nats is not None else ""
    if finding.certain and finding.thrusters:
        return f"Correct the wiring: {finding.text}{nats}. Or leave it: the new file has it as it is connected."
    if finding.certain:
        return f"Correct it: {finding.text}{nats}. The fit went on with that put right, the boat does not."
    return f"Look: perhaps {finding.text}{nats}."


def stage_table(outcome: CommissionOutcome) -> ScoreTable:
    """A row for each stage: flights, minutes, nats, and why it was over."""
    names = [*(stage.name for stage in STAGES), OLD, NEW]
    rows = []
    for name in names:
        own = [record for stage, record in outcome.flights if stage == name]
        if not own and name not in outcome.over:
            continue
        gained = [r.gained for r in own if r.gained is not None]
        rows.append(
            (
                name,
                str(len(own)),
                f"{sum(r.seconds for r in own) / 60:.1f}",
                f"{sum(r.nats for r in own):.1f}" if any(r.nats for r in own) else "",
                f"{sum(gained):.1f}" if gained else "",
                outcome.over.get(name, "; ".join(r.ending for r in own)),
            )
        )
    return ScoreTable(("stage", "flights", "minutes", "nats expected", "nats told", "over because"), tuple(rows))


def tracks(journal: FlightJournal, site: Site) -> Figure:
    """Where the boat was, by its own estimate: each stage in a colour, inside the fence."""
    figure = Figure(figsize=(7.5, 6), layout="constrained")
    axes = figure.subplots()
    fence = np.array([*site.fence, site.fence[0]])
    axes.plot(fence[:, 1], fence[:, 0], color="black", label="fence")
    colours: dict[str, str] = {}
    for folder in journal.flights():
        name = stage_of(folder)
        place = _places(folder / LOG)
        known = name in colours
        colours.setdefault(name, f"C{len(colours)}")
        axes.plot(place[:, 1], place[:, 0], lw=0.9, color=colours[name], label=None if known else name)
    axes.set(xlabel="east [m]", ylabel="north [m]", aspect="equal")
    figure.legend(fontsize=8, loc="outside right upper")
    return figure


def _places(log: Path) -> np.ndarray:
    """North, east (n, 2) of a log by its estimate, NaN where the boat did not know its place, or nothing is logged."""
    try:
        estimates = [m for m in LogFile(log).messages(StateEstimate) if isinstance(m, StateEstimate)]
    except LogError:
        estimates = []
    places = [(m.north_m, m.east_m) if m.health in KNOWN else (np.nan, np.nan) for m in estimates]
    return broken(np.array([m.t_ns * 1e-9 for m in estimates]), np.array(places).reshape(-1, 2))


def report(outcome: CommissionOutcome, journal: FlightJournal, site: Site, files: Mapping[str, str]) -> str:
    """The page, as text. `files`: what was written, by name: what it is."""
    sections = [
        Section("What came of it", tuple(verdict(outcome)), look=not outcome.reached),
        Section("What only a person can do", tuple(person(outcome)) or ("Nothing.",)),
        Section("Files", tuple(f"{name}: {what}" for name, what in files.items())),
        Section(
            "Stages", tables=(stage_table(outcome),), text=True, figures=((tracks(journal, site), "By estimate."),)
        ),
    ]
    if outcome.causes:
        sections.insert(2, Section("What else there is", _causes(outcome.causes)))
    fit, model = outcome.belief.fit, outcome.belief.model
    if fit is not None and model is not None:
        note = "current_*, wind_*: of the day, not written to the file."
        table = parameter_table(fit, model, UNMEASURED)
        sections.append(Section("Parameters", tables=(table,), note=note))
    return page(f"Commissioning of {outcome.vessel.name}", sections)


def _causes(lines: Sequence[str]) -> tuple[str, ...]:
    return (*lines, "Found by the diagnosis of all logs; what belongs to the day (current, wind) is not in the file.")
