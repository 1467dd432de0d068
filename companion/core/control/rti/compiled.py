"""The real-time iteration as machine code: memory, kernels, loops.

All arrays lie in one block. Matrices of a stage are rows of `width` doubles, columns [x c 1] and padding, so that a row
is one lane; the linearisation takes stages for lanes. Entries of the module:

    prepare   linearise about the guess, Riccati factors            before the state is known
    feedback  dx_0 = x0 - x_0, roll out, mend the active limits, move      after
    solve     shift the guess, `iterations` times prepare and feedback, then look
    look      cost, largest gap of the dynamics, largest excess over a limit
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from companion.core.control.ocp import Ocp
from companion.core.control.rti import riccati
from companion.core.control.rti.interior_loops import Interior
from companion.core.control.rti.stage_functions import Parts, Pattern
from companion.jit import Fetch, Kernel, Loop, Machine, Operand, Repeat, Store
from companion.jit.program import Step, over

LANES = 8
"""Stages that are linearised at once; processors with shorter vectors split them."""
SWEEPS = 12
"""Quadratic programs solved at most while the active limits change."""


class MemoryLayout:
    """Named arrays, one after the other, each on a cache line."""

    def __init__(self) -> None:
        self._places: dict[str, tuple[int, tuple[int, ...]]] = {}
        self.size = 0

    def add(self, name: str, *shape: int) -> int:
        """Room for an array; its base."""
        self._places[name] = self.size, shape
        self.size += -(-(int(np.prod(shape)) + LANES) // LANES) * LANES
        return self._places[name][0]

    def views(self, memory: np.ndarray) -> dict[str, np.ndarray]:
        """The arrays as views of the block."""
        return {
            name: memory[base : base + int(np.prod(shape))].reshape(shape)
            for name, (base, shape) in self._places.items()
        }


class CompiledRti:
    """Arrays by name in `view`, and the entries as functions without arguments. Raises NotCompiled."""

    def __init__(self, parts: Parts, iterations: int, store: Store | None = None):
        ocp = parts.ocp
        self._parts, self._ocp = parts, ocp
        n, m, N = ocp.nx, ocp.nu, ocp.stages
        self._wide = -(-(n + m + 1) // 4) * 4
        self._lanes = LANES if N >= LANES else 4 if N >= 4 else 1
        layout = MemoryLayout()
        wide = self._wide
        shapes = {
            "X": (N + 1, n), "C": (N, m), "x0": (n,), "p": (N + 1, ocp.p.numel()), "q": (ocp.q.numel(),),
            "shift": (1,), "active": (N, m), "told": (5,),
            "dx": (N + 1, n), "dc": (N, m),
            "AB": (N, n, wide), "Hg": (N, n + m, wide), "end": (n, wide), "P": (n, wide), "Q": (n + m, wide),
            "law": (3, m), "L": (m, m), "inverse": (m,), "K": (N, m, wide), "W": (N, m, wide),
            "one": (wide,), "force": (m, wide), "gap": (N, n), "cost": (N + 1,),
            "barred": (N, n + m, wide), "dead": (m,), "alive": (m,), "c_min": (m,), "c_max": (m,),
            "s": (N, 4, m), "z": (N, 4, m), "mu": (1,), "share_s": (m,), "share_z": (m,), "sz": (m,), "open": (1,),
        }  # fmt: skip
        self._at = {name: layout.add(name, *shape) for name, shape in shapes.items()}
        self._at |= {"sums": self._at["told"], "changed": self._at["told"] + 4}
        self._shape = shapes | {"sums": (4,), "changed": (1,)}
        self._sweeps: dict[tuple[str, str], list[Step]] = {}
        memory = np.zeros(layout.size + LANES)
        memory = memory[(-(memory.ctypes.data // 8)) % LANES :][: layout.size]
        self.view = layout.views(memory)
        v = self.view
        v["AB"][:, :, : n + m] = parts.D.rest
        v["Hg"][:, :, : n + m] = parts.H.rest
        v["end"][:, :n] = parts.H_end.rest
        v["one"][n + m] = 1.0
        if ocp.forces is not None:
            v["force"][np.arange(m), ocp.forces + np.arange(m)] = 1.0
        v["c_min"][:], v["c_max"][:] = ocp.c_min, ocp.c_max
        v["dead"][:] = ocp.c_min >= ocp.c_max
        v["alive"][:] = 1.0 - v["dead"]
        shift, prepare, look = self._shift(), self._prepare(), self._look()
        feedback, rarely = self._feedback()
        entries = {  # the code lies in this order: what every solve runs first, then what it seldom does
            "shift": shift,
            "look": look,
            "prepare": prepare,
            "feedback": feedback,
            "solve": [Fetch(rarely), *shift, *[*prepare, *feedback] * iterations, *look],
            "iterate": [*prepare, *feedback, *look],
        }
        machine = Machine(entries, memory, store)
        self.prepare, self.feedback, self.look = (machine.entry(n) for n in ("prepare", "feedback", "look"))
        self.shift, self.solve, self.iterate = (machine.entry(n) for n in ("shift", "solve", "iterate"))

    # where arguments are

    def _one(self, name: str, count: int | None = None, *, offset: int = 0) -> Operand:
        """The whole array, or `count` of it from `offset`, the same at every stage."""
        size = int(np.prod(self._shape[name]))
        return Operand(self._at[name] + offset, 0, range(count or size))

    def _staged(self, name: str, *, ahead: int = 0, lanes: bool = False) -> Operand:
        """Row k (+ ahead) of an array by stage."""
        step = int(np.prod(self._shape[name][1:]))
        return Operand(self._at[name] + ahead * step, step, range(step), step if lanes else None)

    def _entries(self, name: str, pattern: Pattern, *, lanes: bool = False, staged: bool = True) -> Operand:
        """Varying entries of a matrix by stage."""
        step = int(np.prod(self._shape[name][1:])) if staged else 0
        offsets = (pattern.rows * self._wide + pattern.columns).tolist()
        return Operand(self._at[name], step, offsets, step if lanes else None)

    def _column(self, name: str, rows: int, *, lanes: bool = False, staged: bool = True) -> Operand:
        """The last column, that of 1: b, g, p or k."""
        step = int(np.prod(self._shape[name][1:])) if staged else 0
        offsets = range(self._ocp.nx + self._ocp.nu, rows * self._wide, self._wide)
        return Operand(self._at[name], step, offsets, step if lanes else None)

    def _rows(self, name: str, first: int, count: int, *, staged: bool = False) -> Operand:
        """Rows of a matrix, their columns as lanes."""
        step = int(np.prod(self._shape[name][1:])) if staged else 0
        return Operand(self._at[name], step, range(first * self._wide, (first + count) * self._wide, self._wide), 1)

    def _block(self, name: str, rows: Sequence[int], columns: Sequence[int], *, staged: bool = False) -> Operand:
        """A dense block, column by column as CasADi counts."""
        step = int(np.prod(self._shape[name][1:])) if staged else 0
        offsets = [r * self._wide + c for c in columns for r in rows]
        return Operand(self._at[name], step, offsets)

    def _by_stage(self) -> list[Operand]:
        """Arguments of what is done at each stage: x, c, the next x, p and q, stages as lanes."""
        x, c, p = (self._staged(name, lanes=True) for name in ("X", "C", "p"))
        return [x, c, self._staged("X", ahead=1, lanes=True), p, self._one("q")]

    def _at_the_end(self) -> list[Operand]:
        """Arguments of what is done at the last x: x, p and q."""
        return [self._staged("X"), self._staged("p"), self._one("q")]

    def _codes(self, name: str) -> Operand:
        """Of the stage, or of controls that are dead at all stages."""
        return self._one(name) if name == "dead" else self._staged(name)

    # kernels

    def _prepare(self) -> list[Step]:
        ocp, parts = self._ocp, self._parts
        n, m, N = ocp.nx, ocp.nu, ocp.stages
        linear = Kernel(
            parts.linear,
            self._by_stage(),
            [
                self._entries("AB", parts.D, lanes=True), self._column("AB", n, lanes=True),
                self._entries("Hg", parts.H, lanes=True), self._column("Hg", n + m, lanes=True),
            ],
            self._lanes,
        )  # fmt: skip
        end = Kernel(
            parts.end,
            self._at_the_end(),
            [self._entries("end", parts.H_end, staged=False), self._column("end", n, staged=False)],
        )
        return [over([linear], N), Loop([end], 1, N), *self._backward()]

    def _backward(self, cost: str = "Hg", codes: str = "active") -> list[Step]:
        """P of the last stage, then the Riccati step from the last stage to the first; one code for all uses."""
        n, N = self._ocp.nx, self._ocp.stages
        if (cost, codes) not in self._sweeps:
            s = ca.SX.sym("s", n)
            copy = ca.Function("begin", [s], [s])
            begin = Kernel(copy, [self._rows("end", 0, n)], [self._rows("P", 0, n)], self._wide)
            kernels = [self._cost_to_go(cost), self._factor(codes), self._gains(), self._before()]
            self._sweeps[cost, codes] = [Loop([begin], 1), Loop(kernels, N, N - 1, -1)]
        return self._sweeps[cost, codes]

    def _cost_to_go(self, cost: str) -> Kernel:
        n, m, parts = self._ocp.nx, self._ocp.nu, self._parts
        P, p, D = ca.SX.sym("P", n, n), ca.SX.sym("p", n), ca.SX.sym("D", parts.D.count)
        column, one, h = ca.SX.sym("column", n), ca.SX.sym("one"), ca.SX.sym("h", n + m)
        Q = riccati.cost_to_go(P, p, parts.D.filled(D), column, one, h)
        return Kernel(
            ca.Function("cost_to_go", [P, p, D, column, one, h], [ca.densify(Q)]),
            [
                self._block("P", range(n), range(n)), self._column("P", n, staged=False), self._entries("AB", parts.D),
                self._rows("AB", 0, n, staged=True), self._lane("one"), self._rows(cost, 0, n + m, staged=True),
            ],
            [self._rows("Q", 0, n + m)],
            self._wide,
        )  # fmt: skip

    def _lane(self, name: str) -> Operand:
        """One row of `width`."""
        return Operand(self._at[name], 0, (0,), 1)

    def _factor(self, codes: str) -> Kernel:
        ocp = self._ocp
        n, m = ocp.nx, ocp.nu
        Q_cc, code = ca.SX.sym("Q", m, m), ca.SX.sym("code", m)
        x, c = ca.SX.sym("x", n), ca.SX.sym("c", m)
        law = riccati.held(ocp, code, x, c)
        L, inverse = riccati.factor(Q_cc, law.active)
        below = [L[i][j] for i in range(m) for j in range(i)]
        controls = range(n, n + m)
        return Kernel(
            ca.Function(
                "factor", [Q_cc, code, x, c],
                [ca.densify(ca.vertcat(*law)), ca.vertcat(ca.SX(0, 1), *below), ca.vertcat(*inverse)],
            ),
            [self._block("Q", controls, controls), self._codes(codes), self._staged("X"), self._staged("C")],
            [self._one("law"), Operand(self._at["L"], 0, range(len(below))), self._one("inverse")],
        )  # fmt: skip

    def _gains(self) -> Kernel:
        n, m = self._ocp.nx, self._ocp.nu
        Q_c, Q_cc, law = ca.SX.sym("Q_c", m), ca.SX.sym("Q", m, m), ca.SX.sym("law", 3 * m)
        below, inverse = ca.SX.sym("L", m * (m - 1) // 2), ca.SX.sym("inverse", m)
        force, one = ca.SX.sym("force", m), ca.SX.sym("one")
        L = [[below[i * (i - 1) // 2 + j] for j in range(i)] for i in range(m)]
        held = riccati.Held(*ca.vertsplit(law, m))
        K, W = riccati.gains(Q_c, Q_cc, held, L, [inverse[i] for i in range(m)], force, one)
        controls = range(n, n + m)
        return Kernel(
            ca.Function("gains", [Q_c, Q_cc, law, below, inverse, force, one], [ca.densify(K), ca.densify(W)]),
            [
                self._rows("Q", n, m), self._block("Q", controls, controls), self._one("law"),
                Operand(self._at["L"], 0, range(below.numel())), self._one("inverse"),
                self._rows("force", 0, m), self._lane("one"),
            ],
            [self._rows("K", 0, m, staged=True), self._rows("W", 0, m, staged=True)],
            self._wide,
        )  # fmt: skip

    def _before(self) -> Kernel:
        n, m = self._ocp.nx, self._ocp.nu
        Q_x, Q_cx, K_x = ca.SX.sym("Q_x", n), ca.SX.sym("Q_cx", m, n), ca.SX.sym("K_x", m, n)
        K, W = ca.SX.sym("K", m), ca.SX.sym("W", m)
        return Kernel(
            ca.Function("before", [Q_x, Q_cx, K_x, K, W], [riccati.before(Q_x, Q_cx, K_x, K, W)]),
            [
                self._rows("Q", 0, n), self._block("Q", range(n, n + m), range(n)),
                self._block("K", range(m), range(n), staged=True),
                self._rows("K", 0, m, staged=True), self._rows("W", 0, m, staged=True),
            ],
            [self._rows("P", 0, n)],
            self._wide,
        )  # fmt: skip

    def _feedback(self) -> tuple[list[Step], Kernel]:
        """The steps, and the first kernel of what a solve seldom needs."""
        ocp = self._ocp
        n, N = ocp.nx, ocp.stages
        x0, first = ca.SX.sym("x0", n), ca.SX.sym("x", n)
        nothing = ca.SX(1, 1)
        begin = Kernel(
            ca.Function("begin", [x0, first], [x0 - first, ca.densify(nothing)]),
            [self._one("x0"), self._staged("X")],
            [self._staged("dx"), self._one("changed")],
        )
        forward: list[Step] = [Loop([begin], 1), Loop([self._roll()], N)]
        again = Repeat([*self._backward(), *forward], self._at["changed"], SWEEPS - 1)
        inner = self._interior_point(begin)
        steps = [*forward, again, Repeat(inner, self._at["changed"], 1), *self._move()]
        return steps, next(step.kernels[0] for step in inner if isinstance(step, Loop))

    def _interior_point(self, begin: Kernel) -> list[Step]:
        """For programs whose active limits do not settle."""
        ocp, parts = self._ocp, self._parts
        n, m, N = ocp.nx, ocp.nu, ocp.stages
        dx, K = ca.SX.sym("dx", n), ca.SX.sym("K", m, n + 1)
        D, b = ca.SX.sym("D", parts.D.count), ca.SX.sym("b", n)
        dc = K @ ca.vertcat(dx, 1)
        advance = Kernel(
            ca.Function("advance", [dx, K, D, b], [dc, ca.densify(parts.D.filled(D) @ ca.vertcat(dx, dc) + b)]),
            [self._staged("dx"), self._block("K", range(m), [*range(n), n + m], staged=True),
             self._entries("AB", parts.D), self._column("AB", n)],
            [self._staged("dc"), self._staged("dx", ahead=1)],
        )  # fmt: skip
        forward: list[Step] = [Loop([begin], 1), Loop([advance], N)]
        return Interior(ocp, self._at, self._wide, self._backward("barred", "dead"), forward).steps()

    def _roll(self) -> Kernel:
        ocp, parts = self._ocp, self._parts
        n, m = ocp.nx, ocp.nu
        dx, K, W = ca.SX.sym("dx", n), ca.SX.sym("K", m, n + 1), ca.SX.sym("W", m, n + 1)
        D, b = ca.SX.sym("D", parts.D.count), ca.SX.sym("b", n)
        x, c, code, count = ca.SX.sym("x", n), ca.SX.sym("c", m), ca.SX.sym("code", m), ca.SX.sym("count")
        r = riccati.roll(ocp, dx, K, W, parts.D.filled(D), b, x, c, code)
        columns = [*range(n), n + m]
        return Kernel(
            ca.Function(
                "roll", [dx, K, W, D, b, x, c, code, count],
                [ca.densify(e) for e in ca.cse([r.dc, r.following, r.code, r.changed + count])],
            ),
            [
                self._staged("dx"), self._block("K", range(m), columns, staged=True),
                self._block("W", range(m), columns, staged=True), self._entries("AB", parts.D), self._column("AB", n),
                self._staged("X"), self._staged("C"), self._staged("active"), self._one("changed"),
            ],
            [self._staged("dc"), self._staged("dx", ahead=1), self._staged("active"), self._one("changed")],
        )  # fmt: skip

    def _move(self) -> list[Step]:
        """X += dx, C += dc; the padding moves with them."""
        a, b = ca.SX.sym("a"), ca.SX.sym("b")
        add = ca.Function("move", [a, b], [a + b])
        loops: list[Step] = []
        for name, by in (("X", "dx"), ("C", "dc")):
            to, step = Operand(self._at[name], LANES, (0,), 1), Operand(self._at[by], LANES, (0,), 1)
            count = -(-int(np.prod(self._shape[name])) // LANES)
            loops.append(Loop([Kernel(add, [to, step], [to], LANES)], count))
        return loops

    def _look(self) -> list[Step]:
        ocp, parts = self._ocp, self._parts
        n, m, N = ocp.nx, ocp.nu, ocp.stages
        look = Kernel(
            parts.look,
            self._by_stage(),
            [self._staged("gap", lanes=True), self._staged("cost", lanes=True)],
            self._lanes,
        )
        end = Kernel(parts.end_cost, self._at_the_end(), [self._staged("cost")])
        clear = Kernel(ca.Function("clear", [], [ca.densify(ca.SX(4, 1))]), [], [self._one("sums")])
        gap, cost, x, c = ca.SX.sym("gap", n), ca.SX.sym("cost"), ca.SX.sym("x", n), ca.SX.sym("c", m)
        so_far = ca.SX.sym("sums", 4)
        tally = Kernel(
            ca.Function("tally", [so_far, gap, cost, x, c], [tallied(ocp, so_far, gap, cost, x, c)]),
            [self._one("sums"), self._staged("gap"), self._staged("cost"), self._staged("X"), self._staged("C")],
            [self._one("sums")],
        )
        cost_N = Kernel(
            ca.Function("close", [so_far, cost], [ca.vertcat(so_far[0] + cost, so_far[1:])]),
            [self._one("sums"), self._staged("cost")],
            [self._one("sums")],
        )
        return [over([look], N), Loop([end], 1, N), Loop([clear], 1), Loop([tally], N), Loop([cost_N], 1, N)]

    def _shift(self) -> list[Step]:
        """X_k, C_k towards those of the next stage by the share `shift` of a stage; the last ones hold."""
        n, m, N = self._ocp.nx, self._ocp.nu, self._ocp.stages
        loops: list[Step] = []
        for name, size, count in (("X", n, N), ("C", m, N - 1)):
            a, b, share = ca.SX.sym("a", size), ca.SX.sym("b", size), ca.SX.sym("share")
            toward = ca.Function("toward", [a, b, share], [a + share * (b - a)])
            there = [self._staged(name), self._staged(name, ahead=1), self._one("shift")]
            if count:
                loops.append(Loop([Kernel(toward, there, [self._staged(name)])], count))
        return loops


def tallied(ocp: Ocp, sums: ca.SX, gap: ca.SX, cost: ca.SX, x: ca.SX, c: ca.SX) -> ca.SX:
    """[cost, largest gap over scale, largest excess over a limit, sum of squared gaps], with one more stage."""
    gaps = ca.fabs(gap) / ca.DM(ocp.scale)
    excess = ca.fmax(c - ca.DM(ocp.c_max), ca.DM(ocp.c_min) - c)
    if ocp.forces is not None:
        excess = ca.fmax(excess, ca.fabs(c - x[ocp.forces : ocp.forces + ocp.nu]) - ocp.rate_n)
    return ca.vertcat(
        sums[0] + cost, ca.fmax(sums[1], ca.mmax(gaps)), ca.fmax(sums[2], ca.mmax(excess)), sums[3] + ca.sumsqr(gap)
    )
