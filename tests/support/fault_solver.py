"""A solver of the boat that fails on request."""

from __future__ import annotations

import threading
from dataclasses import replace
from functools import cache

from companion.boat.load_run import EXAMPLES
from companion.core.excitation.file import load_excitation
from companion.core.messages import PlanResult
from companion.core.pilot.pilot import Pilot
from tests.support.drive_fixture import setup


@cache
def mind() -> Pilot:
    """The example boat, with an excitation to fly and limits of the battery."""
    told = setup().pilot
    library = load_excitation((EXAMPLES / "excitations" / "library.toml").read_text(), name="library.toml")
    assert told.battery.critical_V, "the example has a critical voltage"
    return Pilot(replace(told, excitation=library))


class Brain:
    """A solver that waits for `let_go` at every request. `real`: what solves; None: forces to and fro.

    The forces keep the thrusters turning and the boat about where it is: motion that is not due is seen at once.
    """

    def __init__(self, real=None):
        self.fault, self.waiting, self.open = "", False, False
        self._real, self._gate = real, threading.Event()

    def solve(self, request, warm):
        self.waiting = not self.open
        if self.waiting:
            self._gate.wait()
            self._gate.clear()
        if self.fault == "raises":
            raise FloatingPointError("no numbers today")
        if self._real:
            plan, warm = self._real.solve(request, warm)
        else:
            push = 4.0 if request.index // 5 % 2 else -4.0
            rows = ((push, -push, push, -push),) * 20
            plan = PlanResult(t_ns=request.t_ns, index=request.index, status="ok", reason="", solve_time_s=0.0,
                              iterations=1, cost=0.0, f_n=rows, x=(request.x0,) * 21)  # fmt: skip
        return self._spoilt(plan), warm

    def let_go(self):
        self.waiting = False
        self._gate.set()

    def _spoilt(self, plan):
        if self.fault == "failed":
            return _changed(plan, status="failed", reason="for the test", f_n=(), x=())
        if self.fault == "empty":
            return _changed(plan, f_n=())
        value = {"nan": float("nan"), "huge": 1e9}.get(self.fault)
        return plan if value is None else _changed(plan, f_n=tuple((value,) * len(row) for row in plan.f_n))


def _changed(plan, **fields):
    return type(plan)(**({name: getattr(plan, name) for name in plan.__struct_fields__} | fields))
