"""Swapped or reversed columns: positions, heading and accelerations of a log against each other, without a model.

Over any 2 T seconds positions p (NED, [m]) and accelerations a (body axes, [m/s^2]) satisfy

    p(t + T) - 2 p(t) + p(t - T) = integral from -T to T of (T - |s|) R(psi) a(t + s) ds

apart from lever arms of tag and IMU and biases of the accelerometers, which are free here. If the columns as they are
explain little of the variance of the left side, but explain it well with two of them swapped or one reversed, the log
is refused: a diagnosis would blame the boat. So is one with accelerations in another unit; any other factor is told.
"""

from __future__ import annotations

import numpy as np

from companion.core.constants import GRAVITY_M_S2
from companion.core.geometry.frames import rotate
from companion.logs.runs.problems import problems
from companion.logs.runs.run import LogProblem, Run
from companion.logs.runs.unwrap import integrated
from sim.fitting.engine.split import JobError

NEEDED = ("psi_rad", "ax_m_s2", "ay_m_s2", "north_m", "east_m")
SPAN_S = 2.0  # T, at least two intervals of fixes: 0.1 m/s^2 moves a boat by 0.4 m, several sigmas of a fix
RATE_HZ = 10.0
HOLE_S = 1.5  # longest gap between samples that is interpolated
LEAST = 20  # least number of instants t
POOR, GOOD = 0.2, 0.4  # variance explained as it is, and otherwise, at which a log is refused; good logs: 0.6 to 0.96
SCALE = (0.33, 3.0)  # range of the factor on accelerations; outside it something is strange; assumed
UNITS = {"g": GRAVITY_M_S2, "mg": GRAVITY_M_S2 / 1000, "cm/s^2": 0.01}
UNIT_OFF = 0.3  # share by which the factor may miss that of a unit: noise of the accelerometers lowers it; assumed
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
    as_it_is = _explained(run, np.eye(2), np.eye(2))
    if as_it_is is None:
        return
    share, scale = as_it_is
    unit = next((unit for unit, factor in UNITS.items() if abs(scale / factor - 1) <= UNIT_OFF), None)
    if share >= GOOD and unit:
        raise JobError(
            f"{name}: ax_m_s2, ay_m_s2: positions show {scale:.3g} times these accelerations: they are in {unit}; "
            "write them in m/s^2, or leave both columns blank"
        )
    if share >= POOR and scale > 0:
        return
    found = {slip: _explained(run, *undone) or (0.0, 0.0) for slip, undone in SLIPS.items()}
    slip, (better, factor) = max(found.items(), key=lambda item: item[1][0] if item[1][1] > 0 else 0.0)
    if better >= GOOD and SCALE[0] <= factor <= SCALE[1]:
        least = 100 * share if scale > 0 else 0.0
        raise JobError(
            f"{name}: columns {slip}? The accelerations then explain {100 * better:.0f} % of how the positions move, "
            f"as they are {least:.0f} %"
        )


def strange_scale(run: Run) -> list[LogProblem]:
    """A warning where positions and accelerations differ by a factor that is no unit's, as in a log of spins alone."""
    found = _explained(run, np.eye(2), np.eye(2)) if all(run.known(c) for c in NEEDED) else None
    if found is None or found[0] < GOOD or SCALE[0] <= found[1] <= SCALE[1] or found[1] <= 0:
        return []
    text = (
        f"ax_m_s2, ay_m_s2: positions show {found[1]:.3g} times these accelerations: so it looks in a log of spins, or "
        "where they are in another unit; if they are, leave both columns blank"
    )
    return [LogProblem(kind="disagree", text=text)]


def _explained(run: Run, places: np.ndarray, forces: np.ndarray) -> tuple[float, float] | None:
    """Share of the left side's variance that accelerations explain, and their regression factor; None: too few samples.

    `places`, `forces` (2, 2): matrices that are applied to positions and to accelerations first.
    """
    t_fix, fixes = run.samples("north_m", "east_m")
    t_imu, imu = run.samples("psi_rad", "ax_m_s2", "ay_m_s2")
    if len(t_fix) < LEAST or len(t_imu) < LEAST:
        return None
    span_s = max(SPAN_S, 2 * float(np.median(np.diff(t_fix))))
    psi = np.unwrap(imu[:, 0])
    a = imu[:, 1:] @ forces.T + _gravity(run, t_imu)
    fixes = fixes @ places.T
    unit = np.eye(2)
    # 1. Double integrals of R(psi) a and of unit biases in body axes; lever arms ahead and to starboard.
    moved = [_twice(t_imu, _turned(psi, v)) for v in (a, *unit)]
    arms = [_turned(psi, v) for v in unit]
    # 2. Instants t of fixes with samples throughout t - T .. t + T.
    middle = t_fix[(t_fix > max(t_fix[0], t_imu[0]) + span_s) & (t_fix < min(t_fix[-1], t_imu[-1]) - span_s)]
    middle = np.array([t for t in middle if _whole(t_fix, t, span_s) and _whole(t_imu, t, span_s)])
    if len(middle) < LEAST:
        return None
    # 3. Second differences of both sides; biases and arms are projected out; regression of y on x.
    y = _second(t_fix, fixes, middle, span_s).ravel()
    X = np.column_stack([_second(t_imu, x, middle, span_s).ravel() for x in (*moved, *arms)])
    free = X[:, 1:]
    rest = np.column_stack([y, X[:, 0]])
    y, x = (rest - free @ np.linalg.lstsq(free, rest, rcond=None)[0]).T
    cross, own, whole = float(x @ y), float(x @ x), float(y @ y)
    return (cross**2 / (own * whole), cross / own) if own > 0 and whole > 0 else None


def _gravity(run: Run, t_s: np.ndarray) -> np.ndarray:
    """Gravity in the level components of specific force by logged roll and pitch, (n, 2) [m/s^2]; zero without them."""
    if not (run.known("phi_rad") and run.known("theta_rad")):
        return np.zeros((len(t_s), 2))
    at, tilt = run.samples("phi_rad", "theta_rad")
    phi, theta = (np.interp(t_s, at, tilt[:, i]) for i in range(2))
    return GRAVITY_M_S2 * np.column_stack([-np.sin(theta), np.sin(phi)])


def _turned(psi: np.ndarray, v: np.ndarray) -> np.ndarray:
    """R(psi) v, (n, 2); v (2,) or (n, 2)."""
    return np.column_stack(rotate(psi, v[..., 0], v[..., 1]))


def _twice(t_s: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Double integral of `a` (n, 2) over time from zero, (n, 2)."""
    return integrated(integrated(a, t_s), t_s)


def _second(t_s: np.ndarray, x: np.ndarray, at_s: np.ndarray, span_s: float) -> np.ndarray:
    """Second difference x(t + T) - 2 x(t) + x(t - T) at `at_s` (m,), (m, 2)."""
    x_at = [np.column_stack([np.interp(at_s + d, t_s, x[:, i]) for i in range(2)]) for d in (-span_s, 0.0, span_s)]
    return x_at[0] - 2 * x_at[1] + x_at[2]


def _whole(t_s: np.ndarray, middle_s: float, span_s: float) -> bool:
    """Whether no gap of more than `HOLE_S`, or half the span, lies within `span_s` of `middle_s`."""
    first, last = np.searchsorted(t_s, middle_s - span_s, "right") - 1, np.searchsorted(t_s, middle_s + span_s)
    return bool(np.diff(t_s[first : last + 1]).max(initial=0.0) <= max(HOLE_S, span_s / 2))
