"""What the solvers are held against: the production problem and the paper's, each with boats that drive.

A drive is one seed: 60 s at 10 Hz, state and disturbance known, without dead time. The plant is the controller's own
model (Runge-Kutta at 25 ms), pushed by noise that the controller does not know.

    production   8 waypoints at random, 3 to 6 m apart, course guidance as on the boat, constant disturbance
    paper        the model of the paper's Table 2, a heading step of up to 0.5 rad every 10 s
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import casadi as ca
import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.core.control.nmpc.production import production
from companion.core.control.nmpc.settings import Actuation, NmpcSettings
from companion.core.control.ocp import Ocp
from companion.core.guidance import guidance
from companion.core.guidance.guidance import GuidanceSettings
from companion.core.guidance.path import Path, Waypoint
from companion.core.guidance.reference_row import Column, near
from companion.core.model.integrate import BufferedStep, step_function
from companion.core.model.manoeuvring import StructuredModel
from companion.core.model.thrusters import configuration_matrix
from sim.bench.controller.paper_problem import paper_ocp
from sim.fitting.taylor.abkowitz import AbkowitzModel

TICK_S = 0.1
STEPS = 600
PUSH_N = np.array([0.5, 0.5, 0.1])
"""One sigma of the unknown push [N, N, N m], white at 10 Hz: assumed."""


class Drive(Protocol):
    """One seed. `x` is the state now."""

    x: np.ndarray

    def ask(self, tick: int) -> tuple[np.ndarray, np.ndarray]:
        """Parameters p (N + 1, .) and q of the problem at this tick."""
        ...

    def go(self, c: np.ndarray) -> None:
        """One tick with controls `c`."""
        ...


@dataclass(frozen=True)
class BenchWorld:
    """A problem with its drives. `stage_cost`: (x, c, p, q) -> what the stage costs."""

    name: str
    ocp: Ocp
    stage_cost: ca.Function
    make: Any

    def drive(self, seed: int) -> Drive:
        """A fresh drive."""
        return self.make(seed)


def stage_cost(ocp: Ocp) -> ca.Function:
    """(x, c, p, q) -> |residual|^2."""
    return ca.Function("stage_cost", [ocp.x, ocp.c, ocp.p, ocp.q], [ca.sumsqr(ocp.residual)])


def production_world(vessel: VesselFile, settings: NmpcSettings | None = None) -> BenchWorld:
    """The production problem of one vessel."""
    settings = settings or NmpcSettings()
    model = StructuredModel.of(vessel)
    ocp = production(model, Actuation.of(vessel), settings)
    plant = BufferedStep(step_function(model, TICK_S, 4))
    return BenchWorld("production", ocp, stage_cost(ocp), lambda seed: _Mission(ocp, settings, plant, seed))


def paper_world(vessel: VesselFile) -> BenchWorld:
    """The paper's problem with the thrusters of one vessel."""
    model = AbkowitzModel(configuration_matrix(vessel), vessel.propulsion.lag_s)
    ocp = paper_ocp(model)
    x = ocp.following
    plant = BufferedStep(ca.Function("plant", [ocp.x, ocp.c, ocp.q], [x]))
    return BenchWorld("paper", ocp, stage_cost(ocp), lambda seed: _Headings(ocp, plant, seed))


class _Mission:
    def __init__(self, ocp: Ocp, settings: NmpcSettings, plant: BufferedStep, seed: int):
        self._ocp, self._settings, self._plant = ocp, settings, plant
        self._rng = rng = np.random.default_rng(seed)
        turns, lengths = np.cumsum(rng.uniform(-1.6, 1.6, 8)), rng.uniform(3.0, 6.0, 8)
        points = np.cumsum(lengths[:, None] * np.stack([np.cos(turns), np.sin(turns)], axis=1), axis=0)
        self._q = rng.normal(size=3) * (1.0, 1.0, 0.2)
        self.x = np.r_[rng.normal(size=2) * 0.3, turns[0] + rng.normal() * 0.5, 0.2, 0.0, 0.0, np.zeros(ocp.nu)]
        self._guidance = GuidanceSettings()
        path = Path(tuple(Waypoint(float(n), float(e)) for n, e in points))
        self._state = guidance.start(path, self._guidance, self.x[:3].tolist(), self.x[3:6].tolist(), 0)
        self._times = [k * settings.step_s for k in range(settings.stages + 1)]

    def ask(self, tick: int) -> tuple[np.ndarray, np.ndarray]:
        eta, nu = self.x[:3].tolist(), self.x[3:6].tolist()
        self._state, _ = guidance.step(self._state, self._guidance, eta, nu, round(tick * TICK_S * 1e9))
        rows = guidance.horizon(self._state, self._guidance, eta, nu, self._times)
        rows[:, Column.PSI] = near(rows[:, Column.PSI], self.x[2])
        return rows, self._q

    def go(self, c: np.ndarray) -> None:
        self.x = self._plant(self.x, c, self._q + self._rng.normal(size=3) * PUSH_N)


class _Headings:
    def __init__(self, ocp: Ocp, plant: BufferedStep, seed: int):
        self._ocp, self._plant = ocp, plant
        self._rng = rng = np.random.default_rng(seed)
        self._wanted = np.cumsum(rng.uniform(-0.5, 0.5, STEPS // 100 + 1))
        self.x = np.array([0.0, 0.5, 0.0, 0.0])

    def ask(self, tick: int) -> tuple[np.ndarray, np.ndarray]:
        return np.full((self._ocp.stages + 1, 1), self._wanted[tick // 100]), np.zeros(0)

    def go(self, c: np.ndarray) -> None:
        self.x = self._plant(self.x, c, np.zeros(0)) + self._rng.normal(size=4) * (0.005, 0.005, 0.002, 0.005)
