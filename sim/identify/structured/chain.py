"""Normal equations of a chain of nodes that share parameters: solved node by node.

    minimise  1/2 sum_w |r_w + J_w [dz_w; dw]|^2 + 1/2 sum_w |rho_w + dz_{w+1} - F_w dz_w - G_w dw|^2_{Q_w^-1}

The Hessian is block tridiagonal in the nodes with a border for the parameters. Eliminating the nodes from first to last
leaves the parameters' own Hessian: the inverse of their covariance with all nodes free.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded, get_lapack_funcs

_potrf, _trtrs = get_lapack_funcs(("potrf", "trtrs"), dtype=np.float64)


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
        w, each = ties.at, 1 / sigma
        F, G, rho = each[:, :, None] * ties.F, each[:, :, None] * ties.G, each * ties.rho
        Ft, border = F.transpose(0, 2, 1), G.reshape(rho.size, self.B.shape[2])
        self.A[w] += Ft @ F
        self.A[w + 1] += np.eye(F.shape[1]) * each[:, :, None] ** 2
        self.next[w] -= (each[:, :, None] * F).transpose(0, 2, 1)
        self.B[w] += Ft @ G
        self.B[w + 1] -= each[:, :, None] * G
        self.D += border.T @ border  # of one matrix with itself: half the work
        self.g[w] -= (Ft @ rho[:, :, None])[:, :, 0]
        self.g[w + 1] += each * rho
        self.d -= border.T @ rho.ravel()

    def solve(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
        """Steps dz (W, L), dw (P,), the parameters' Hessian (P, P), and log det of the nodes' block.

        Raises LinAlgError where the nodes' block is not positive definite.
        """
        W, size, P = self.B.shape
        known = np.concatenate([self.next, self.B, self.g[:, :, None]], axis=2)
        factors, solved, diagonals = [], np.empty_like(known), np.empty((W, size))
        A, right = self.A[0], known[0]
        for w in range(W):
            factor, failed = _potrf(A, lower=1)
            if failed:
                raise np.linalg.LinAlgError(f"node {w}: the Hessian is not positive definite")
            Y, _ = _trtrs(factor, right, lower=1)
            factors.append(factor)
            solved[w], diagonals[w] = Y, factor.diagonal()
            if w + 1 < W:
                carry = Y[:, :size].T @ Y
                A, right = self.A[w + 1] - carry[:, :size], known[w + 1].copy()
                right[:, size:] -= carry[:, size:]
        log_det = 2 * float(np.log(diagonals).sum())
        flat = solved.reshape(W * size, -1)
        border, last = flat[:, size : size + P], flat[:, -1]
        D, d = self.D - border.T @ border, self.d - border.T @ last
        step = -np.linalg.solve(D, d)
        given = (last + border @ step).reshape(W, size)
        dz, after = np.zeros((W, size)), np.zeros(size)
        for w in range(W - 1, -1, -1):
            after, _ = _trtrs(factors[w], -given[w] - solved[w][:, :size] @ after, lower=1, trans=1)
            dz[w] = after
        return dz, step, D, log_det

    def solve_nodes(self) -> tuple[np.ndarray, float]:
        """Steps dz (W, L) with the parameters as they are, and log det of the nodes' block; errors as of `solve`."""
        W, size = self.g.shape
        band = np.zeros((W, size, 2 * size))  # of each column the entries from the diagonal down
        for k in range(size):
            band[:, k, : size - k] = self.A[:, k:, k]
            band[:-1, k, size - k : 2 * size - k] = self.next[:-1, k]
        try:
            factor = cholesky_banded(band.reshape(W * size, -1).T, lower=True, check_finite=False)
        except np.linalg.LinAlgError:
            raise np.linalg.LinAlgError("the nodes' Hessian is not positive definite") from None
        dz = -cho_solve_banded((factor, True), self.g.ravel(), check_finite=False)
        return dz.reshape(W, size), 2 * float(np.log(factor[0]).sum())

    def covariance(self) -> np.ndarray:
        """Covariance of each node with the parameters as they are, (W, L, L).

            S_w = A_w - N_{w-1}^T S_{w-1}^-1 N_{w-1},   P_w = S_w^-1 + S_w^-1 N_w P_{w+1} N_w^T S_w^-1

        A, N: diagonal and upper blocks of the Hessian.
        """
        W, size = self.g.shape
        inverse, S = np.empty((W, size, size)), self.A[0]
        for w in range(W):
            inverse[w] = np.linalg.inv(S)
            if w + 1 < W:
                S = self.A[w + 1] - self.next[w].T @ inverse[w] @ self.next[w]
        out = inverse
        for w in range(W - 2, -1, -1):
            gain = inverse[w] @ self.next[w]
            out[w] = inverse[w] + gain @ out[w + 1] @ gain.T
        return out
