"""A recurrence over series, as `Scan` runs it, in Python for numba and in C: one trajectory after the other."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence

import casadi as ca
import numpy as np

from sim.studies.machine_code.build import numba_module, shared_library
from sim.studies.machine_code.program import JIT
from sim.studies.machine_code.source import C_HEAD, PYTHON, PYTHON_HEAD, C, Language, walk


def text(to: Language, function: ca.Function) -> str:
    """`scan(carry, constants, series .., rows)` for numba; with addresses, distances and counts for C."""
    python, n_series, size = to is PYTHON, function.n_in() - 2, function.nnz_in(0)
    names = [f"s{j}" for j in range(n_series)]

    def load(index: int, nonzero: int) -> tuple[str, bool]:
        if index == 0:
            return f"c{nonzero}", True
        if index == 1:
            return (f"constants[i, {nonzero}]" if python else f"constants[i * {function.nnz_in(1)} + {nonzero}]"), False
        name = names[index - 2]
        return (
            f"{name}[i, k, {nonzero}]" if python else f"{name}[i * {name}_lane + k * {name}_step + {nonzero}]"
        ), True

    outer, inner, out = walk(to, function, load)
    rows = [f"rows[i, k, {n}]" if python else f"rows[i * rows_lane + k * rows_step + {n}]"
            for n in range(function.nnz_out(1))]  # fmt: skip
    end, carry = (
        ("" if python else ";"),
        [f"carry[i, {j}]" if python else f"carry[i * {size} + {j}]" for j in range(size)],
    )
    inner += [f"{rows[n]} = {value}{end}" for (i, n), value in out.items() if i == 1]
    inner += [f"c{n} = {value}{end}" for (i, n), value in out.items() if i == 0]
    begin = [f"{'' if python else 'double '}c{j} = {carry[j]}{end}" for j in range(size)]
    lines = [*("    " * 2 + line for line in (*begin, *outer)), "    " * 2 + to.loop.format(i="k", n="count"),
             *("    " * 3 + line for line in inner), "    " * 2 + to.end,
             *(f"        {carry[j]} = c{j}{end}" for j in range(size))]  # fmt: skip
    if python:
        given = ", ".join(["carry", "constants", *names, "rows"])
        head = f"{JIT}def scan({given}):\n    count = rows.shape[1]\n    for i in range(rows.shape[0]):\n"
        return PYTHON_HEAD + head + "\n".join(lines) + "\n"
    arrays = ", ".join(f"double *restrict {n}, long {n}_lane, long {n}_step" for n in (*names, "rows"))
    head = (
        f"void scan(double *restrict carry, const double *restrict constants, {arrays}, long trajectories, long count)"
    )
    return C_HEAD + head + " {\n    for (long i = 0; i < trajectories; i++) {\n" + "\n".join(lines) + "\n    }\n}\n"


class NumbaScan:
    """As `Scan`."""

    def __init__(self, function: ca.Function):
        self._run = numba_module(text(PYTHON, function)).scan

    def __call__(
        self, carry: np.ndarray, constants: np.ndarray, series: Sequence[np.ndarray], rows: np.ndarray
    ) -> None:
        """As `Scan`."""
        m, count, _ = rows.shape
        wide = [np.broadcast_to(s, (m, count, s.shape[2])) for s in series]
        self._run(carry, np.ascontiguousarray(constants), *wide, rows)


class CScan:
    """As `Scan`."""

    def __init__(self, function: ca.Function):
        self._run = ctypes.CDLL(str(shared_library(text(C, function)))).scan

    def __call__(
        self, carry: np.ndarray, constants: np.ndarray, series: Sequence[np.ndarray], rows: np.ndarray
    ) -> None:
        """As `Scan`."""
        constants, given = np.ascontiguousarray(constants), []
        for array in (*series, rows):
            far = [0 if size == 1 else by // 8 for size, by in zip(array.shape, array.strides, strict=True)]
            given += [ctypes.c_void_p(array.ctypes.data), ctypes.c_long(far[0]), ctypes.c_long(far[1])]
        of = [ctypes.c_void_p(a.ctypes.data) for a in (carry, constants)]
        self._run(*of, *given, ctypes.c_long(rows.shape[0]), ctypes.c_long(rows.shape[1]))
