"""CasADi functions on many instants, or along many windows, at once: machine code on vectors of `LANES` lanes.

Where no machine code can be made, CasADi's interpreter does the same, some twenty times slower.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from companion.jit import LANES
from sim.trajectory.loops import loop


class Batch:
    """A CasADi function of column vectors, evaluated at `count` points at once: arrays (count, size) in and out."""

    def __init__(self, function: ca.Function, count: int):
        sizes = [function.size1_in(i) for i in range(function.n_in())]
        inputs = [ca.SX.sym(f"given_{i}", size) for i, size in enumerate(sizes)]
        outputs = [ca.densify(ca.vec(out)) for out in function.call(inputs)]
        empty = [ca.SX.sym(name, 0) for name in ("carry", "constants")]
        each = ca.Function("each", [*empty, *inputs], [ca.SX(0, 1), ca.vertcat(*outputs)])
        self._run, interpreted = loop(each.serialize(), LANES)
        self._count, lanes = count, count if interpreted else LANES
        steps = -(-count // lanes)
        self._in = [np.zeros((lanes, steps, size)) for size in sizes]
        self._empty = np.empty((lanes, 0))
        self._rows = np.empty((lanes, steps, sum(o.numel() for o in outputs)))
        ends = np.cumsum([o.numel() for o in outputs])
        self._parts = [slice(int(end) - o.numel(), int(end)) for end, o in zip(ends, outputs, strict=True)]

    def __call__(self, *args: np.ndarray) -> list[np.ndarray]:
        """Outputs at the points `args`, each (count, size). They are views that the next call overwrites."""
        for target, value in zip(self._in, args, strict=True):
            target.reshape(-1, target.shape[2])[: self._count] = value
        self._run(self._empty, self._empty, self._in, self._rows)
        rows = self._rows.reshape(-1, self._rows.shape[2])[: self._count]
        return [rows[:, part] for part in self._parts]


class Rollout:
    """x_{k+1} = step(x_k, constants, series_k ..) along many windows at once."""

    def __init__(self, step: ca.Function):
        args = [ca.SX.sym(f"arg_{i}", step.size1_in(i)) for i in range(step.n_in())]
        after = ca.densify(step(*args))
        self._run, _ = loop(ca.Function("along", args, [after, after]).serialize(), LANES)

    def __call__(self, x: np.ndarray, constants: np.ndarray, *series: np.ndarray) -> np.ndarray:
        """x (W, K, n) after each step, from x (W, n) before the first; constants (W or 1, q), series (W, K, .) each."""
        W, K = series[0].shape[:2]
        rows = np.empty((W, K, x.shape[1]))
        whole = np.ascontiguousarray(np.broadcast_to(constants, (W, constants.shape[1])))
        self._run(np.array(x), whole, [np.ascontiguousarray(s) for s in series], rows)
        return rows
