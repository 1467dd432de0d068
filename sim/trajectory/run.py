"""Two ways through the same step: a machine-code loop, or CasADi's interpreter sample by sample."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import casadi as ca
import msgspec
import numpy as np

from companion.code_store import CodeStore
from companion.core.compiled import NotCompiled, Scan
from companion.core.vessel_file import VesselFile
from sim.trajectory.arguments import Task
from sim.trajectory.step import Kind, step_function


class Here(CodeStore):
    """Code is kept as ever, but made in this process: a desk has the memory, and no time for another one to start."""

    def made(self, text: str) -> bytes | None:
        """None: to be made here."""
        return None


class Interpreted:
    """As `Scan`, by CasADi's interpreter: about 10 us a sample and trajectory."""

    def __init__(self, function: ca.Function):
        self._function = function

    def __call__(
        self, carry: np.ndarray, constants: np.ndarray, series: Sequence[np.ndarray], rows: np.ndarray
    ) -> None:
        """Run all m trajectories; `carry` (m, c) and `rows` (m, count, r) are overwritten."""
        m, count, _ = rows.shape
        function = self._function.map(m) if m > 1 else self._function
        buffer, call = function.buffer()
        held: Any = buffer
        full = [np.broadcast_to(s, (m, *s.shape[1:])) for s in series]
        now = [np.array(s[:, 0], order="C") for s in full]
        after, row = np.empty_like(carry), np.empty((m, rows.shape[2]))
        for i, array in enumerate([carry, np.ascontiguousarray(constants), *now]):
            held.set_arg(i, _view(array))
        held.set_res(0, _view(after))
        held.set_res(1, _view(row))
        for k in range(count):
            for target, values in zip(now, full, strict=True):
                target[:] = values[:, k]
            call()
            carry[:] = after
            rows[:, k] = row


def _view(array: Any) -> memoryview:
    return memoryview(array)


def way(vessel: VesselFile, kind: Kind, machine_code: bool) -> tuple[Scan | Interpreted, str]:
    """What runs trajectories of this kind, and why it is not machine code (empty where it is). Made once."""
    return _way(msgspec.msgpack.encode(vessel), kind, machine_code)


@lru_cache(maxsize=64)
def _way(packed: bytes, kind: Kind, machine_code: bool) -> tuple[Scan | Interpreted, str]:
    function = step_function(msgspec.msgpack.decode(packed, type=VesselFile), kind)
    why = "not asked for"
    if machine_code:
        try:
            return Scan(function, Here.of()), ""
        except NotCompiled as reason:
            why = str(reason)
    return Interpreted(function), why


def states(vessel: VesselFile, work: Task, machine_code: bool) -> tuple[np.ndarray, str]:
    """x at the start and after every sample, (m, k + 1, 6 + n), and why by the interpreter."""
    run, why = way(vessel, work.kind, machine_code)
    m, width = work.start.shape
    x = np.empty((m, work.samples + 1, width))
    x[:, 0] = work.start
    run(work.start.copy(), work.constants, work.series, x[:, 1:])
    return x, why
