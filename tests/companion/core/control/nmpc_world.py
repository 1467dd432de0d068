"""A little world for NMPC tests: vessels, requests, straight references, a closed loop with the truth known."""

import time
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.core.control.nmpc import Actuation, Nmpc, NmpcSettings, WarmStart
from companion.core.guidance.reference_row import Column
from companion.core.messages import PlanResult, SolveRequest
from companion.core.model.integrate import BufferedStep, step_function
from companion.core.model.load_vessel import load_vessel
from companion.core.model.manoeuvring import StructuredModel
from companion.jit import compile_loops

ROOT = Path(__file__).resolve().parents[4]
TICK_S = 0.1


@lru_cache
def variant(thrusters: int) -> VesselFile:
    """Aritra with 2 (parallel, underactuated) or up to 6 thrusters (the four, and two athwartships)."""
    text = (ROOT / "deploy/boats/aritra.toml").read_text()
    head, *rest = text.split("[[thrusters]]")
    *blocks, last = rest
    last, tail = last.split("[sensors.imu]")
    blocks.append(last)
    if thrusters == 2:
        chosen = [b.replace("_deg = 45.0", "_deg = 0.0").replace("_deg = -45.0", "_deg = 0.0") for b in blocks[2:]]
    elif thrusters == 4:
        chosen = blocks
    else:
        across = [
            b.replace('"rear_', f'"across_{i}_').replace("channel = 1", f"channel = {i + 4}" + "#").replace(
                "_deg = 45.0", "_deg = 90.0"
            ).replace("_deg = -45.0", "_deg = 90.0")
            for i, b in enumerate(blocks[2:])
        ]  # fmt: skip
        chosen = [*blocks, *across][:thrusters]
    return load_vessel("[[thrusters]]".join([head, *chosen]) + "[sensors.imu]" + tail, name=f"{thrusters} thrusters")


@lru_cache
def controller(thrusters: int = 4, settings: NmpcSettings | None = None) -> Nmpc:
    """The production NMPC; shared by the tests of a session, as it keeps nothing between solves."""
    return controller_of(variant(thrusters), settings or NmpcSettings())


def controller_of(vessel: VesselFile, settings: NmpcSettings) -> Nmpc:
    """The same of any boat."""
    model, actuation = StructuredModel.of(vessel), Actuation.of(vessel)
    return Nmpc(model, actuation, settings, time.perf_counter, compiler=compile_loops)


def request(x0, rows, *, d=(0.0, 0.0, 0.0), f_prev=None, tick: int = 0) -> SolveRequest:
    return SolveRequest(
        t_ns=round(tick * TICK_S * 1e9),
        index=tick,
        x0=tuple(map(float, x0)),
        reference=tuple(tuple(map(float, row)) for row in rows),
        disturbance_n=tuple(map(float, d)),
        f_prev_n=tuple(map(float, np.zeros(len(x0) - 6) if f_prev is None else f_prev)),
    )


def leg_rows(x, settings: NmpcSettings, *, angle=0.0, u=0.5, start=(0.0, 0.0)) -> np.ndarray:
    """Reference along the straight line through `start`, from the foot of the boat onwards."""
    ahead, side = np.cos(angle), np.sin(angle)
    foot = ahead * (x[0] - start[0]) + side * (x[1] - start[1])
    s = foot + u * settings.step_s * np.arange(settings.stages + 1)
    rows = np.zeros((settings.stages + 1, len(Column)))
    rows[:, Column.NORTH], rows[:, Column.EAST] = start[0] + s * ahead, start[1] + s * side
    rows[:, Column.PATH_ANGLE] = rows[:, Column.PSI] = angle
    rows[:, Column.U] = u
    return rows


def station_rows(settings: NmpcSettings, north=0.0, east=0.0, psi=0.0) -> np.ndarray:
    rows = np.zeros((settings.stages + 1, len(Column)))
    rows[:] = (north, east, psi, psi, 0.0, 0.0, 0.0, 1.0)
    return rows


class Loop:
    """Closed loop at 10 Hz with state and disturbance known, without dead time: what the NMPC plans for."""

    def __init__(self, x0, d=(0.0, 0.0, 0.0), *, thrusters: int = 4, nmpc: Nmpc | None = None, vessel=None):
        vessel = vessel or variant(thrusters)
        self.nmpc = nmpc or controller(thrusters)
        self.x, self.d = np.array(x0, dtype=float), np.array(d, dtype=float)
        self.plant = BufferedStep(step_function(StructuredModel.of(vessel), TICK_S, 4))
        self.f = np.zeros(len(vessel.thrusters))
        self.warm: WarmStart | None = None
        self.results: list[PlanResult] = []
        self.states: list[np.ndarray] = []
        self.commands: list[np.ndarray] = []

    def run(self, seconds: float, rows: Callable[[np.ndarray], np.ndarray]) -> "Loop":
        for _ in range(round(seconds / TICK_S)):
            asked = request(self.x, rows(self.x), d=self.d, f_prev=self.f, tick=len(self.results))
            result, self.warm = self.nmpc.solve(asked, self.warm)
            assert result.status == "ok", (len(self.results), result.reason)
            self.results.append(result)
            self.f = np.array(result.f_n[0])
            self.x = self.plant(self.x, self.f, self.d)
            self.states.append(self.x)
            self.commands.append(self.f)
        return self
