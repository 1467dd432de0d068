"""How well a log's accelerations explain how its positions move, without a model.

Over any 2 T seconds positions p (NED, [m]) and accelerations a (body axes, [m/s^2]) satisfy

    p(t + T) - 2 p(t) + p(t - T) = integral from -T to T of (T - |s|) R(psi) a(t + s) ds

apart from lever arms of tag and IMU and biases of the accelerometers, which are free here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.constants import GRAVITY_M_S2
from companion.core.geometry.frames import rotate
from companion.logs.runs.run import Run
from companion.logs.runs.unwrap import integrated

SPAN_S = 2.0  # T, at least two intervals of fixes: 0.1 m/s^2 moves a boat by 0.4 m, several sigmas of a fix
HOLE_S = 1.5  # longest gap between samples that is interpolated
LEAST = 20  # least number of instants t
UNTURNED = np.eye(2)
POOR, GOOD = 0.2, 0.4  # share explained that is too little as logged, and enough otherwise; good logs: 0.6 to 0.96
UNITS = {"g": GRAVITY_M_S2, "mg": GRAVITY_M_S2 / 1000, "cm/s^2": 0.01}
UNIT_OFF = 0.3  # share by which the factor may miss that of a unit: noise of the accelerometers lowers it; assumed


@dataclass(frozen=True)
class SecondDifferences:
    """Both sides of the equation at its instants, (2 k,), without what is free.

    felt      of specific force as measured; gravity: of what roll and pitch add to it, zero without them
    apart     how many instants there are of which no two share a fix
    """

    moved: np.ndarray
    felt: np.ndarray
    gravity: np.ndarray
    apart: int

    def explained_by(self, accelerations: np.ndarray) -> tuple[float, float] | None:
        """Share of the left side's variance that `accelerations` (2 k,) explain, and their regression factor."""
        y, x = self.moved, accelerations
        cross, own, whole = float(x @ y), float(x @ x), float(y @ y)
        return (cross**2 / (own * whole), cross / own) if own > 0 and whole > 0 else None

    @property
    def against_levelling_nats(self) -> float:
        """Evidence that accelerations explain more as they were measured than levelled; 0 where nothing is left."""
        bare = self.moved - self.felt
        levelled = bare - self.gravity
        left, left_levelled = float(bare @ bare), float(levelled @ levelled)
        return self.apart * float(np.log(left_levelled / left)) if left > 0 and left_levelled > 0 else 0.0


def second_differences(
    run: Run, places: np.ndarray = UNTURNED, forces: np.ndarray = UNTURNED
) -> SecondDifferences | None:
    """Both sides of the equation for a log; None: too few samples.

    `places`, `forces` (2, 2): matrices that are applied to positions and to accelerations first.
    """
    t_fix, fixes = run.samples("north_m", "east_m")
    t_imu, imu = run.samples("psi_rad", "ax_m_s2", "ay_m_s2")
    if len(t_fix) < LEAST or len(t_imu) < LEAST:
        return None
    span_s = max(SPAN_S, 2 * float(np.median(np.diff(t_fix))))
    psi = np.unwrap(imu[:, 0])
    fixes = fixes @ places.T
    # 1. Double integrals of R(psi) a and of unit biases in body axes; lever arms ahead and to starboard.
    felt = [twice(t_imu, turned(psi, v)) for v in (imu[:, 1:] @ forces.T, _gravity(run, t_imu))]
    free = [*(twice(t_imu, turned(psi, v)) for v in UNTURNED), *(turned(psi, v) for v in UNTURNED)]
    # 2. Instants t of fixes with samples throughout t - T .. t + T.
    middle = t_fix[(t_fix > max(t_fix[0], t_imu[0]) + span_s) & (t_fix < min(t_fix[-1], t_imu[-1]) - span_s)]
    middle = np.array([t for t in middle if unbroken(t_fix, t, span_s) and unbroken(t_imu, t, span_s)])
    if len(middle) < LEAST:
        return None
    # 3. Second differences of both sides; biases and arms are projected out.
    y = second(t_fix, fixes, middle, span_s).ravel()
    X, basis = (np.column_stack([second(t_imu, x, middle, span_s).ravel() for x in some]) for some in (felt, free))
    sides = np.column_stack([y, X])
    moved, bare, gravity = (sides - basis @ np.linalg.lstsq(basis, sides, rcond=None)[0]).T
    return SecondDifferences(moved, bare, gravity, len(np.unique(middle // (2 * span_s))))


def explained(run: Run, places: np.ndarray = UNTURNED, forces: np.ndarray = UNTURNED) -> tuple[float, float] | None:
    """Share of the left side's variance that accelerations explain, and their regression factor; None: too few samples.

    `places`, `forces`: as of `second_differences`.
    """
    sides = second_differences(run, places, forces)
    return None if sides is None else sides.explained_by(sides.felt + sides.gravity)


def unit_of(share: float, factor: float) -> str | None:
    """The unit of accelerations by share and factor of `explained`; None: m/s^2, or not clear."""
    return next((u for u, f in UNITS.items() if share >= GOOD and abs(factor / f - 1) <= UNIT_OFF), None)


def _gravity(run: Run, t_s: np.ndarray) -> np.ndarray:
    """Gravity in the level components of specific force by logged roll and pitch, (n, 2) [m/s^2]; zero without them."""
    if not (run.known("phi_rad") and run.known("theta_rad")):
        return np.zeros((len(t_s), 2))
    at, tilt = run.samples("phi_rad", "theta_rad")
    phi, theta = (np.interp(t_s, at, tilt[:, i]) for i in range(2))
    return GRAVITY_M_S2 * np.column_stack([-np.sin(theta), np.sin(phi)])


def turned(psi: np.ndarray, v: np.ndarray) -> np.ndarray:
    """R(psi) v, (n, 2); v (2,) or (n, 2)."""
    return np.column_stack(rotate(psi, v[..., 0], v[..., 1]))


def twice(t_s: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Double integral of `a` (n, 2) over time from zero, (n, 2)."""
    return integrated(integrated(a, t_s), t_s)


def interpolated(t_s: np.ndarray, x: np.ndarray, at_s: np.ndarray) -> np.ndarray:
    """Columns of `x` (n, m) at `at_s` (k,), linearly, (k, m)."""
    return np.column_stack([np.interp(at_s, t_s, column) for column in x.T])


def second(t_s: np.ndarray, x: np.ndarray, at_s: np.ndarray, span_s: float) -> np.ndarray:
    """Second difference x(t + T) - 2 x(t) + x(t - T) of `x` (n, m) at `at_s` (k,), (k, m)."""
    ahead, here, behind = (interpolated(t_s, x, at_s + d) for d in (span_s, 0.0, -span_s))
    return ahead - 2 * here + behind


def unbroken(t_s: np.ndarray, middle_s: float, span_s: float) -> bool:
    """Whether no gap of more than `HOLE_S`, or half the span, lies within `span_s` of `middle_s`."""
    first, last = np.searchsorted(t_s, middle_s - span_s, "right") - 1, np.searchsorted(t_s, middle_s + span_s)
    return bool(np.diff(t_s[first : last + 1]).max(initial=0.0) <= max(HOLE_S, span_s / 2))
