"""Swapped or reversed columns: positions, heading and accelerations of a log against each other, without a model.

If the columns as they are explain little of how the positions move (`sim.fitting.wiring.accelerations`), but much with
two of them swapped or one reversed, the log is refused: a diagnosis would blame the boat. So is one with accelerations
in another unit; any other factor is told. `sim.fitting.wiring` puts most of this right before it comes here.
"""

from __future__ import annotations

import numpy as np

from companion.logs.runs.problems import problems
from companion.logs.runs.run import LogProblem, Run
from sim.fitting.engine.split import JobError
from sim.fitting.wiring.accelerations import GOOD, POOR, explained, unit_of

NEEDED = ("psi_rad", "ax_m_s2", "ay_m_s2", "north_m", "east_m")
SCALE = (0.33, 3.0)  # range of the factor on accelerations; outside it something is strange; assumed
SLIPS = {
    "north_m, east_m: swapped": (np.array([[0, 1], [1, 0]]), np.eye(2)),
    "ax_m_s2, ay_m_s2: swapped": (np.eye(2), np.array([[0, 1], [1, 0]])),
    "ay_m_s2: positive to port": (np.eye(2), np.diag([1, -1])),
    "ax_m_s2: positive astern": (np.eye(2), np.diag([-1, 1])),
    "east_m: positive to the west": (np.diag([1, -1]), np.eye(2)),
    "north_m: positive to the south": (np.diag([-1, 1]), np.eye(2)),
    "ax_m_s2, ay_m_s2: both reversed, or psi_rad half a turn off": (np.eye(2), -np.eye(2)),
}
"""By fault, the matrices (2, 2) on positions and on accelerations that undo it."""


def reject_swapped_columns(run: Run) -> None:
    """Raises JobError naming the log and the columns that are swapped, reversed or in other units."""
    name = run.meta.source
    for problem in problems(run):
        if problem.kind == "disagree" and problem.text.endswith("?"):
            raise JobError(f"{name}: {problem.text}")
    if not all(run.known(c) for c in NEEDED):
        return
    as_it_is = explained(run)
    if as_it_is is None:
        return
    share, scale = as_it_is
    if unit := unit_of(share, scale):
        raise JobError(
            f"{name}: ax_m_s2, ay_m_s2: positions show {scale:.3g} times these accelerations: they are in {unit}; "
            "write them in m/s^2, or leave both columns blank"
        )
    if share >= POOR and scale > 0:
        return
    found = {slip: explained(run, *undone) or (0.0, 0.0) for slip, undone in SLIPS.items()}
    slip, (better, factor) = max(found.items(), key=lambda item: item[1][0] if item[1][1] > 0 else 0.0)
    if better >= GOOD and SCALE[0] <= factor <= SCALE[1]:
        least = 100 * share if scale > 0 else 0.0
        raise JobError(
            f"{name}: columns {slip}? The accelerations then explain {100 * better:.0f} % of how the positions move, "
            f"as they are {least:.0f} %"
        )


def strange_scale(run: Run) -> list[LogProblem]:
    """A warning where positions and accelerations differ by a factor that is no unit's, as in a log of spins alone."""
    found = explained(run) if all(run.known(c) for c in NEEDED) else None
    if found is None or found[0] < GOOD or SCALE[0] <= found[1] <= SCALE[1] or found[1] <= 0:
        return []
    text = (
        f"ax_m_s2, ay_m_s2: positions show {found[1]:.3g} times these accelerations: so it looks in a log of spins, or "
        "where they are in another unit; if they are, leave both columns blank"
    )
    return [LogProblem(kind="disagree", text=text)]
