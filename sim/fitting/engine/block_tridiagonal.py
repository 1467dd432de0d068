"""Normal equations of a chain of nodes that share parameters, solved by block elimination.

    minimise  1/2 sum_w |r_w + J_w [dz_w; dw]|^2 + 1/2 sum_w |rho_w + dz_{w+1} - F_w dz_w - G_w dw|^2_{Q_w^-1}

over steps dz_w (L,) of the nodes and dw (P,) of the parameters. The Hessian is block tridiagonal in the nodes, with a
border for the parameters:

    | A_0    N_0                |  B_0   |       A_w  L x L     own block of node w
    | N_0^T  A_1    N_1         |  B_1   |       N_w  L x L     between node w and the next
    |        N_1^T  A_2   ..    |  B_2   |       B_w  L x P     between node w and the parameters
    |  --------------------------------- |       D    P x P     parameters
    | B_0^T  B_1^T  B_2^T ..    |  D     |

Eliminating the nodes from first to last, as a Kalman filter does, leaves the Schur complement of the parameters. It is
the inverse of their covariance with all nodes free. Cost: O(W L^2 (L + P)).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sim.fitting.engine.kernels.block_tridiagonal import add_ties, back_substitute, eliminate
from sim.fitting.engine.kernels.windows import add_normal_equations


@dataclass(frozen=True)
class Ties:
    """Continuity conditions of multiple shooting, T of them: z_{w+1} = f(z_w, q) + noise, linearised.

    rho     (T, L) residual z_{w+1} - f(z_w, q)
    F       (T, L, L) df/dz_w
    G       (T, k, P) df/dq of the first k entries of a node; the others do not depend on the parameters
    at      (T,) index w
    span_s  (T,) time from node w to the next [s]
    """

    rho: np.ndarray
    F: np.ndarray
    G: np.ndarray
    at: np.ndarray
    span_s: np.ndarray


@dataclass
class Chain:
    """Blocks of the Hessian, A (W, L, L), N = `next` (W, L, L), B (W, L, P), D (P, P); gradient g (W, L), d (P,)."""

    A: np.ndarray
    next: np.ndarray
    B: np.ndarray
    D: np.ndarray
    g: np.ndarray
    d: np.ndarray

    @classmethod
    def nothing(cls, W: int, L: int, P: int) -> Chain:
        """Zeros: W nodes of L unknowns and P parameters without any data."""
        shapes = (W, L, L), (W, L, L), (W, L, P), (P, P), (W, L), (P,)
        return cls(*(np.zeros(shape) for shape in shapes))

    def add(self, windows: slice, J: np.ndarray, residual: np.ndarray) -> None:
        """Add J^T J and J^T r of the windows of a slice: J (w, k, L + P), residual (w, k)."""
        L = self.A.shape[1]
        nodes = J[:, :, :L].transpose(0, 2, 1)
        blocks = nodes @ J
        self.A[windows] += blocks[:, :, :L]
        self.B[windows] += blocks[:, :, L:]
        self.g[windows] += (nodes @ residual[:, :, None])[:, :, 0]
        self._add_shared(J, residual)

    def add_samples(self, window: np.ndarray, J: np.ndarray, residual: np.ndarray) -> None:
        """The same for m samples, each of its own `window` (m,): J (m, k, L + P), residual (m, k)."""
        count = J.shape[1]
        add_normal_equations(
            J.reshape(-1, J.shape[2]), residual.ravel(), np.repeat(window, count), self.A, self.B, self.g
        )
        self._add_shared(J, residual)

    def _add_shared(self, J: np.ndarray, residual: np.ndarray) -> None:
        """Add the parameters' own blocks D and d."""
        own = J.reshape(residual.size, J.shape[2])[:, self.A.shape[1] :]
        self.D += own.T @ own
        self.d += own.T @ residual.ravel()

    def damped(self, nodes: np.ndarray, parameters: np.ndarray) -> Chain:
        """With `nodes` (L,) added to the diagonal of each A_w, `parameters` (P,) to that of D; the rest is shared."""
        return replace(self, A=self.A + np.diag(nodes), D=self.D + np.diag(parameters))

    def copy(self) -> Chain:
        """A copy whose blocks may be changed."""
        return Chain(*(block.copy() for block in (self.A, self.next, self.B, self.D, self.g, self.d)))

    def in_terms_of(self, T: np.ndarray) -> None:
        """Change the parameters from q to w, in place: dq = T dw, T (P, P)."""
        self.B, self.D, self.d = self.B @ T, T.T @ self.D @ T, T.T @ self.d

    def add_ties(self, ties: Ties, sigma: np.ndarray) -> None:
        """Add the continuity conditions; sigma (T, L): standard deviation of each entry of rho."""
        border = add_ties(ties.at, ties.F, ties.G, ties.rho, 1 / sigma, self.A, self.next, self.B, self.g)
        G = border[:, :-1]
        self.D += G.T @ G  # a symmetric product: BLAS does half the work
        self.d -= G.T @ border[:, -1]

    def solve(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
        """Steps dz (W, L) and dw (P,), Schur complement of the parameters (P, P), log det of the nodes' block.

        Raises LinAlgError where the nodes' block is not positive definite.
        """
        # 1. Nodes' block K = C C^T (Cholesky); `solved` holds C^-1 [N B g].
        W, size, P = self.B.shape
        factors, solved, log_det = self._eliminated(self.B)
        # 2. Parameters: (D - B^T K^-1 B) dw = -(d - B^T K^-1 g).
        flat = solved.reshape(W * size, -1)
        border, last = flat[:, size : size + P], flat[:, -1]
        D, d = self.D - border.T @ border, self.d - border.T @ last
        dw = -np.linalg.solve(D, d)
        # 3. Nodes, last to first: C^T dz = -C^-1 (g + B dw).
        right = (last + border @ dw).reshape(W, size)
        dz = np.empty((W, size))
        back_substitute(factors, solved, right, dz)
        return dz, dw, D, log_det

    def solve_nodes(self) -> tuple[np.ndarray, float]:
        """Steps dz (W, L) at fixed parameters, and log det of the nodes' block. Errors as of `solve`."""
        W, size = self.g.shape
        factors, solved, log_det = self._eliminated(self.B[:, :, :0])
        dz = np.empty((W, size))
        back_substitute(factors, solved, solved[:, :, -1].copy(), dz)
        return dz, log_det

    def _eliminated(self, B: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """`factors` and `solved` as of the kernel `eliminate` with the columns B, and log det of the nodes' block."""
        W, size, P = B.shape
        factors, solved = np.empty((W, size, size)), np.empty((W, size, size + P + 1))
        failed = eliminate(self.A, self.next, B, self.g, factors, solved)
        if failed >= 0:
            raise np.linalg.LinAlgError(f"node {failed}: the Hessian is not positive definite")
        return factors, solved, 2 * float(np.log(np.diagonal(factors, axis1=1, axis2=2)).sum())

    def covariance(self) -> np.ndarray:
        """Covariance of each node at fixed parameters, (W, L, L): diagonal blocks of the inverse, as a smoother has it.

        S_w = A_w - N_{w-1}^T S_{w-1}^-1 N_{w-1},   P_w = S_w^-1 + S_w^-1 N_w P_{w+1} N_w^T S_w^-1
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
