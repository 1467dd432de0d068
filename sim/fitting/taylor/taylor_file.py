"""The fitted 23-term model: its file, its table, and simulation of many runs at once.

    nu_dot = C phi(Delta u, v, r, t_x, t_y, t_n),   eta_dot = R(psi) nu      t in kgf, kgf m (1 kgf = 9.80665 N)

File: JSON, `TaylorFile`. `AbkowitzModel(B, lag_s, coefficients=file.coefficients)` makes a model for filter and NMPC.
"""

from __future__ import annotations

import msgspec
import numpy as np

from companion.core.geometry.frames import rotate
from companion.core.model.integrate import rk4
from sim.fitting.taylor.abkowitz_table import NOMINAL_U_M_S, TERMS
from sim.fitting.taylor.regression import TaylorFit, design

AXES = ("surge", "sway", "yaw")


class TaylorFile(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Coefficients by axis, in the order of `terms`; a standard error of None: the data do not determine the term.

    `low`, `high`: range of [u v r X Y N] [m/s, rad/s, kgf, kgf m] in the data; the series is not valid outside it.
    """

    format: int = 1
    kind: str = "taylor-23"
    source: str
    method: str
    units: str = "m/s^2 and rad/s^2 from m/s, rad/s, kgf, kgf m; 1 kgf = 9.80665 N"
    nominal_u_m_s: float = NOMINAL_U_M_S
    terms: tuple[str, ...] = TERMS
    values: dict[str, tuple[float, ...]]
    se: dict[str, tuple[float | None, ...]]
    se_robust: dict[str, tuple[float | None, ...]]
    low: tuple[float, ...]
    high: tuple[float, ...]
    samples: int

    def __post_init__(self) -> None:
        if (self.format, self.kind, self.terms, self.nominal_u_m_s) != (1, "taylor-23", TERMS, NOMINAL_U_M_S):
            raise ValueError(f"expected format 1, kind taylor-23, nominal {NOMINAL_U_M_S} m/s and the terms {TERMS}")
        for name in AXES:
            if len(self.values.get(name, ())) != len(TERMS):
                raise ValueError(f"values.{name}: expected {len(TERMS)} numbers")

    @property
    def coefficients(self) -> np.ndarray:
        """C, shape (3, 23)."""
        return np.array([self.values[name] for name in AXES])


def taylor_file(fit: TaylorFit, source: str) -> TaylorFile:
    """The fit as a file. `source`: logs and smoothing, as text."""

    def rows(table: np.ndarray) -> dict[str, tuple[float | None, ...]]:
        return {
            name: tuple(float(x) if np.isfinite(x) else None for x in row)
            for name, row in zip(AXES, table, strict=True)
        }

    return TaylorFile(
        source=source,
        method=fit.method,
        values={name: tuple(map(float, row)) for name, row in zip(AXES, fit.C, strict=True)},
        se=rows(fit.se),
        se_robust=rows(fit.se_robust),
        low=tuple(map(float, fit.low)),
        high=tuple(map(float, fit.high)),
        samples=fit.n,
    )


def taylor_json(file: TaylorFile) -> bytes:
    """The file as JSON text."""
    return msgspec.json.format(msgspec.json.encode(file), indent=2)


def simulate_taylor(C: np.ndarray, x0: np.ndarray, t_kgf: np.ndarray, h_s: float, substeps: int = 2) -> np.ndarray:
    """m runs of k + 1 states [x y psi u v r], shape (m, k + 1, 6), by Runge-Kutta, forces held over each step.

    `x0` (m, 6), `t_kgf` (m, k, 3). A run that has gone off beyond 1e3 becomes NaN and stays so.
    """
    m, k = t_kgf.shape[:2]
    out = np.empty((m, k + 1, 6))
    out[:, 0] = x = np.array(x0, dtype=float)
    for i in range(k):
        x = rk4(lambda state, t=t_kgf[:, i]: _rate(C, state, t), x, h_s, substeps)
        x[~(np.abs(x[:, 3:]) < 1e3).all(axis=1)] = np.nan
        out[:, i + 1] = x
    return out


def _rate(C: np.ndarray, x: np.ndarray, t: np.ndarray) -> np.ndarray:
    """dx/dt of m states, shape (m, 6)."""
    nu = np.clip(x[:, 3:], -1e6, 1e6)  # within a step a diverging run may overshoot; it is NaN after it
    return np.column_stack([*rotate(x[:, 2], nu[:, 0], nu[:, 1]), nu[:, 2], design(nu, t) @ C.T])
