"""Memory layout of the compiled real-time iteration: all arrays in one block, and operands of kernels in it.

Each array begins on a cache line. A matrix of a stage has rows of `wide` doubles, columns [x c 1] and padding, so that
one vector operation takes a row; kernels that linearise have stages as lanes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from companion.core.control.rti.loops import Operand
from companion.core.control.rti.stage_functions import Pattern, StageFunctions

LANES = 8
"""Stages that are linearised at once (processors with shorter vectors split them); also doubles of a cache line."""


class Memory:
    """`doubles`: the block; `view`: arrays; `base`, `shape`: first double and shape; `wide`: doubles of a row."""

    def __init__(self, parts: StageFunctions):
        self._ocp = ocp = parts.ocp
        n, m, N = ocp.nx, ocp.nu, ocp.stages
        self.wide = wide = -(-(n + m + 1) // 4) * 4
        self.shape: dict[str, tuple[int, ...]] = {
            "X": (N + 1, n), "C": (N, m), "x0": (n,), "p": (N + 1, ocp.p.numel()), "q": (ocp.q.numel(),),
            "shift": (1,), "active": (N, m), "info": (5,),
            "dx": (N + 1, n), "dc": (N, m),
            "AB": (N, n, wide), "Hg": (N, n + m, wide), "end": (n, wide), "P": (n, wide), "Q": (n + m, wide),
            "law": (3, m), "L": (m, m), "inverse": (m,), "K": (N, m, wide), "W": (N, m, wide),
            "one": (wide,), "force": (m, wide), "gap": (N, n), "cost": (N + 1,),
            "barred": (N, n + m, wide), "dead": (m,), "alive": (m,), "c_min": (m,), "c_max": (m,), "rate": (m,),
            "s": (N, 4, m), "z": (N, 4, m), "mu": (1,), "share_s": (m,), "share_z": (m,), "sz": (m,), "open": (1,),
        }  # fmt: skip
        self.base: dict[str, int] = {}
        size = 0
        for name, shape in self.shape.items():
            self.base[name] = size
            size += -(-(int(np.prod(shape)) + LANES) // LANES) * LANES
        block = np.zeros(size + LANES)
        begin = -(block.__array_interface__["data"][0] // block.itemsize) % LANES
        self.doubles = block[begin : begin + size]
        self.view = {name: self._array(name) for name in self.shape}
        self.base |= {"sums": self.base["info"], "changed": self.base["info"] + 4}
        self.shape |= {"sums": (4,), "changed": (1,)}
        v = self.view
        v["AB"][:, :, : n + m] = parts.D.rest
        v["Hg"][:, :, : n + m] = parts.H.rest
        v["end"][:, :n] = parts.H_end.rest
        v["one"][n + m] = 1.0
        if ocp.forces is not None:
            v["force"][np.arange(m), ocp.forces + np.arange(m)] = 1.0
        v["c_min"][:], v["c_max"][:], v["rate"][:] = ocp.c_min, ocp.c_max, ocp.rate_n
        v["dead"][:] = ocp.c_min >= ocp.c_max
        v["alive"][:] = 1.0 - v["dead"]

    def _array(self, name: str) -> np.ndarray:
        base, shape = self.base[name], self.shape[name]
        return self.doubles[base : base + int(np.prod(shape))].reshape(shape)

    def _step(self, name: str) -> int:
        """Doubles from stage to stage."""
        return int(np.prod(self.shape[name][1:]))

    def one(self, name: str) -> Operand:
        """The whole array, the same at every stage."""
        return Operand(self.base[name], 0, range(int(np.prod(self.shape[name]))))

    def staged(self, name: str, *, ahead: int = 0, lanes: bool = False) -> Operand:
        """Row k (+ ahead) of an array by stage."""
        step = self._step(name)
        return Operand(self.base[name] + ahead * step, step, range(step), step if lanes else None)

    def entries(self, name: str, pattern: Pattern, *, lanes: bool = False, staged: bool = True) -> Operand:
        """Varying entries of a matrix by stage."""
        step = self._step(name) if staged else 0
        offsets = (pattern.rows * self.wide + pattern.columns).tolist()
        return Operand(self.base[name], step, offsets, step if lanes else None)

    def column(self, name: str, rows: int, *, lanes: bool = False, staged: bool = True) -> Operand:
        """The last column, that of 1: b, g, p or the constant part of K."""
        step = self._step(name) if staged else 0
        offsets = range(self._ocp.nx + self._ocp.nu, rows * self.wide, self.wide)
        return Operand(self.base[name], step, offsets, step if lanes else None)

    def rows(self, name: str, first: int, count: int, *, staged: bool = False) -> Operand:
        """Rows of a matrix, their columns as lanes."""
        step = self._step(name) if staged else 0
        return Operand(self.base[name], step, range(first * self.wide, (first + count) * self.wide, self.wide), 1)

    def block(self, name: str, rows: Sequence[int], columns: Sequence[int], *, staged: bool = False) -> Operand:
        """A dense block, by columns as CasADi stores."""
        step = self._step(name) if staged else 0
        offsets = [r * self.wide + c for c in columns for r in rows]
        return Operand(self.base[name], step, offsets)

    def by_stage(self) -> list[Operand]:
        """Inputs of a function of each stage: x, c, next x, p and q; stages as lanes."""
        x, c, p = (self.staged(name, lanes=True) for name in ("X", "C", "p"))
        return [x, c, self.staged("X", ahead=1, lanes=True), p, self.one("q")]

    def end(self) -> list[Operand]:
        """Inputs of a function of the last state: x, p and q."""
        return [self.staged("X"), self.staged("p"), self.one("q")]

    def codes(self, name: str) -> Operand:
        """Codes of the active limits of a stage; "dead": of dead controls, the same at all stages."""
        return self.one(name) if name == "dead" else self.staged(name)

    def lane(self, name: str) -> Operand:
        """One row as a lane."""
        return Operand(self.base[name], 0, (0,), 1)
