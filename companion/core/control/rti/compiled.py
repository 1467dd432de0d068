"""The real-time iteration as loops of kernels over one block of memory, for a compiler.

Entries:

    shift      X_k += shift (X_k+1 - X_k), C likewise
    prepare    linearise about the guess, Riccati sweep                            needs no state
    feedback   dx_0 = x0 - x_0, roll out; sweep and roll-out again while the active limits change; X += dx, C += dc
    look       cost, largest gap of the dynamics, largest excess over a limit
    solve      shift, `iterations` times prepare and feedback, look
    iterate    prepare, feedback, look
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from companion.core.control.rti import riccati
from companion.core.control.rti.interior_loops import InteriorPointLoops
from companion.core.control.rti.loops import Compiler, Fetch, Kernel, Loop, Operand, Repeat, Step, over_stages
from companion.core.control.rti.memory import LANES, Memory
from companion.core.control.rti.stage_functions import MOST_QPS, StageFunctions, accumulated


class CompiledRti:
    """Arrays by name in `view`, entries as functions without arguments. Raises NotCompiled."""

    def __init__(self, parts: StageFunctions, iterations: int, compiler: Compiler):
        ocp = parts.ocp
        self._parts, self._ocp, self._at = parts, ocp, Memory(parts)
        self._lanes = LANES if ocp.stages >= LANES else 4 if ocp.stages >= 4 else 1
        self._sweeps: dict[tuple[str, str], list[Step]] = {}
        self.view = self._at.view
        shift, prepare, look = self._shift(), self._prepare(), self._look()
        feedback, cold = self._feedback()
        entries = {  # order of the machine code: first what every solve runs
            "shift": shift,
            "look": look,
            "prepare": prepare,
            "feedback": feedback,
            "solve": [Fetch(cold), *shift, *[*prepare, *feedback] * iterations, *look],
            "iterate": [*prepare, *feedback, *look],
        }
        run = compiler(entries, self._at.doubles)
        self.prepare, self.feedback, self.look = (run[name] for name in ("prepare", "feedback", "look"))
        self.shift, self.solve, self.iterate = (run[name] for name in ("shift", "solve", "iterate"))

    def _prepare(self) -> list[Step]:
        ocp, parts, at = self._ocp, self._parts, self._at
        n, m, N = ocp.nx, ocp.nu, ocp.stages
        linear = Kernel(
            parts.linear,
            at.by_stage(),
            [
                at.entries("AB", parts.D, lanes=True), at.column("AB", n, lanes=True),
                at.entries("Hg", parts.H, lanes=True), at.column("Hg", n + m, lanes=True),
            ],
            self._lanes,
        )  # fmt: skip
        end = Kernel(
            parts.end,
            at.end(),
            [at.entries("end", parts.H_end, staged=False), at.column("end", n, staged=False)],
        )
        return [over_stages([linear], N), Loop([end], 1, N), *self._backward()]

    def _backward(self, cost: str = "Hg", codes: str = "active") -> list[Step]:
        """Riccati sweep: [P p] of the last stage, then the step of each stage backwards. Shared by all uses."""
        n, N, at = self._ocp.nx, self._ocp.stages, self._at
        if (cost, codes) not in self._sweeps:
            s = ca.SX.sym("s", n)
            copy = ca.Function("begin", [s], [s])
            begin = Kernel(copy, [at.rows("end", 0, n)], [at.rows("P", 0, n)], at.wide)
            # Q; law of the active controls, Cholesky factor of Q_cc; K and W; [P p] of this stage
            kernels = [self._cost_to_go(cost), self._factor(codes), self._gains(), self._before()]
            self._sweeps[cost, codes] = [Loop([begin], 1), Loop(kernels, N, N - 1, -1)]
        return self._sweeps[cost, codes]

    def _cost_to_go(self, cost: str) -> Kernel:
        n, m, parts, at = self._ocp.nx, self._ocp.nu, self._parts, self._at
        P, p, D = ca.SX.sym("P", n, n), ca.SX.sym("p", n), ca.SX.sym("D", parts.D.count)
        column, one, h = ca.SX.sym("column", n), ca.SX.sym("one"), ca.SX.sym("h", n + m)
        Q = riccati.state_control_cost(P, p, parts.D.filled(D), column, one, h)
        return Kernel(
            ca.Function("cost_to_go", [P, p, D, column, one, h], [ca.densify(Q)]),
            [
                at.block("P", range(n), range(n)), at.column("P", n, staged=False), at.entries("AB", parts.D),
                at.rows("AB", 0, n, staged=True), at.lane("one"), at.rows(cost, 0, n + m, staged=True),
            ],
            [at.rows("Q", 0, n + m)],
            at.wide,
        )  # fmt: skip

    def _factor(self, codes: str) -> Kernel:
        ocp, at = self._ocp, self._at
        n, m = ocp.nx, ocp.nu
        Q_cc, code = ca.SX.sym("Q", m, m), ca.SX.sym("code", m)
        x, c = ca.SX.sym("x", n), ca.SX.sym("c", m)
        law = riccati.active_law(ocp, code, x, c)
        L, inverse = riccati.factor(Q_cc, law.active)
        below = [L[i][j] for i in range(m) for j in range(i)]
        controls = range(n, n + m)
        return Kernel(
            ca.Function(
                "factor", [Q_cc, code, x, c],
                [ca.densify(ca.vertcat(*law)), ca.vertcat(ca.SX(0, 1), *below), ca.vertcat(*inverse)],
            ),
            [at.block("Q", controls, controls), at.codes(codes), at.staged("X"), at.staged("C")],
            [at.one("law"), Operand(at.base["L"], 0, range(len(below))), at.one("inverse")],
        )  # fmt: skip

    def _gains(self) -> Kernel:
        n, m, at = self._ocp.nx, self._ocp.nu, self._at
        Q_c, Q_cc, law = ca.SX.sym("Q_c", m), ca.SX.sym("Q", m, m), ca.SX.sym("law", 3 * m)
        below, inverse = ca.SX.sym("L", m * (m - 1) // 2), ca.SX.sym("inverse", m)
        force, one = ca.SX.sym("force", m), ca.SX.sym("one")
        L = [[below[i * (i - 1) // 2 + j] for j in range(i)] for i in range(m)]
        active_law = riccati.ActiveLaw(*ca.vertsplit(law, m))
        K, W = riccati.gains(Q_c, Q_cc, active_law, L, [inverse[i] for i in range(m)], force, one)
        controls = range(n, n + m)
        return Kernel(
            ca.Function("gains", [Q_c, Q_cc, law, below, inverse, force, one], [ca.densify(K), ca.densify(W)]),
            [
                at.rows("Q", n, m), at.block("Q", controls, controls), at.one("law"),
                Operand(at.base["L"], 0, range(below.numel())), at.one("inverse"),
                at.rows("force", 0, m), at.lane("one"),
            ],
            [at.rows("K", 0, m, staged=True), at.rows("W", 0, m, staged=True)],
            at.wide,
        )  # fmt: skip

    def _before(self) -> Kernel:
        n, m, at = self._ocp.nx, self._ocp.nu, self._at
        Q_x, Q_cx, K_x = ca.SX.sym("Q_x", n), ca.SX.sym("Q_cx", m, n), ca.SX.sym("K_x", m, n)
        K, W = ca.SX.sym("K", m), ca.SX.sym("W", m)
        return Kernel(
            ca.Function("before", [Q_x, Q_cx, K_x, K, W], [riccati.previous_cost_to_go(Q_x, Q_cx, K_x, K, W)]),
            [
                at.rows("Q", 0, n), at.block("Q", range(n, n + m), range(n)),
                at.block("K", range(m), range(n), staged=True),
                at.rows("K", 0, m, staged=True), at.rows("W", 0, m, staged=True),
            ],
            [at.rows("P", 0, n)],
            at.wide,
        )  # fmt: skip

    def _feedback(self) -> tuple[list[Step], Kernel]:
        """The steps, and the first kernel of the interior-point method, which a solve seldom needs.

        1. roll out  2. while limits change: Riccati sweep, roll out  3. still changing: interior point  4. move
        """
        ocp, at = self._ocp, self._at
        n, N = ocp.nx, ocp.stages
        x0, first = ca.SX.sym("x0", n), ca.SX.sym("x", n)
        zero = ca.SX(1, 1)
        begin = Kernel(
            ca.Function("begin", [x0, first], [x0 - first, ca.densify(zero)]),
            [at.one("x0"), at.staged("X")],
            [at.staged("dx"), at.one("changed")],
        )
        forward: list[Step] = [Loop([begin], 1), Loop([self._roll()], N)]
        again = Repeat([*self._backward(), *forward], at.base["changed"], MOST_QPS - 1)
        inner = self._interior_point(begin)
        steps = [*forward, again, Repeat(inner, at.base["changed"], 1), *self._move()]
        return steps, next(step.kernels[0] for step in inner if isinstance(step, Loop))

    def _interior_point(self, begin: Kernel) -> list[Step]:
        """For quadratic programs whose active limits do not settle within `MOST_QPS` sweeps."""
        ocp, parts, at = self._ocp, self._parts, self._at
        n, m, N = ocp.nx, ocp.nu, ocp.stages
        dx, K = ca.SX.sym("dx", n), ca.SX.sym("K", m, n + 1)
        D, b = ca.SX.sym("D", parts.D.count), ca.SX.sym("b", n)
        dc = K @ ca.vertcat(dx, 1)
        advance = Kernel(
            ca.Function("advance", [dx, K, D, b], [dc, ca.densify(parts.D.filled(D) @ ca.vertcat(dx, dc) + b)]),
            [at.staged("dx"), at.block("K", range(m), [*range(n), n + m], staged=True),
             at.entries("AB", parts.D), at.column("AB", n)],
            [at.staged("dc"), at.staged("dx", ahead=1)],
        )  # fmt: skip
        forward: list[Step] = [Loop([begin], 1), Loop([advance], N)]
        return InteriorPointLoops(ocp, at.base, at.wide, self._backward("barred", "dead"), forward).steps()

    def _roll(self) -> Kernel:
        ocp, parts, at = self._ocp, self._parts, self._at
        n, m = ocp.nx, ocp.nu
        dx, K, W = ca.SX.sym("dx", n), ca.SX.sym("K", m, n + 1), ca.SX.sym("W", m, n + 1)
        D, b = ca.SX.sym("D", parts.D.count), ca.SX.sym("b", n)
        x, c, code, count = ca.SX.sym("x", n), ca.SX.sym("c", m), ca.SX.sym("code", m), ca.SX.sym("count")
        r = riccati.roll_out_stage(ocp, dx, K, W, parts.D.filled(D), b, x, c, code)
        columns = [*range(n), n + m]
        return Kernel(
            ca.Function(
                "roll", [dx, K, W, D, b, x, c, code, count],
                [ca.densify(e) for e in ca.cse([r.dc, r.following, r.code, r.changed + count])],
            ),
            [
                at.staged("dx"), at.block("K", range(m), columns, staged=True),
                at.block("W", range(m), columns, staged=True), at.entries("AB", parts.D), at.column("AB", n),
                at.staged("X"), at.staged("C"), at.staged("active"), at.one("changed"),
            ],
            [at.staged("dc"), at.staged("dx", ahead=1), at.staged("active"), at.one("changed")],
        )  # fmt: skip

    def _move(self) -> list[Step]:
        """X += dx, C += dc, padding included."""
        at = self._at
        a, b = ca.SX.sym("a"), ca.SX.sym("b")
        add = ca.Function("move", [a, b], [a + b])
        loops: list[Step] = []
        for name, by in (("X", "dx"), ("C", "dc")):
            to, step = Operand(at.base[name], LANES, (0,), 1), Operand(at.base[by], LANES, (0,), 1)
            count = -(-int(np.prod(at.shape[name])) // LANES)
            loops.append(Loop([Kernel(add, [to, step], [to], LANES)], count))
        return loops

    def _look(self) -> list[Step]:
        ocp, parts, at = self._ocp, self._parts, self._at
        n, m, N = ocp.nx, ocp.nu, ocp.stages
        look = Kernel(
            parts.look,
            at.by_stage(),
            [at.staged("gap", lanes=True), at.staged("cost", lanes=True)],
            self._lanes,
        )
        end = Kernel(parts.end_cost, at.end(), [at.staged("cost")])
        clear = Kernel(ca.Function("clear", [], [ca.densify(ca.SX(4, 1))]), [], [at.one("sums")])
        gap, cost, x, c = ca.SX.sym("gap", n), ca.SX.sym("cost"), ca.SX.sym("x", n), ca.SX.sym("c", m)
        sums = ca.SX.sym("sums", 4)
        tally = Kernel(
            ca.Function("tally", [sums, gap, cost, x, c], [accumulated(ocp, sums, gap, cost, x, c)]),
            [at.one("sums"), at.staged("gap"), at.staged("cost"), at.staged("X"), at.staged("C")],
            [at.one("sums")],
        )
        cost_N = Kernel(
            ca.Function("close", [sums, cost], [ca.vertcat(sums[0] + cost, sums[1:])]),
            [at.one("sums"), at.staged("cost")],
            [at.one("sums")],
        )
        return [over_stages([look], N), Loop([end], 1, N), Loop([clear], 1), Loop([tally], N), Loop([cost_N], 1, N)]

    def _shift(self) -> list[Step]:
        """X_k += shift (X_k+1 - X_k), C_k likewise, `shift` in stages; the last ones stay."""
        n, m, N, at = self._ocp.nx, self._ocp.nu, self._ocp.stages, self._at
        loops: list[Step] = []
        for name, size, count in (("X", n, N), ("C", m, N - 1)):
            a, b, share = ca.SX.sym("a", size), ca.SX.sym("b", size), ca.SX.sym("share")
            toward = ca.Function("toward", [a, b, share], [a + share * (b - a)])
            inputs = [at.staged(name), at.staged(name, ahead=1), at.one("shift")]
            if count:
                loops.append(Loop([Kernel(toward, inputs, [at.staged(name)])], count))
        return loops
