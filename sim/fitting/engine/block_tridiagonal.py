"""Normal equations of a chain of nodes that share parameters: solved node by node.

    minimise  1/2 sum_w |r_w + J_w [dz_w; dw]|^2 + 1/2 sum_w |rho_w + dz_{w+1} - F_w dz_w - G_w dw|^2_{Q_w^-1}

The Hessian is block tridiagonal in the nodes with a border for the parameters. Eliminating the nodes from first to last
leaves the parameters' own Hessian: the inverse of their covariance with all nodes free.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sim.fitting.engine.kernels.block_tridiagonal import add_ties, back_substitute, eliminate
from sim.fitting.engine.kernels.windows import add_normal_equations


@dataclass(frozen=True)
class Ties:
    """From node w to w + 1: residual rho (T, L), F (T, L, L), index of w (T,), time between [s] (T,).

    G (T, k, P): of the first k entries of a node, those that parameters move."""

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
    def nothing(cls, W: int, L: int, P: int) -> Chain:
        """Of W nodes that nothing is known of."""
        shapes = (W, L, L), (W, L, L), (W, L, P), (P, P), (W, L), (P,)
        return cls(*(np.zeros(shape) for shape in shapes))

    def add(self, windows: slice, J: np.ndarray, residual: np.ndarray) -> None:
        """J^T J and J^T r of some windows: J (w, k, L + P), residual (w, k)."""
        L = self.A.shape[1]
        nodes = J[:, :, :L].transpose(0, 2, 1)
        both = nodes @ J
        self.A[windows] += both[:, :, :L]
        self.B[windows] += both[:, :, L:]
        self.g[windows] += (nodes @ residual[:, :, None])[:, :, 0]
        self._add_shared(J, residual)

    def add_samples(self, window: np.ndarray, J: np.ndarray, residual: np.ndarray) -> None:
        """The same for samples that are each of one `window` (m,): J (m, k, L + P), residual (m, k)."""
        count = J.shape[1]
        add_normal_equations(
            J.reshape(-1, J.shape[2]), residual.ravel(), np.repeat(window, count), self.A, self.B, self.g
        )
        self._add_shared(J, residual)

    def _add_shared(self, J: np.ndarray, residual: np.ndarray) -> None:
        own = J.reshape(residual.size, J.shape[2])[:, self.A.shape[1] :]
        self.D += own.T @ own
        self.d += own.T @ residual.ravel()

    def damped(self, nodes: np.ndarray, parameters: np.ndarray) -> Chain:
        """With more on the diagonals of A (L,) and D (P,); all else is shared with this one."""
        return replace(self, A=self.A + np.diag(nodes), D=self.D + np.diag(parameters))

    def copy(self) -> Chain:
        """The same blocks, free to be added to."""
        return Chain(*(block.copy() for block in (self.A, self.next, self.B, self.D, self.g, self.d)))

    def in_terms_of(self, T: np.ndarray) -> None:
        """Change the parameters: dq = T dw."""
        self.B, self.D, self.d = self.B @ T, T.T @ self.D @ T, T.T @ self.d

    def add_ties(self, ties: Ties, sigma: np.ndarray) -> None:
        """Add what ties neighbouring nodes; sigma (T, L) of each entry of rho."""
        border = add_ties(ties.at, ties.F, ties.G, ties.rho, 1 / sigma, self.A, self.next, self.B, self.g)
        G = border[:, :-1]
        self.D += G.T @ G  # of one matrix with itself: half the work
        self.d -= G.T @ border[:, -1]

    def solve(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
        """Steps dz (W, L), dw (P,), the parameters' Hessian (P, P), and log det of the nodes' block.

        Raises LinAlgError where the nodes' block is not positive definite.
        """
        W, size, P = self.B.shape
        factors, solved, log_det = self._eliminated(self.B)
        flat = solved.reshape(W * size, -1)
        border, last = flat[:, size : size + P], flat[:, -1]
        D, d = self.D - border.T @ border, self.d - border.T @ last
        step = -np.linalg.solve(D, d)
        given = (last + border @ step).reshape(W, size)
        dz = np.empty((W, size))
        back_substitute(factors, solved, given, dz)
        return dz, step, D, log_det

    def solve_nodes(self) -> tuple[np.ndarray, float]:
        """Steps dz (W, L) with the parameters as they are, and log det of the nodes' block; errors as of `solve`."""
        W, size = self.g.shape
        factors, solved, log_det = self._eliminated(self.B[:, :, :0])
        dz = np.empty((W, size))
        back_substitute(factors, solved, solved[:, :, -1].copy(), dz)
        return dz, log_det

    def _eliminated(self, B: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """As `eliminate` with the columns B, and log det of the nodes' block."""
        W, size, P = B.shape
        factors, solved = np.empty((W, size, size)), np.empty((W, size, size + P + 1))
        failed = eliminate(self.A, self.next, B, self.g, factors, solved)
        if failed >= 0:
            raise np.linalg.LinAlgError(f"node {failed}: the Hessian is not positive definite")
        return factors, solved, 2 * float(np.log(np.diagonal(factors, axis1=1, axis2=2)).sum())

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
