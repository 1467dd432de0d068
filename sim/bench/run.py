"""Every part that was asked for, one after the other, as one result."""

from __future__ import annotations

import time
from collections.abc import Callable
from datetime import UTC, datetime

from sim.bench.controller.compare import cadence, solvers
from sim.bench.controller.starting import start
from sim.bench.fitting import fit
from sim.bench.growth import measure
from sim.bench.machine import load, machine
from sim.bench.request import BenchRequest, Found
from sim.bench.result import SCHEMA, Bench, BenchRow, BenchSettings, Growth, SolverRefused
from sim.bench.simulation import simulation

PARTS: dict[str, Callable[[BenchRequest], Found]] = {
    "solvers": solvers,
    "cadence": cadence,
    "simulation": simulation,
    "fit": fit,
    "start": start,
}
GROWTH: dict[str, Callable[[BenchRequest], Found]] = {
    "horizon": measure.horizon,
    "thrusters": measure.thrusters,
    "logs": measure.logs,
}


def chosen(only: str, with_growth: bool) -> dict[str, Callable[[BenchRequest], Found]]:
    """Parts whose name holds `only`; those of growth where they are asked for, by themselves or by `growth`."""
    parts = {} if with_growth else dict(PARTS)
    grows = {f"growth-{name}": part for name, part in GROWTH.items()}
    if with_growth or "growth" in only:
        parts |= grows
    return {name: part for name, part in parts.items() if only in name}


def run(order: BenchRequest, only: str, with_growth: bool, program: dict[str, str]) -> Bench:
    """Measure."""
    began, before = time.monotonic(), load()
    begun_utc = datetime.now(UTC).isoformat(timespec="seconds")
    found: list[BenchRow | SolverRefused | Growth] = []
    for name, part in chosen(only, with_growth).items():
        try:
            for one in part(order):
                found.append(one)  # noqa: PERF402 - what came before an error is kept
        except Exception as error:  # whatever breaks down in one part, the figures of the others are not lost
            found.append(SolverRefused(part=name, problem="", name=name, why=f"{type(error).__name__}: {error}"))
    settings = BenchSettings(
        vessel=order.vessel.name, problems=order.problems, solves=order.solves, rounds=order.rounds,
        cadence_solves=order.cadence_solves, seed=order.seed, only=only, growth=with_growth,
    )  # fmt: skip
    return Bench(
        schema=SCHEMA, program=program, begun_utc=begun_utc, seconds=time.monotonic() - began,
        machine=machine(before), settings=settings,
        rows=tuple(one for one in found if isinstance(one, BenchRow)),
        refused=tuple(one for one in found if isinstance(one, SolverRefused)),
        growth=tuple(one for one in found if isinstance(one, Growth)),
    )  # fmt: skip
