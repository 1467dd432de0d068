"""Do logged roll and pitch level the accelerometers, or follow the boat's own acceleration?

An AHRS without GPS takes part of the specific force for gravity (docs/sitl.md). Levelled by it, accelerometers lose
just what they should show: a fit finds ten times their noise, or none at all. Positions tell, without a model:

    nats = n / 2 log(S_levelled / S_bare)

S: sum of squares that accelerations, levelled and as measured, leave of second differences of positions
(`accelerations`); n: those that do not overlap, in two axes. Over all logs of a boat, for its AHRS is the same. Noise
of a sound attitude harms a little, too: only what is `FOLLOWS` of the acceleration is false.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from msgspec.structs import replace

from companion.core.configuration.vessel_file import VesselFile
from companion.core.constants import GRAVITY_M_S2
from companion.logs.runs.run import LogProblem, Run
from sim.fitting.engine.split import NamedLog, Split, split
from sim.fitting.engine.windows import reads_lean
from sim.fitting.wiring.accelerations import second_differences
from sim.fitting.wiring.record import SURE_NATS

TILT = ("phi_rad", "theta_rad")
"""Columns that level accelerometers."""
NEEDED = (*TILT, "psi_rad", "ax_m_s2", "ay_m_s2", "north_m", "east_m")
FOLLOWS = 0.03
"""Least share of the acceleration that levelling takes away, from which on roll and pitch follow it; assumed: ten times
what white noise of 0.005 rad takes in two minutes."""
UNIT = "tilt"
"""Kind of the problem that roll and pitch seem to be in another unit."""
LEAST_M_S2, TIMES, FEWEST = 0.25, 2.0, 10
"""Least gravity that roll and pitch put into accelerometers (1.5 degrees rms, which no attitude errs by in calm water),
and how many times more than these read; assumed. Noise of 0.02 rad, far more than an autopilot's, puts in as much."""
LEFT_OUT = LogProblem(
    kind="left out",
    text="roll and pitch seem to follow the boat's own acceleration, as of an AHRS without GPS: accelerometers are "
    "taken as they are, without them",
)


def without_tilt(run: Run, why: LogProblem = LEFT_OUT) -> Run:
    """The run without roll and pitch, and a note that says why."""
    notes = tuple(dict.fromkeys((*run.meta.notes, why)))
    return Run(run.table.drop(TILT, strict=False), replace(run.meta, notes=notes), run.whole)


def split_levelled(
    logs: Sequence[NamedLog], held_out: Sequence[NamedLog], vessel: VesselFile, block_s: float | None = None
) -> Split:
    """`split`, without roll and pitch in any log where the fitted parts say that they are no tilt."""
    logs, held_out = in_radians(logs), in_radians(held_out)
    division = split(logs, held_out, vessel, block_s)
    known = any(LEFT_OUT in run.meta.notes for run in division.fitted)
    if known or tilt_is_false(division.fitted):
        return split(_bare(logs), _bare(held_out), vessel, block_s)
    return division


def levelled(logs: Sequence[NamedLog]) -> tuple[NamedLog, ...]:
    """The logs, without roll and pitch where they say that these are no tilt."""
    logs = in_radians(logs)
    return _bare(logs) if tilt_is_false(log.run for log in logs) else tuple(logs)


def in_radians(logs: Sequence[NamedLog]) -> tuple[NamedLog, ...]:
    """The logs, each without roll and pitch that are no radians; a note in it asks for their unit."""
    found = ((log, tilt_unit_fault(log.run)) for log in logs)
    return tuple(NamedLog(log.name, without_tilt(log.run, why)) if why else log for log, why in found)


def _bare(logs: Sequence[NamedLog]) -> tuple[NamedLog, ...]:
    return tuple(NamedLog(log.name, without_tilt(log.run)) for log in logs)


def unlevelled(run: Run) -> list[LogProblem]:
    """What to tell of a log that never had roll and pitch; of those left out, a note in it tells."""
    if not reads_lean(run) or any(note == LEFT_OUT or note.kind == UNIT for note in run.meta.notes):
        return []
    text = "no roll and pitch: log phi_rad and theta_rad if you can; without them accelerometers count for little"
    return [LogProblem(kind="missing", text=text)]


def tilt_unit_fault(run: Run) -> LogProblem | None:
    """What to tell of roll and pitch of which gravity would change accelerometers far more than these read.

    Read as radians; a short boat that follows the surface of waves leans, and reads next to nothing: there levelled
    accelerations explain how its positions move, and nothing is told.
    """
    if not all(run.known(c) for c in NEEDED):
        return None
    tilt, read = run.samples(*TILT)[1], run.samples("ax_m_s2", "ay_m_s2")[1]
    if min(len(tilt), len(read)) < FEWEST:
        return None
    by_tilt, by_reading = (float(np.hypot(*x.std(axis=0))) for x in (GRAVITY_M_S2 * np.sin(tilt), read))
    if by_tilt < max(LEAST_M_S2, TIMES * by_reading):
        return None
    sides = second_differences(run)
    if sides is None or sides.against_levelling_nats < SURE_NATS:
        return None
    text = (
        f"phi_rad, theta_rad: by them gravity in ax_m_s2, ay_m_s2 changes by {by_tilt:.2g} m/s^2 rms, where these read "
        f"{by_reading:.2g}: are they in degrees? They are left out; write radians"
    )
    return LogProblem(kind=UNIT, text=text)


def tilt_is_false(runs: Iterable[Run]) -> bool:
    """Whether it is more likely than not, by the logs `runs` of one boat, that their roll and pitch are no tilt.

    Both are as likely before: a wrong yes makes accelerometers count for little, a wrong no lets a boat be accused of
    what its AHRS does. An attitude that errs by 0.005 rad over seconds, of a hull that never rolls, is worth nothing,
    and is left out by one minute in five.
    """
    found = (second_differences(run) for run in runs if all(run.known(c) for c in NEEDED))
    sides = [one for one in found if one is not None]
    taken = -sum(float(one.felt @ one.gravity) for one in sides)
    there = sum(float(one.felt @ one.felt) for one in sides)
    return taken >= FOLLOWS * there and sum(one.against_levelling_nats for one in sides) > 0.0


def explained_levelled(run: Run) -> tuple[float, float] | None:
    """`explained`, by accelerations levelled or as measured, whichever explain more.

    Nothing is decided about roll and pitch here: accelerations of which an axis is turned may follow them by chance,
    and all turns of the IMU shall be judged alike.
    """
    sides = second_differences(run)
    if sides is None:
        return None
    either = (sides.explained_by(felt) for felt in (sides.felt, sides.felt + sides.gravity))
    return max((found for found in either if found is not None), default=None)
