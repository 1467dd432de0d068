"""Normal equations of a chain of nodes that share parameters: solved node by node.

    minimise  1/2 sum_w |r_w + J_w [dz_w; dw]|^2 + 1/2 sum_w |rho_w + dz_{w+1} - F_w dz_w - G_w dw|^2_{Q_w^-1}

The Hessian is block tridiagonal in the nodes with a border for the parameters. Eliminating the nodes from first to last
leaves the parameters' own Hessian: the inverse of their covariance with all nodes free.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve


@dataclass(frozen=True)
class Ties:
    """From node w to w + 1: residual rho (T, L), F (T, L, L), G (T, L, P), index of w (T,), time between [s] (T,)."""

    rho: np.ndarray
    F: np.ndarray
    G: np.ndarray
    at: np.ndarray
    span_s: np.ndarray


@dataclass
class Chain:
    """Blocks of Hessian and gradient: A (W, L, L), next (W, L, L), B (W, L, P), D (P, P), g (W, L), d (P,)."""

    A: np.ndarray
    next: np.ndarray
    B: np.ndarray
    D: np.ndarray
    g: np.ndarray
    d: np.ndarray

    @classmethod
    def of_data(cls, H: np.ndarray, grad: np.ndarray, L: int) -> Chain:
        """From J^T J (W, C, C) and J^T r (W, C) of each window, C = L + P."""
        return cls(
            A=H[:, :L, :L].copy(),
            next=np.zeros((len(H), L, L)),
            B=H[:, :L, L:].copy(),
            D=H[:, L:, L:].sum(axis=0),
            g=grad[:, :L].copy(),
            d=grad[:, L:].sum(axis=0),
        )

    def copy(self) -> Chain:
        """The same blocks, free to be added to."""
        return Chain(*(block.copy() for block in (self.A, self.next, self.B, self.D, self.g, self.d)))

    def in_terms_of(self, T: np.ndarray) -> None:
        """Change the parameters: dq = T dw."""
        self.B, self.D, self.d = self.B @ T, T.T @ self.D @ T, T.T @ self.d

    def add_ties(self, ties: Ties, sigma: np.ndarray) -> None:
        """Add what ties neighbouring nodes; sigma (T, L) of each entry of rho."""
        w, q = ties.at, 1 / sigma[:, :, None] ** 2
        QF, QG, Qr = q * ties.F, q * ties.G, ties.rho / sigma**2
        Ft, Gt = ties.F.transpose(0, 2, 1), ties.G.transpose(0, 2, 1)
        self.A[w] += Ft @ QF
        self.A[w + 1] += np.eye(ties.F.shape[1]) * q
        self.next[w] -= QF.transpose(0, 2, 1)
        self.B[w] += Ft @ QG
        self.B[w + 1] -= QG
        self.D += (Gt @ QG).sum(axis=0)
        self.g[w] -= (Ft @ Qr[:, :, None])[:, :, 0]
        self.g[w + 1] += Qr
        self.d -= (Gt @ Qr[:, :, None])[:, :, 0].sum(axis=0)

    def solve(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
        """Steps dz (W, L), dw (P,), the parameters' Hessian (P, P), and log det of the nodes' block."""
        W, size, P = self.B.shape
        D, d = self.D.copy(), self.d.copy()
        factors = []
        A, B, g, log_det = self.A[0], self.B[0], self.g[0], 0.0
        for w in range(W):
            factor = cho_factor(A, lower=True, check_finite=False)
            known = np.column_stack([self.next[w], B, g])
            solved = cho_solve(factor, known, check_finite=False)
            factors.append(solved)
            log_det += 2 * float(np.log(np.diag(factor[0])).sum())
            D -= B.T @ solved[:, size : size + P]
            d -= B.T @ solved[:, -1]
            if w + 1 < W:
                carry = self.next[w].T @ solved
                A = self.A[w + 1] - carry[:, :size]
                B = self.B[w + 1] - carry[:, size : size + P]
                g = self.g[w + 1] - carry[:, -1]
        step = -np.linalg.solve(D, d)
        dz = np.zeros((W, size))
        after = np.zeros(size)
        for w in range(W - 1, -1, -1):
            solved = factors[w]
            after = -solved[:, -1] - solved[:, size : size + P] @ step - solved[:, :size] @ after
            dz[w] = after
        return dz, step, D, log_det
