"""The interior-point method as loops of kernels over `memory.Memory`; the controls of a stage are the lanes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import casadi as ca
import numpy as np

from companion.core.control.ocp import Ocp
from companion.core.control.rti import interior_point
from companion.core.control.rti.loops import Kernel, Loop, Operand, Repeat, Step


class InteriorPointLoops:
    """`at`: first double of each array; `wide`: doubles of a matrix row; `sweep`: Riccati sweep on the Hessian with the
    barrier terms; `advance`: roll-out.
    """

    def __init__(self, ocp: Ocp, at: Mapping[str, int], wide: int, sweep: Sequence[Step], advance: Sequence[Step]):
        self._ocp, self._at, self._wide, self._sweep, self._advance = ocp, at, wide, sweep, advance
        self._j = 2 if ocp.forces is None else 4

    def steps(self) -> list[Step]:
        """Start, Newton steps until solved, then the codes of the active limits.

        1. s, z, mu start
        2. while open: barrier terms, Riccati sweep, roll-out, step lengths, move s and z, next mu
        3. codes of `active` from s and z; `changed` = still open
        """
        ocp = self._ocp
        N, at = ocp.stages, self._at
        size = N * (ocp.nx + ocp.nu) * self._wide
        a = ca.SX.sym("a")
        copy = Kernel(
            ca.Function("copy", [a], [a]),
            [Operand(at["Hg"], 8, (0,), 1)], [Operand(at["barred"], 8, (0,), 1)], 8,
        )  # fmt: skip
        clear = self._scalars("far", [], {"share_s": ca.SX.ones(1), "share_z": ca.SX.ones(1), "sz": ca.SX(1, 1)})
        body: list[Step] = [
            Loop([copy], -(-size // 8)),
            Loop([self._barrier()], N),
            *self._sweep,
            *self._advance,
            Loop([clear], 1),
            Loop([self._step_lengths()], N),
            Loop([self._common_step()], 1),
            Loop([self._move()], N),
            Loop([self._next_mu()], 1),
        ]
        mu, is_open = ca.SX(interior_point.MU_START), ca.SX(1)
        begin = Kernel(
            ca.Function("begin", [], [ca.densify(mu), ca.densify(is_open)]), [], [self._one("mu"), self._one("open")]
        )
        return [
            Loop([begin], 1), Loop([self._start()], N), Repeat(body, at["open"], interior_point.MOST_STEPS),
            Loop([self._codes()], N), Loop([self._still_open()], 1),
        ]  # fmt: skip

    def _one(self, name: str) -> Operand:
        return Operand(self._at[name], 0, (0,))

    def _lane(self, name: str) -> Operand:
        return Operand(self._at[name], 0, (0,), 1)

    def _scalars(self, name: str, inputs: list[ca.SX], outputs: dict[str, ca.SX]) -> Kernel:
        """A kernel without loop over stages: `outputs` by name, controls as lanes."""
        function = ca.Function(name, inputs, [ca.densify(e) for e in outputs.values()])
        return Kernel(function, [], [self._lane(o) for o in outputs], self._ocp.nu)

    def _kernel(self, name: str, extra: Sequence[str], make: Callable[..., dict[str, ca.SX]]) -> Kernel:
        """A kernel over controls as lanes: `make(at, **symbols)` gives the outputs by name."""
        ocp, j = self._ocp, self._j
        c, f, low, high = (ca.SX.sym(s) for s in ("c", "f", "low", "high"))
        with_f = ocp.forces is not None
        symbols = {s: ca.SX.sym(s, j if s in ("s", "z") else 1) for s in extra}
        own = [ca.SX.sym("rate")] if isinstance(ocp.rate_n, np.ndarray) else []
        rate = own[0] if own else float(ocp.rate_n)
        limits = interior_point.limits(c, f if with_f else None, low, high, rate)
        outputs = make(limits, **symbols)
        inputs = [c, *([f] if with_f else []), low, high, *own, *symbols.values()]
        names = ["C", *(["X"] if with_f else []), "c_min", "c_max", *(["rate"] if own else []), *extra]
        function = ca.Function(name, inputs, [ca.densify(e) for e in outputs.values()])
        return Kernel(function, [self._place(s) for s in names], [self._place(s) for s in outputs], ocp.nu)

    def _place(self, name: str) -> Operand:
        """Operand of an array, or of an entry `matrix:entry` of a matrix, whose lane i belongs to control i."""
        ocp, wide = self._ocp, self._wide
        n, m, base = ocp.nx, ocp.nu, self._at.get(name, 0)
        if name in ("X", "dx"):
            return Operand(base, n, (ocp.forces or 0,), 1)
        if name in ("C", "dc", "active"):
            return Operand(base, m, (0,), 1)
        if name in ("s", "z"):
            return Operand(base, 4 * m, tuple(m * j for j in range(self._j)), 1)
        if ":" in name:
            matrix, entry = name.split(":")
            stage, f = (n + m) * wide, ocp.forces or 0
            first = {"cc": n * wide + n, "ff": f * wide + f, "cf": n * wide + f, "fc": f * wide + n,
                     "c": n * wide + n + m, "f": f * wide + n + m}[entry]  # fmt: skip
            return Operand(self._at[matrix], stage, (first,), wide if entry in ("c", "f") else wide + 1)
        if name in ("mu", "open"):
            return self._one(name)
        return self._lane(name)

    def _start(self) -> Kernel:
        def make(at: interior_point.BoundPair) -> dict[str, ca.SX]:
            s, z = interior_point.initial_slacks(at)
            return {"s": s, "z": z}

        return self._kernel("begun", (), make)

    def _barrier(self) -> Kernel:
        entries = ("cc", "c") if self._ocp.forces is None else ("cc", "ff", "cf", "c", "f")
        of_cost = tuple(f"Hg:{e}" for e in entries)

        def make(
            at: interior_point.BoundPair, s: ca.SX, z: ca.SX, mu: ca.SX, alive: ca.SX, **H: ca.SX
        ) -> dict[str, ca.SX]:
            bar = interior_point.barrier(at, s, z, mu)
            out = {f"barred:{e}": H[f"Hg:{e}"] + alive * getattr(bar, e) for e in entries}
            if "cf" in entries:
                out["barred:fc"] = out["barred:cf"]
            return out

        return self._kernel("barrier", ("s", "z", "mu", "alive", *of_cost), make)

    def _step_lengths(self) -> Kernel:
        """Step lengths of s and z to the boundary, the least over the stages so far; dead controls do not count."""

        def make(
            at: interior_point.BoundPair, s: ca.SX, z: ca.SX, mu: ca.SX, alive: ca.SX, **v: ca.SX
        ) -> dict[str, ca.SX]:
            ds, dz = interior_point.slack_step(at, s, z, mu, v["dc"], v.get("dx", ca.SX(0)))
            dead = 1 - alive
            return {
                "share_s": ca.fmin(v["share_s"], interior_point.step_to_boundary(s, ds, v["share_s"]) + 1e9 * dead),
                "share_z": ca.fmin(v["share_z"], interior_point.step_to_boundary(z, dz, v["share_z"]) + 1e9 * dead),
            }

        return self._kernel("ratio", ("s", "z", "mu", "alive", "dc", *self._df(), "share_s", "share_z"), make)

    def _df(self) -> tuple[str, ...]:
        return () if self._ocp.forces is None else ("dx",)

    def _common_step(self) -> Kernel:
        """One step length of s and one of z for all controls: min(1, `STEP_FRACTION` times the least of them)."""
        m = self._ocp.nu
        s, z = ca.SX.sym("s", m), ca.SX.sym("z", m)
        lengths = [ca.fmin(1, interior_point.STEP_FRACTION * ca.mmin(v)) for v in (s, z)]
        where = [Operand(self._at[n], 0, range(m)) for n in ("share_s", "share_z")]
        shares = ca.Function("shares", [s, z], [ca.repmat(v, m, 1) for v in lengths])
        return Kernel(shares, where, where)

    def _move(self) -> Kernel:
        """s += alpha_s ds, z += alpha_z dz; sum of s z."""

        def make(
            at: interior_point.BoundPair, s: ca.SX, z: ca.SX, mu: ca.SX, alive: ca.SX, **v: ca.SX
        ) -> dict[str, ca.SX]:
            ds, dz = interior_point.slack_step(at, s, z, mu, v["dc"], v.get("dx", ca.SX(0)))
            s_new, z_new = s + v["share_s"] * ds, z + v["share_z"] * dz
            return {"s": s_new, "z": z_new, "sz": v["sz"] + alive * ca.dot(s_new, z_new)}

        return self._kernel("apply", ("s", "z", "mu", "alive", "dc", *self._df(), "share_s", "share_z", "sz"), make)

    def _next_mu(self) -> Kernel:
        """mu = sigma mean(s z) of the next step, and whether there is one."""
        ocp, m = self._ocp, self._ocp.nu
        sz, share_s, share_z = ca.SX.sym("sz", m), ca.SX.sym("s"), ca.SX.sym("z")
        alive = max(1, int(np.sum(ocp.c_min < ocp.c_max)))
        mean = ca.sum1(sz) / (ocp.stages * self._j * alive)
        done = ca.logic_and(mean < interior_point.MU_END, ca.fmin(share_s, share_z) > 0.9)
        close = ca.Function(
            "close", [sz, share_s, share_z], [mean * interior_point.centring(share_s, share_z), ca.logic_not(done)]
        )
        return Kernel(
            close,
            [Operand(self._at["sz"], 0, range(m)), self._one("share_s"), self._one("share_z")],
            [self._one("mu"), self._one("open")],
        )

    def _codes(self) -> Kernel:
        def make(at: interior_point.BoundPair, s: ca.SX, z: ca.SX, dead: ca.SX) -> dict[str, ca.SX]:
            del at
            return {"active": ca.if_else(dead, 1, interior_point.active_code(s, z))}

        return self._kernel("codes", ("s", "z", "dead"), make)

    def _still_open(self) -> Kernel:
        """`changed` = 1 where the last step left the program unsolved, else 0."""
        a = ca.SX.sym("a")
        return Kernel(ca.Function("judge", [a], [a]), [self._one("open")], [self._one("changed")])
