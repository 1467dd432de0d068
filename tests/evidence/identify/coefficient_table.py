"""Coefficients of the Taylor series as the paper's Table 2 has them."""

from __future__ import annotations

import numpy as np

from sim.fitting.taylor.abkowitz_table import TERMS
from sim.fitting.taylor.regression import TaylorFit


def coefficient_table(fit: TaylorFit, shift: np.ndarray | None = None) -> str:
    """Markdown table like Table 2 of the paper: coefficient and robust standard error by axis, or "open".

    `shift` (3, 23) of `noise_shift`: a coefficient that it moves by more than its standard error carries a *.
    """
    lines = ["| term | surge | sway | yaw | VIF |", "|---|---|---|---|---|"]
    for j, term in enumerate(TERMS):
        cells = []
        for i in range(3):
            if not fit.determined[i, j]:
                cells.append("open")
                continue
            star = "*" if shift is not None and abs(shift[i, j]) > fit.se_robust[i, j] else ""
            cells.append(f"{fit.C[i, j]:.4f} ({fit.se_robust[i, j]:.4f}){star}")
        vif = f"{fit.vif[j]:.1f}" if np.isfinite(fit.vif[j]) else "-"
        lines.append(f"| C_{term} | {' | '.join(cells)} | {vif} |")
    return "\n".join([*lines, "", _below(fit, shift is not None)])


def _below(fit: TaylorFit, shifted: bool) -> str:
    """The legend below the table."""
    text = (
        f"{fit.method}, {fit.n} samples; rank {fit.rank} of {len(TERMS)}, condition {fit.condition:.3g} "
        f"({fit.condition_scaled:.3g} with scaled columns). R2 of the accelerations: surge {fit.r2[0]:.3f}, "
        f"sway {fit.r2[1]:.3f}, yaw {fit.r2[2]:.3f}. In brackets: standard error, errors correlated. Forces in kgf, "
        f"kgf m. VIF: variance inflation. Errors in u, v, r are not in the standard errors"
    )
    return text + (": * marks coefficients that they move by more than one standard error." if shifted else ".")
