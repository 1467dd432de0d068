"""The vessel file that was written, in the simulator, the trajectory simulator, the filter and the NMPC."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.core.control.nmpc.stage import advance
from companion.core.estimation.process import STATES, Process, process_function
from companion.core.geometry.frames import point_acceleration
from companion.core.model.manoeuvring import StructuredModel
from companion.core.model.sensor_errors import (
    apply_heading_errors,
    apply_imu_errors,
    apply_uwb_scale,
    correct_heading,
    correct_imu,
    drifted,
)
from sim.fitting.diagnose.posterior.tag_kinematics import tag_kinematics
from sim.trajectory import simulate_forces
from sim.world.environment import Environment, Weather, with_terms_of
from sim.world.plant import Plant
from tests.evidence.one_truth.fitted import Engine


class Models:
    """Accelerations, trajectories and readings of one vessel file at rows of states x (m, 6) and forces f (m, n)."""

    def __init__(self, vessel: VesselFile):
        self.vessel, self.model = vessel, StructuredModel.of(vessel)
        self._plant = Plant(vessel, np.zeros(6), step_ns=10_000_000, voltage_v=15.0).function
        weather = with_terms_of(Weather(), vessel)
        self._environment = Environment(weather, np.random.default_rng(0))

    def _in_plant(self, x: np.ndarray, f: np.ndarray, t_s: float, h_s: float) -> np.ndarray:
        now = self._environment.step(t_s, h_s or 0.01)
        air_and_water = [now.V_c_m_s, now.beta_c_deg, now.V_w_m_s, now.beta_w_deg]
        return _mapped(self._plant, np.hstack([x, f]), f, np.zeros(3), np.array(air_and_water), np.array([h_s]))

    def nu_dot(self, x: np.ndarray, f: np.ndarray, t_s: float) -> np.ndarray:
        """Accelerations (m, 3) of the simulated hull."""
        return self._in_plant(x, f, t_s, 0.0)[:, -3:]

    def trajectories(self, x: np.ndarray, f: np.ndarray, steps: int, h_s: float) -> dict[str, np.ndarray]:
        """By program, states (m, steps + 1, 6) under constant forces from time 0 on."""
        n = f.shape[1]
        state, c, d = ca.SX.sym("x", 6 + n), ca.SX.sym("c", n), ca.SX.sym("d", 3)
        nmpc = ca.Function("nmpc", [state, c, d], [advance(self.model, state, c, d, h_s)])
        filtered = process_function(self.model)
        drive = f if not self.model.is_linear_in_f else f @ self.model.B.T
        held = np.repeat(f[:, None], steps, axis=1)
        along = simulate_forces(self.vessel, np.hstack([x, f]), held, h_s)
        nothing = np.zeros(3)

        def chained(step: Any) -> np.ndarray:
            rows = [x]
            for k in range(steps):
                rows.append(step(rows[-1], k * h_s)[:, :6])
            return np.stack(rows, axis=1)

        return {
            "simulator": chained(lambda x, t: self._in_plant(x, f, t, h_s)),
            "trajectories": along.x[..., :6],
            "filter": chained(
                lambda x, t: _mapped(filtered, np.pad(x, ((0, 0), (0, STATES - 6))), drive, np.array([h_s]))
            ),
            "NMPC": chained(lambda x, t: _mapped(nmpc, np.hstack([x, f]), f, nothing)),
        }

    def imu(self, x: np.ndarray, nu_dot: np.ndarray) -> np.ndarray:
        """Readings psi, r, a_x, a_y (m, 4) of the simulated sensors, without noise."""
        imu = self.vessel.sensors.imu
        force = point_acceleration(x[:, 3:].T, nu_dot.T, (imu.x_m, imu.y_m))
        a_x, a_y, r = apply_imu_errors(imu, *force, x[:, 5])
        return np.stack([apply_heading_errors(imu, x[:, 2]), r, a_x, a_y], axis=1)

    def corrected(self, y: np.ndarray) -> np.ndarray:
        """Readings psi, r, a_x, a_y (m, 4) as the filter takes them: freed of what the file knows."""
        imu = self.vessel.sensors.imu
        a_x, a_y, r = correct_imu(imu, y[:, 2], y[:, 3], y[:, 1])
        return np.stack([correct_heading(imu, y[:, 0]), r, a_x, a_y], axis=1)

    def expected(self, x: np.ndarray, f: np.ndarray) -> np.ndarray:
        """What the filter expects the corrected accelerometers to read, a_x, a_y (m, 2)."""
        process = Process(self.model, (self.vessel.sensors.imu.x_m, self.vessel.sensors.imu.y_m))
        latent = np.zeros(STATES - 6)
        rows = [process.acceleration(np.append(s, latent), process.drive(g))[0] for s, g in zip(x, f, strict=True)]
        return np.array(rows)

    def tag(self, engine: Engine, x: np.ndarray, nu_dot: np.ndarray) -> np.ndarray:
        """Positions (m, 2) that arrive at the stamps of the engine's samples, from its states at the steps before."""
        sensor, windows = self.vessel.sensors.position, engine.physics.windows
        w, k = engine.readings.window, engine.readings.index
        when = windows.fixes.t_s - sensor.latency_s
        uwb = self.vessel.sensors.uwb
        if uwb is not None:
            when = when - drifted(uwb.clock_drift_s_s, when - engine.physics.first_fix_s)
        arm = np.array([sensor.x_m, sensor.y_m])
        seen = tag_kinematics(engine.physics, x[w, k], nu_dot[w, k], when - windows.t_s[w, k], arm, when).place_m
        return seen if uwb is None else np.stack(apply_uwb_scale(uwb, *seen.T), axis=1)


def _mapped(function: ca.Function, *args: np.ndarray) -> np.ndarray:
    """First output (m, k) of a CasADi function for rows of arguments, those of one row for all."""
    m = max(len(a) for a in args if a.ndim == 2)
    given = [a.T if a.ndim == 2 else np.repeat(a[:, None], m, axis=1) for a in args]
    out = function.map(m)(*given)
    return np.array(out[0] if isinstance(out, tuple) else out).T
