"""Real-time iterations of the example boat, and states to solve them from."""

from functools import cache

import numpy as np
import pytest

from companion.core.control.nmpc import Actuation, NmpcSettings
from companion.core.control.nmpc.production import production
from companion.core.control.rti.iteration import Rti
from companion.core.control.rti.loops import Compiler
from companion.core.guidance.reference_row import Column, near
from companion.core.model.manoeuvring import StructuredModel
from companion.jit import compile_loops, machine
from tests.companion.core.control.nmpc_world import leg_rows, variant

S = NmpcSettings()
WAYS = [
    pytest.param(compile_loops, id="compiled", marks=pytest.mark.skipif(
        not machine.may_run_what_was_written(), reason="the system forbids machine code")),
    pytest.param(None, id="interpreted"),
]  # fmt: skip


@cache
def boat(compiler: Compiler | None, thrusters: int = 4) -> Rti:
    vessel = variant(thrusters)
    return Rti(production(StructuredModel.of(vessel), Actuation.of(vessel), S), compiler=compiler)


def near_the_leg(rng, rti: Rti):
    """Anywhere a boat may be on its way along a leg; guess: standing still."""
    x0 = np.r_[rng.normal(size=2), rng.normal() * 0.6, 0.4 + rng.normal() * 0.2, rng.normal(size=2) * 0.1,
               rng.uniform(-10, 10, 4)]  # fmt: skip
    rows = leg_rows(x0, S, angle=rng.normal() * 0.3)
    rows[:, Column.PSI] = near(rows[:, Column.PSI], x0[2])
    d = rng.normal(size=3) * (1.0, 1.0, 0.2)
    rti.X[:], rti.C[:], rti.active[:], rti.shift[0] = x0, x0[6:], 0.0, 0.0
    rti.x0[:], rti.p[:], rti.q[:] = x0, rows, d
    return x0, rows, d


def anywhere(rng, rti: Rti):
    """States, references and disturbances without any sense, forces within their limits."""
    ocp = rti.ocp
    x0 = np.r_[rng.uniform(-20, 20, 2), rng.uniform(-7, 7), rng.uniform(-1, 1, 3) * (1.5, 0.7, 1.5),
               rng.uniform(ocp.c_min, ocp.c_max)]  # fmt: skip
    rows = leg_rows(x0, S, angle=rng.uniform(-4, 4), start=x0[:2] + rng.normal(size=2) * 3, u=rng.uniform(0, 1))
    rows[:, Column.PSI], rows[:, Column.STATION] = near(rows[:, Column.PSI], x0[2]), rng.integers(2)
    rti.X[:], rti.C[:], rti.active[:] = x0, x0[6:], rng.integers(-2, 3, size=rti.C.shape)
    rti.x0[:], rti.p[:], rti.q[:] = x0, rows, rng.normal(size=3) * (3.0, 3.0, 0.5)
