"""The paper's regression: 23 terms per axis, least squares as its equation (7), and the precision of each coefficient.

    b = A c,   row of A: phi(Delta u, v, r, t_x, t_y, t_n) of equation (4),   c = H A^T b

    H = (A^T A)^+          minimum norm where a column says nothing (the paper's C_y = 0)

Covariance of c: s^2 H A^T A H for white errors; H S H with S = sum over lags of the scores' Bartlett-weighted
covariances (Newey-West) for errors of any variance that are correlated over `hac_s`, as those of smoothed derivatives.

Errors of the regressors u, v, r are not in these intervals: they bias coefficients towards zero (attenuation) however
long the log. `noise_shift` estimates by how much.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from sim.fitting.taylor.abkowitz import regressor

TERM_COUNT = 23
HAC_S = 5.0
"""Errors further apart count as independent; assumed: the boat's slowest time constant."""
_NULL = 1e-9  # singular values below this share of the largest count as zero, columns scaled to mean square 1


@dataclass(frozen=True)
class Samples:
    """One log on a uniform grid of `rate_hz`: `nu`, `nu_dot` (k, 3) SI, `t_kgf` (k, 3) [kgf, kgf, kgf m]."""

    nu: np.ndarray
    nu_dot: np.ndarray
    t_kgf: np.ndarray
    rate_hz: float = 10.0


@dataclass(frozen=True)
class TaylorFit:
    """Fitted series: coefficients C (3, 23), rows surge, sway, yaw; terms in the order of `abkowitz_table.TERMS`.

    cov, cov_robust   (3, 23, 23) covariance of each row, for white and for correlated errors
    determined        (3, 23) False where the data do not determine a term
    rank, condition   of A; condition_scaled: of A with columns of mean square 1
    vif               (23,) variance inflation factor: 1 for a term uncorrelated with all others; inf if undetermined
    sigma, r2         (3,) standard deviation of the residual accelerations; coefficient of determination
    n, low, high      number of samples; range of [u v r t_x t_y t_n] in them
    """

    method: str
    C: np.ndarray
    cov: np.ndarray
    cov_robust: np.ndarray
    determined: np.ndarray
    rank: int
    condition: float
    condition_scaled: float
    vif: np.ndarray
    sigma: np.ndarray
    r2: np.ndarray
    n: int
    low: np.ndarray
    high: np.ndarray

    @property
    def se(self) -> np.ndarray:
        """Standard errors for white errors, shape (3, 23); inf where undetermined."""
        return self._errors(self.cov)

    @property
    def se_robust(self) -> np.ndarray:
        """Standard errors for correlated errors of changing variance, shape (3, 23); inf where undetermined."""
        return self._errors(self.cov_robust)

    def half_width(self, level: float = 0.95, robust: bool = True) -> np.ndarray:
        """Half width of the confidence interval of each coefficient, (3, 23), by Student's t."""
        errors = self.se_robust if robust else self.se
        return errors * float(student.ppf(0.5 + level / 2, self.n - self.rank))

    def _errors(self, cov: np.ndarray) -> np.ndarray:
        return np.where(self.determined, np.sqrt(np.diagonal(cov, axis1=1, axis2=2)), np.inf)


def design(nu: np.ndarray, t_kgf: np.ndarray) -> np.ndarray:
    """Design matrix A (k, 23) of equation (6a), its misprint corrected (v^2 Delta u, Delta u v r)."""
    return np.stack(np.broadcast_arrays(*regressor(nu.T, t_kgf.T)), axis=1)


def least_squares(logs: Sequence[Samples], hac_s: float = HAC_S) -> TaylorFit:
    """Equation (7) over all logs. ValueError with fewer samples than terms or with values that are not finite."""
    work = _Work.of(logs, hac_s)
    return work.fit()


def noise_shift(
    logs: Sequence[Samples], nu_sigma: Sequence[np.ndarray], rng: np.random.Generator, draws: int = 10
) -> np.ndarray:
    """Bias of the coefficients (3, 23) by errors of `nu_sigma` (k, 3) per log in u, v, r: mean over `draws`.

    Estimated as the shift that errors of the same size make when added once more (the first step of SIMEX: Cook and
    Stefanski 1994). They are drawn white: the shift depends on their size at each sample, not on their correlation.
    """
    first = least_squares(logs).C
    shift = np.zeros_like(first)
    for _ in range(draws):
        noisy = [
            Samples(log.nu + sigma * rng.standard_normal(log.nu.shape), log.nu_dot, log.t_kgf, log.rate_hz)
            for log, sigma in zip(logs, nu_sigma, strict=True)
        ]
        shift += least_squares(noisy).C - first
    return shift / draws


@dataclass(frozen=True)
class _Work:
    """The regression problem of all logs.

    A, b     (n, 23), (n, 3) design matrix and accelerations
    scale    (23,) root mean square of each column of A, 1 where that is 0
    R        (23, 23) of A / scale = Q R: has its singular values and right singular vectors, far smaller
    bounds   first row of each log, and the row after its last
    lags     of the Newey-West estimate
    low, high  range of [u v r t_x t_y t_n]
    """

    A: np.ndarray
    b: np.ndarray
    scale: np.ndarray
    R: np.ndarray
    bounds: tuple[tuple[int, int], ...]
    lags: int
    low: np.ndarray
    high: np.ndarray

    @classmethod
    def of(cls, logs: Sequence[Samples], hac_s: float) -> _Work:
        """From the samples of all logs. ValueError for too few samples, or for values that are not finite."""
        nu, t = np.concatenate([log.nu for log in logs]), np.concatenate([log.t_kgf for log in logs])
        A, b = design(nu, t), np.concatenate([log.nu_dot for log in logs])
        if len(A) <= TERM_COUNT:
            raise ValueError(f"{len(A)} samples cannot determine {TERM_COUNT} terms")
        if not (np.isfinite(A).all() and np.isfinite(b).all()):
            raise ValueError("speeds, accelerations and forces must all be finite")
        rms = np.sqrt(np.mean(A**2, axis=0))
        ends = np.cumsum([len(log.nu) for log in logs])
        bounds = tuple(zip([0, *ends[:-1]], ends, strict=True))
        both = np.column_stack([nu, t])
        scale = np.where(rms > 0, rms, 1.0)
        R = np.asarray(np.linalg.qr(A / scale, mode="r"))
        return cls(A, b, scale, R, bounds, round(hac_s * logs[0].rate_hz), both.min(axis=0), both.max(axis=0))

    def fit(self) -> TaylorFit:
        """The fit: coefficients, covariances, diagnostics of collinearity."""
        A, b = self.A, self.b
        _, s, Vt = np.linalg.svd(self.R)
        rank = int((s > _NULL * s[0]).sum())
        open_terms = np.asarray((np.abs(Vt[rank:]) > 1e-6).any(axis=0))
        half = (Vt[:rank].T / s[:rank]) / self.scale[:, None]
        H, gram = half @ half.T, A.T @ A
        C = np.stack([H @ (A.T @ b[:, i]) for i in range(3)])
        residual = b - A @ C.T
        variance = (residual**2).sum(axis=0) / (len(A) - rank)
        return TaylorFit(
            method="least squares",
            C=C,
            cov=np.stack([v * H @ gram @ H for v in variance]),
            cov_robust=np.stack([H @ self._scores(residual[:, i]) @ H for i in range(3)]),
            determined=np.tile(H.any(axis=0) & ~open_terms, (3, 1)),
            rank=rank,
            condition=float(np.linalg.cond(self.R * self.scale)),
            condition_scaled=float(s[0] / s[-1]) if s[-1] > 0 else np.inf,
            vif=self._vif(open_terms),
            sigma=np.sqrt(variance),
            r2=1 - (residual**2).sum(axis=0) / ((b - b.mean(axis=0)) ** 2).sum(axis=0),
            n=len(A),
            low=self.low,
            high=self.high,
        )

    def _scores(self, residual: np.ndarray) -> np.ndarray:
        """Newey-West S (23, 23) of the scores A_i r_i of one axis.

        Sum of outer products of moving sums over lags + 1 scores, divided by lags + 1: exactly the Bartlett weights.
        """
        S, width = np.zeros((TERM_COUNT, TERM_COUNT)), self.lags + 1
        for start, end in self.bounds:
            scores = self.A[start:end] * residual[start:end, None]
            total = np.concatenate([np.zeros((width, TERM_COUNT)), np.cumsum(scores, axis=0)])
            total = np.concatenate([total, np.repeat(total[-1:], width - 1, axis=0)])
            windows = total[width:] - total[:-width]
            S += windows.T @ windows / width
        return S

    def _vif(self, open_terms: np.ndarray) -> np.ndarray:
        """Variance inflation factors (23,): diagonal of the inverse correlation matrix; NaN for the constant."""
        vif = np.full(TERM_COUNT, np.inf)
        vif[0] = np.nan
        use = ~open_terms
        use[0] = False
        vif[use] = np.diag(np.linalg.inv(np.corrcoef(self.A[:, use].T)))
        return vif
