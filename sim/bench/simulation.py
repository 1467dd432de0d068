"""Simulating the boat: 100 Hz Runge-Kutta, thruster lag included, by the means that a user has."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import casadi as ca
import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.integrate import ETA, FORCES, NU, BufferedStep, rk4, step_function
from companion.core.model.manoeuvring import StructuredModel, mass_matrix
from companion.core.model.thrusters import configuration_matrix
from sim.bench.controller.rounds import interleaved, times_of
from sim.bench.request import BenchRequest, Found
from sim.bench.result import BenchRow, SolverRefused
from sim.trajectory import simulate_forces

STEP_S = 0.01
SIMULATED_S = 60.0
PROBLEM = "100 Hz Runge-Kutta"
WHOLE, OURS = "CasADi mapaccum, whole", "compiled, whole"
BOATS = 64
TOGETHER = f"compiled, {BOATS} boats at once"
COMMAND_N = 6.0
"""Each thruster's command swings by so much, each at a frequency of its own; assumed."""


class NumpyBoat:
    """Fossen's equations in plain numpy, as one writes them first: no optional terms, no wash, no slew limit."""

    def __init__(self, vessel: VesselFile):
        d = vessel.damping
        self.M, self.B, self.lag_s = mass_matrix(vessel), configuration_matrix(vessel), vessel.propulsion.lag_s
        self.inverse = np.linalg.inv(self.M)
        self.linear = -np.array(
            [[d.X_u_N_s_m, 0, 0], [0, d.Y_v_N_s_m, d.Y_r_N_s], [0, d.N_v_N_s, d.N_r_N_m_s]], dtype=float
        )
        self.quadratic = -np.array([d.X_uu_N_s2_m2, d.Y_vv_N_s2_m2, d.N_rr_N_m_s2])

    def rate(self, x: np.ndarray, f_cmd: np.ndarray) -> np.ndarray:
        """dx/dt, shape (6 + n,)."""
        nu, f = x[NU], x[FORCES]
        c, s = np.cos(x[ETA][2]), np.sin(x[ETA][2])
        p = self.M @ nu
        coriolis = np.array([-p[1] * nu[2], p[0] * nu[2], p[1] * nu[0] - p[0] * nu[1]])
        damping = self.linear @ nu + self.quadratic * np.abs(nu) * nu
        eta_dot = np.array([c * nu[0] - s * nu[1], s * nu[0] + c * nu[1], nu[2]])
        return np.concatenate([eta_dot, self.inverse @ (self.B @ f - coriolis - damping), (f_cmd - f) / self.lag_s])

    def run(self, x: np.ndarray, commands: np.ndarray) -> np.ndarray:
        """States (K, 6 + n) after each step."""
        states = np.zeros((len(commands), x.size))
        for k, f_cmd in enumerate(commands):
            x = states[k] = rk4(lambda s: self.rate(s, f_cmd), x, STEP_S)  # noqa: B023 - used at once
        return states


def commands(n: int, steps: int) -> np.ndarray:
    """(K, n) [N]."""
    t = STEP_S * np.arange(steps)[:, None]
    return COMMAND_N * np.sin(2 * np.pi * t * (0.1 + 0.07 * np.arange(n)))


def runners(vessel: VesselFile, steps: int) -> Mapping[str, Callable[[np.ndarray, np.ndarray], np.ndarray]]:
    """(x0, commands (K, n)) -> states (K, 6 + n), by each means; all built beforehand."""
    model = StructuredModel.of(vessel)
    step = step_function(model, STEP_S)
    buffered, nothing = BufferedStep(step), np.zeros(3)
    whole = step.mapaccum("whole", steps)
    still = ca.DM.zeros(3, steps)

    def one_by_one(call: Callable[[np.ndarray, np.ndarray], np.ndarray]):
        def run(x: np.ndarray, given: np.ndarray) -> np.ndarray:
            states = np.zeros((len(given), x.size))
            for k, f_cmd in enumerate(given):
                x = states[k] = call(x, f_cmd)
            return states

        return run

    return {
        "numpy, step by step": NumpyBoat(vessel).run,
        "CasADi call, step by step": one_by_one(lambda x, f: np.array(step(x, f, nothing)).ravel()),
        "CasADi buffer, step by step": one_by_one(lambda x, f: buffered(x, f, nothing)),
        WHOLE: lambda x, given: np.array(whole(x, given.T, still)).T,
    }


def simulation(order: BenchRequest) -> Found:
    """Simulation: seconds of the boat per second of one core"""
    order.progress("simulation: building")
    steps, n = round(SIMULATED_S / STEP_S), len(order.vessel.thrusters)
    x0, given = np.zeros(6 + n), commands(n, steps)
    runs: dict[str, Callable[[], np.ndarray]] = {
        name: partial(run, x0, given) for name, run in runners(order.vessel, steps).items()
    }
    ours = simulate_forces(order.vessel, x0, given[:2], STEP_S)
    if ours.why_interpreted:
        yield SolverRefused(part="simulation", problem=PROBLEM, name=OURS, why=ours.why_interpreted)
    else:
        runs[OURS] = lambda: simulate_forces(order.vessel, x0, given, STEP_S).x[1:]
        runs[TOGETHER] = lambda: simulate_forces(order.vessel, np.tile(x0, (BOATS, 1)), given, STEP_S).x[0, 1:]
    states = {name: run() for name, run in runs.items()}  # also: whatever is made at a first call

    def timed(run: Callable[[], np.ndarray]) -> Callable[[], float]:
        return lambda: sum(took for took, _ in times_of([run]))

    found = interleaved({name: timed(run) for name, run in runs.items()}, order.rounds, order.progress)
    first, *_ = runs
    for name, t in found.items():
        boats = BOATS if name == TOGETHER else 1
        yield BenchRow(
            part="simulation", problem=PROBLEM, name=name, unit="s/s", count=t.count, rounds=order.rounds,
            p50=boats * SIMULATED_S / t.median(50), times=boats * found[first].fastest(50) / t.median(50),
            reference=name == first, off=float(np.abs(states[name] - states[WHOLE]).max()),
            note="without the file's terms" if name == first and order.vessel.terms else "",
        )  # fmt: skip
