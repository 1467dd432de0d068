"""The real-time iteration by CasADi's interpreter: the same expressions where there is no machine code.

Arrays and entries as in `compiled`; some twenty times slower. Functions are called through buffers: nothing is copied.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np

from companion.core.control.rti import riccati
from companion.core.control.rti.stage_functions import MOST_QPS, StageFunctions, accumulated


class InterpretedRti:
    """Arrays by name in `view`, and the entries as functions without arguments."""

    def __init__(self, parts: StageFunctions, iterations: int):
        ocp = parts.ocp
        self._ocp, self._parts, self._iterations = ocp, parts, iterations
        n, m, N = ocp.nx, ocp.nu, ocp.stages
        self.view = {
            "X": np.zeros((N + 1, n)), "C": np.zeros((N, m)), "x0": np.zeros(n), "p": np.zeros((N + 1, ocp.p.numel())),
            "q": np.zeros(ocp.q.numel()), "shift": np.zeros(1), "active": np.zeros((N, m)), "info": np.zeros(5),
            "dx": np.zeros((N + 1, n)), "dc": np.zeros((N, m)), "chosen": np.zeros((N, m)),
            "D": np.zeros((N, parts.D.count)), "b": np.zeros((N, n)), "H": np.zeros((N, parts.H.count)),
            "g": np.zeros((N, n + m)), "end": np.zeros(n * (n + 1)),
            "K": np.zeros((N, m * (n + 1))), "W": np.zeros((N, m * (n + 1))),
        }  # fmt: skip
        self.view |= {"sums": self.view["info"][:4], "changed": self.view["info"][4:]}
        self._buffers: list[Any] = []
        guess = ("X", "C", "p", "q")
        quadratic = ("D", "b", "H", "g", "end", "active", "X", "C")
        self._linear = self._called(self._linear_function(), guess, ("D", "b", "H", "g", "end"))
        self._bound = self._called(self._backward_function(free=False), quadratic, ("K", "W"))
        self._free = self._called(self._backward_function(free=True), quadratic, ("K",))
        rolled = ("x0", "X", "C", "D", "b", "K", "W", "active")
        self._roll = self._called(self._roll_function(), rolled, ("dx", "dc", "chosen", "changed"))
        self.look = self._called(self._look_function(), guess, ("sums",))

    def prepare(self) -> None:
        """Linearise about the guess, Riccati sweep."""
        self._linear()
        self._backward()

    def _backward(self) -> None:
        """Riccati sweep; without W where no limit is active."""
        if self.view["active"].any():
            self._bound()
        else:
            self.view["W"].fill(0.0)
            self._free()

    def feedback(self) -> None:
        """Roll out from x0; repeat sweep and roll-out while the active limits change; X += dx, C += dc."""
        view = self.view
        self._roll()
        for _ in range(MOST_QPS - 1):
            if view["changed"][0] == 0.0:
                break
            view["active"][:] = view["chosen"]
            self._backward()
            self._roll()
        view["active"][:] = view["chosen"]
        with np.errstate(all="ignore"):
            view["X"] += view["dx"]
            view["C"] += view["dc"]

    def shift(self) -> None:
        """X_k += shift (X_k+1 - X_k), C_k likewise; the last ones stay."""
        for name, count in (("X", self._ocp.stages), ("C", self._ocp.stages - 1)):
            table = self.view[name]
            with np.errstate(all="ignore"):  # `look` reports NaN
                table[:count] += self.view["shift"][0] * (table[1 : count + 1] - table[:count])

    def solve(self) -> None:
        """Shift, iterate `iterations` times, look."""
        self.shift()
        for _ in range(self._iterations):
            self.prepare()
            self.feedback()
        self.look()

    def iterate(self) -> None:
        """One iteration, look."""
        self.prepare()
        self.feedback()
        self.look()

    def _called(self, function: ca.Function, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> Callable[[], None]:
        """`function` bound to arrays of `view`."""
        pair: tuple[Any, Any] = function.buffer()
        buffer, call = pair
        for i, name in enumerate(inputs):
            buffer.set_arg(i, self.view[name].data)
        for i, name in enumerate(outputs):
            buffer.set_res(i, self.view[name].data)
        self._buffers.append(buffer)  # `call` alone does not keep it alive
        return call

    def _guess(self) -> tuple[ca.MX, ca.MX, ca.MX, ca.MX]:
        """Symbols X (n, N + 1), C (m, N), p, q: transposed, as CasADi stores by columns and numpy by rows."""
        ocp = self._ocp
        return (
            ca.MX.sym("X", ocp.nx, ocp.stages + 1), ca.MX.sym("C", ocp.nu, ocp.stages),
            ca.MX.sym("p", ocp.p.numel(), ocp.stages + 1), ca.MX.sym("q", ocp.q.numel()),
        )  # fmt: skip

    def _linear_function(self) -> ca.Function:
        N, parts, n = self._ocp.stages, self._parts, self._ocp.nx
        X, C, p, q = self._guess()
        stages = parts.linear.map(N)(X[:, :N], C, X[:, 1:], p[:, :N], ca.repmat(q, 1, N))
        x, p_end, q_end = ca.SX.sym("x", n), ca.SX.sym("p", p.shape[0]), ca.SX.sym("q", q.shape[0])
        entries, g = parts.end(x, p_end, q_end)
        dense = ca.vertcat(ca.vec(ca.densify(parts.H_end.filled(entries))), g)
        end = ca.Function("end", [x, p_end, q_end], [dense])
        return ca.Function("linear", [X, C, p, q], [*stages, end(X[:, N], p[:, N], q)])

    def _backward_function(self, *, free: bool) -> ca.Function:
        """(D, b, H, g, end, active, X, C) -> K, W of all stages. `free`: no limit is active, W is zero and left out.

        In z = [x 1 c]: P (n + 1, n + 1) of [x 1], M = [A b B; 0 1 0], Q = M' P M + H. Products of whole matrices are
        MX, which are dense loops in C: as scalar operations of the interpreter the sweep takes half as long again.
        """
        parts, ocp = self._parts, self._ocp
        n, m, N = ocp.nx, ocp.nu, ocp.stages
        filled, gains = self._filled_function(), self._gains_function(free=free)
        # 1. one Riccati step: (P, stage) -> (P of the stage before, K, W)
        P = ca.MX.sym("P", n + 1, n + 1)
        sizes = {"D": parts.D.count, "b": n, "H": parts.H.count, "g": n + m, "code": m, "x": n, "c": m}
        local = [ca.MX.sym(name, size) for name, size in sizes.items()]
        M, H = filled(*local[:4])
        Q = M.T @ (P @ M) + H
        Q_c = Q[n + 1 :, :]
        answer = gains(Q_c, *local[4:])
        K, W = answer if not free else (answer, None)
        P_next = Q[: n + 1, : n + 1] + Q_c[:, : n + 1].T @ K
        if W is not None:
            P_next += K.T @ W
        step = ca.Function("back", [P, *local], [P_next, ca.vec(K), *([] if W is None else [ca.vec(W)])])
        # 2. from the last stage to the first
        stages = [ca.MX.sym(name, size, N) for name, size in list(sizes.items())[:5]]
        X, C, _, _ = self._guess()
        end = ca.MX.sym("end", n * (n + 1))
        H_N, g_N = ca.reshape(end[: n * n], n, n), end[n * n :]
        P_N = ca.vertcat(ca.horzcat(H_N, g_N), ca.horzcat(g_N.T, 0))
        backwards = [s[:, ::-1] for s in (*stages, X[:, :N], C)]
        answers = step.mapaccum("sweep", N, 1)(P_N, *backwards)
        return ca.Function("backward", [*stages[:4], end, stages[4], X, C], [a[:, ::-1] for a in answers[1:]])

    def _filled_function(self) -> ca.Function:
        """(D, b, H, g) -> [A b B; 0 1 0] (n + 1, n + 1 + m) and the cost's matrix in [x 1 c], both dense."""
        parts, ocp = self._parts, self._ocp
        n, m = ocp.nx, ocp.nu
        entries, b = ca.SX.sym("D", parts.D.count), ca.SX.sym("b", n)
        h, g = ca.SX.sym("H", parts.H.count), ca.SX.sym("g", n + m)
        D, H = parts.D.filled(entries), parts.H.filled(h)
        M = ca.vertcat(ca.horzcat(D[:, :n], b, D[:, n:]), ca.horzcat(ca.SX(1, n), 1, ca.SX(1, m)))
        rows = [
            ca.horzcat(H[:n, :n], g[:n], H[:n, n:]),
            ca.horzcat(g[:n].T, 0, g[n:].T),
            ca.horzcat(H[n:, :n], g[n:], H[n:, n:]),
        ]
        return ca.Function("filled", [entries, b, h, g], [ca.densify(M), ca.densify(ca.vertcat(*rows))])

    def _gains_function(self, *, free: bool) -> ca.Function:
        """(rows c of Q (m, n + 1 + m), code, x, c) -> K, W (m, n + 1)."""
        ocp = self._ocp
        n, m = ocp.nx, ocp.nu
        Q_c, code = ca.SX.sym("Q", m, n + 1 + m), ca.SX.sym("code", m)
        x, c = ca.SX.sym("x", n), ca.SX.sym("c", m)
        nothing = ca.SX(m, 1)
        law = riccati.ActiveLaw(nothing, nothing, nothing) if free else riccati.active_law(ocp, code, x, c)
        Q_cc = Q_c[:, n + 1 :]
        L, inverse = riccati.factor(Q_cc, law.active)
        force, one = ca.SX(m, n + 1), ca.SX(1, n + 1)
        one[n] = 1
        if ocp.forces is not None:
            for i in range(m):
                force[i, ocp.forces + i] = 1
        K, W = riccati.gains(Q_c[:, : n + 1], Q_cc, law, L, inverse, force, one)
        results = [ca.densify(e) for e in ca.cse([K] if free else [K, W])]
        return ca.Function("gains", [Q_c, code, x, c], results)

    def _roll_function(self) -> ca.Function:
        """(x0, X, C, D, b, K, W, active) -> dx, dc, new codes, how many changed."""
        parts, ocp = self._parts, self._ocp
        n, m, N = ocp.nx, ocp.nu, ocp.stages
        dx, entries, b = ca.SX.sym("dx", n), ca.SX.sym("D", parts.D.count), ca.SX.sym("b", n)
        K, W, code = ca.SX.sym("K", m, n + 1), ca.SX.sym("W", m, n + 1), ca.SX.sym("code", m)
        x, c, count = ca.SX.sym("x", n), ca.SX.sym("c", m), ca.SX.sym("count")
        r = riccati.roll_out_stage(ocp, dx, K, W, parts.D.filled(entries), b, x, c, code)
        results = [ca.densify(e) for e in ca.cse([r.following, count + r.changed, r.dc, r.code])]
        step = ca.Function("roll", [dx, count, entries, b, K, W, code, x, c], results)
        x0 = ca.MX.sym("x0", n)
        X, C, _, _ = self._guess()
        D_all, b_all = ca.MX.sym("D", parts.D.count, N), ca.MX.sym("b", n, N)
        K_all, W_all, codes = (ca.MX.sym(s, r, N) for s, r in (("K", m * (n + 1)), ("W", m * (n + 1)), ("code", m)))
        begin = x0 - X[:, 0]
        wide = [ca.reshape(s, m, (n + 1) * N) for s in (K_all, W_all)]
        answer = step.mapaccum("run", N, 2)(begin, 0, D_all, b_all, *wide, codes, X[:, :N], C)
        following, counts, dc, chosen = answer
        return ca.Function(
            "roll", [x0, X, C, D_all, b_all, K_all, W_all, codes],
            [ca.horzcat(begin, following), dc, chosen, counts[:, N - 1]],
        )  # fmt: skip

    def _look_function(self) -> ca.Function:
        parts, ocp = self._parts, self._ocp
        N = ocp.stages
        sums, gap, cost = ca.SX.sym("sums", 4), ca.SX.sym("gap", ocp.nx), ca.SX.sym("cost")
        x, c = ca.SX.sym("x", ocp.nx), ca.SX.sym("c", ocp.nu)
        tally = ca.Function("tally", [sums, gap, cost, x, c], [accumulated(ocp, sums, gap, cost, x, c)])
        X, C, p, q = self._guess()
        gaps, costs = parts.look.map(N)(X[:, :N], C, X[:, 1:], p[:, :N], ca.repmat(q, 1, N))
        total = tally.mapaccum("tally", N)(ca.DM.zeros(4), gaps, costs, X[:, :N], C)[:, N - 1]
        end = parts.end_cost(X[:, N], p[:, N], q)
        return ca.Function("look", [X, C, p, q], [ca.densify(total + ca.vertcat(end, 0, 0, 0))])
