"""The extended Kalman filter's algebra: filterpy's, behind pure functions of (x, P).

    predict   x+ = f(x),        P+ = F P F^T + Q
    update    S = H P H^T + R,  K = P H^T S^-1,  x+ = x + K nu,  P+ in Joseph's form

filterpy keeps x and P in an object; `KalmanEquations` lends it both for one operation and hands fresh arrays back.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter


class _Filter(ExtendedKalmanFilter):
    """filterpy's filter with a predicted state that the caller computed (its own hook for that)."""

    def predict_x(self, u: Any = 0) -> None:
        self.x = u


class KalmanEquations:
    """Predict and update for n states. Holds scratch objects only: results depend on arguments alone."""

    def __init__(self, n: int):
        self._filters = {m: _Filter(dim_x=n, dim_z=m) for m in (1, 2, 3)}

    def predict(self, P: np.ndarray, x_next: np.ndarray, F: np.ndarray, Q: np.ndarray) -> np.ndarray:
        """Covariance after a step with Jacobian F and process noise Q, both (n, n)."""
        ekf = self._filters[1]
        ekf.P, ekf.F, ekf.Q = P, F, Q
        ekf.predict(u=x_next)  # pyright: ignore[reportArgumentType] - its hook takes what we give
        return ekf.P

    def update(
        self, x: np.ndarray, P: np.ndarray, nu: np.ndarray, H: np.ndarray, R: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """State and covariance after innovation nu (m,) with Jacobian H (m, n) and noise R (m, m)."""
        ekf = self._filters[len(nu)]
        ekf.x, ekf.P = x, P
        ekf.update(nu, HJacobian=lambda _: H, Hx=np.zeros_like, hx_args=(), R=R, residual=lambda z, _: z)
        return ekf.x, (ekf.P + ekf.P.T) / 2
