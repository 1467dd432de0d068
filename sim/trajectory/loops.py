"""Loops of a CasADi function over whole series: machine code, or where none can be made CasADi's interpreter."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from companion.jit import ALONE, CodeStore, NotCompiled, Scan, compile_scan


class Here(CodeStore):
    """Code is kept as ever, but made in this process: a desk has the memory, and no time for another one to start."""

    def made(self, text: str) -> bytes | None:
        """None: to be made here."""
        return None


class Interpreted:
    """As `Scan`, by CasADi's interpreter: about 10 us a sample and trajectory."""

    def __init__(self, function: ca.Function):
        self._mapped = {1: function}

    def __call__(
        self, carry: np.ndarray, constants: np.ndarray, series: Sequence[np.ndarray], rows: np.ndarray
    ) -> None:
        """Run all m trajectories; `carry` (m, c) and `rows` (m, count, r) are overwritten."""
        m, count, _ = rows.shape
        if m not in self._mapped:
            self._mapped[m] = self._mapped[1].map(m)
        buffer, call = self._mapped[m].buffer()
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


@lru_cache(maxsize=64)
def loop(serialized: str, first: int = ALONE) -> tuple[Scan | Interpreted, str]:
    """What runs a serialized function as `Scan` does, and why it is not machine code (empty where it is).

    Made once. `first`: lanes of the code that is made at once, see `compile_scan`.
    """
    function = ca.Function.deserialize(serialized)
    try:
        return compile_scan(function, Here.of(), first=first), ""
    except NotCompiled as reason:
        return Interpreted(function), str(reason)
