"""The contract between guidance and NMPC: one row per stage, N + 1 rows, with these columns.

| column | unit | frame | meaning |
|---|---|---|---|
| north_m, east_m | m | NED | point of the path that belongs to the stage, or the station |
| path_angle_rad | rad | from north | direction of the path there (on station: the wanted heading) |
| psi_rad | rad | from north | wanted heading |
| u_m_s, v_m_s, r_rad_s | m/s, m/s, rad/s | body | wanted velocities |
| station | 1 | - | 0 on a leg, 1 on station: how much the along-track error counts |
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from companion.core.geometry.frames import unrotate

COLUMNS = ("north_m", "east_m", "path_angle_rad", "psi_rad", "u_m_s", "v_m_s", "r_rad_s", "station")


class Column(IntEnum):
    """Index of each of COLUMNS."""

    NORTH = 0
    EAST = 1
    PATH_ANGLE = 2
    PSI = 3
    U = 4
    V = 5
    R = 6
    STATION = 7


REACH_M = 1.0
"""A boat that is farther away counts as so far: controllers close an error at a speed that grows with it. Assumed."""


def path_errors(row: np.ndarray, north_m: float, east_m: float) -> tuple[float, float]:
    """(w x_e, y_e) of a place to the stage's point [m]: along its path, as far as that counts there, and across."""
    x_e, y_e = unrotate(row[Column.PATH_ANGLE], north_m - row[Column.NORTH], east_m - row[Column.EAST])
    return row[Column.STATION] * x_e, y_e


def near(psi_ref: np.ndarray, psi: float) -> np.ndarray:
    """Headings [rad], shape (n,), made continuous, the first one within pi of `psi`.

    After this a plain difference psi - psi_ref is the shorter way round: the NMPC needs no wrapping inside.
    """
    unwrapped = np.unwrap(psi_ref)
    return unwrapped - 2.0 * np.pi * np.round((unwrapped[0] - psi) / (2.0 * np.pi))
