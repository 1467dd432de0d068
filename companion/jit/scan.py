"""A recurrence over whole series as one machine-code loop, for several lanes (boats, trajectories) at once.

    (carry_k+1, row_k) = function(carry_k, constants, series_k ..)          k = 0 .. count - 1

The carry stays in registers, expressions of constants alone are computed once, nothing is allocated. Series and rows
are arrays of the caller (lanes, count, width), used in place; stride 0 along an axis: the same values for all indices.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np

from companion.jit.cache import CodeStore
from companion.jit.emit import Value, translate
from companion.jit.lanes import Lanes
from companion.jit.machine import Code

LANES, ALONE = 8, 2
"""Lanes of one pass for many trajectories, and for one: two were measured faster than one (whose selections become
branches) and than four. Processors with shorter vectors split them.
"""


def compile_scan(function: ca.Function, store: CodeStore | None = None, *, first: int = ALONE) -> Scan:
    """The loop of `function`: carry (c,), constants (q,), any number of series -> carry, row. All dense.

    `store` keeps the code between runs. `first`: lanes of the code that is compiled now, ALONE or LANES; the other is
    compiled at first use. Raises NotCompiled.
    """
    return Scan(function, store, first)


class Scan:
    """A compiled loop. A trajectory is the same bit for bit, alone or with others."""

    def __init__(self, function: ca.Function, store: CodeStore | None, first: int):
        self._function, self._store = function, store
        self._made = {first: self._compiled(first)}

    def __call__(
        self, carry: np.ndarray, constants: np.ndarray, series: Sequence[np.ndarray], rows: np.ndarray
    ) -> None:
        """Run all m trajectories; `carry` (m, c) and `rows` (m, count, r) are overwritten.

        `constants` (m, q); each of `series` (m or 1, count or 1, width), 1: broadcast. All doubles, last axis
        contiguous; no other thread may write them until this returns.
        """
        m, count, _ = rows.shape
        width = ALONE if m <= ALONE else LANES
        if width not in self._made:
            self._made[width] = self._compiled(width)
        _, run = self._made[width]
        arguments: list[int] = []
        for array in (*series, rows):
            lane, step, _ = (0 if size == 1 else far // 8 for size, far in zip(array.shape, array.strides, strict=True))
            arguments += [array.ctypes.data, step, lane]
        wide_carry, wide_constants = (np.empty((a.shape[1], width)) for a in (carry, constants))
        for first in range(0, m if count else 0, width):
            lanes = np.minimum(np.arange(first, first + width, dtype=np.int64), m - 1)
            wide_carry[:], wide_constants[:] = carry[lanes].T, constants[lanes].T
            run(*(a.ctypes.data for a in (lanes, wide_carry, wide_constants)), *arguments, count)
            carry[lanes] = wide_carry.T

    def _compiled(self, width: int) -> tuple[Code, Callable[..., None]]:
        """The code, which must be kept alive, and its function."""
        code = Code(_text(self._function, width), self._store)
        arrays = [ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64] * (self._function.n_in() - 1)
        kind = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 3, *arrays, ctypes.c_int64)
        return code, kind(code.address("scan"))


def _text(function: ca.Function, width: int) -> str:
    """`void scan(lanes, carry, constants, (base, step, lane) of each series and of the rows, count)`, count > 0."""
    names = [*(f"s{j}" for j in range(function.n_in() - 2)), "out"]
    body = Lanes(width, {f"%constant{i}" for i in range(function.nnz_in(1))})
    wide = body.type_of(True)
    following: dict[int, Value] = {}
    rows: dict[int, Value] = {}

    def place(name: str, nonzero: int) -> Callable[[int], str]:
        return lambda i: body.add(f"getelementptr double, ptr %at_{name}_{i}, i64 {nonzero}")

    def load(index: int, nonzero: int) -> Value:
        if index < 2:
            return f"%{('carry', 'constant')[index]}{nonzero}", True
        return body.gathered(place(names[index - 2], nonzero))

    translate(function, body, load, lambda i, nonzero, value: (following, rows)[i].__setitem__(nonzero, value))
    last = [body.spread(following[i]) for i in range(len(following))]
    for nonzero, value in rows.items():
        body.scatter(value, place("out", nonzero))
    arguments = "".join(f", ptr noalias %{n}, i64 %{n}_step, i64 %{n}_lane" for n in names)
    return "\n".join([
        *sorted(body.intrinsics),
        f"define void @scan(ptr noalias %lanes, ptr noalias %carry, ptr noalias %constants{arguments}, i64 %count) {{",
        "entry:", *_begin(names, wide, width, len(last), function.nnz_in(1)), "  br label %loop",
        "loop:", "  %k = phi i64 [ 0, %entry ], [ %next, %loop ]",
        *(f"  %carry{i} = phi {wide} [ %first{i}, %entry ], [ {value}, %loop ]" for i, value in enumerate(last)),
        *_places(names, width), *body.lines,
        "  %next = add i64 %k, 1", "  %more = icmp slt i64 %next, %count", "  br i1 %more, label %loop, label %done",
        "done:", *(f"  store {wide} {value}, ptr %first{i}_at, align 8" for i, value in enumerate(last)),
        "  ret void", "}", "",
    ])  # fmt: skip


def _begin(names: Sequence[str], wide: str, width: int, carried: int, constants: int) -> list[str]:
    """Before the loop: first carry, constants, begin of the arrays of each lane."""
    lines = []
    for name, source, count in (("first", "carry", carried), ("constant", "constants", constants)):
        for i in range(count):
            lines += [
                f"  %{name}{i}_at = getelementptr double, ptr %{source}, i64 {i * width}",
                f"  %{name}{i} = load {wide}, ptr %{name}{i}_at, align 8",
            ]
    for i in range(width):
        lines += [f"  %lane_at{i} = getelementptr i64, ptr %lanes, i64 {i}"]
        lines += [f"  %lane{i} = load i64, ptr %lane_at{i}, align 8"]
        for n in names:
            lines += [f"  %far_{n}_{i} = mul i64 %lane{i}, %{n}_lane"]
            lines += [f"  %{n}_{i} = getelementptr double, ptr %{n}, i64 %far_{n}_{i}"]
    return lines


def _places(names: Sequence[str], width: int) -> list[str]:
    """In the loop: address of row k of each series, for each lane."""
    lines = []
    for n in names:
        lines += [f"  %by_{n} = mul i64 %k, %{n}_step"]
        lines += [f"  %at_{n}_{i} = getelementptr double, ptr %{n}_{i}, i64 %by_{n}" for i in range(width)]
    return lines
