"""Models in open loop (`protocol.Simulator`): a vessel file, a fitted Taylor series, two baselines without a model."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.core.geometry.frames import rotate
from companion.core.model.effects.wind import steady_speed
from companion.core.model.loads import values
from companion.core.model.thrust_lag import first_order_lag
from companion.core.model.thrusters import configuration_matrix
from sim.fitting.engine.thrust.forces import thruster_forces
from sim.fitting.taylor.abkowitz import KGF_N
from sim.fitting.taylor.taylor_file import simulate_taylor
from sim.fitting.validate.protocol import STEP_S, Commands
from sim.trajectory import Surroundings, parameters_of, simulate_forces

WORTH_IT = 10_000
"""Number of samples in all windows from which machine code is quicker than the interpreter, compilation included."""


@dataclass(frozen=True)
class VesselSimulator:
    """The structured model of a vessel file, with its dead time (to the nearest step) and lag.

    Where the file has `[terms.wind]`, measured wind takes the place of the file's own.
    """

    name: str
    vessel: VesselFile

    def simulate(self, x0: np.ndarray, commands: Commands) -> np.ndarray:
        """As `Simulator`."""
        f_cmd, f = self._forces(commands)
        sound = np.isfinite(f_cmd).all(axis=2)
        f_cmd[~sound] = 0.0
        x = simulate_forces(
            self.vessel, np.hstack([x0, f]), f_cmd, STEP_S,
            around=self._around(commands),
            parameters=parameters_of(self.vessel),  # another boat of the same structure then reuses the machine code
            substeps=math.ceil(2 * STEP_S / self.vessel.propulsion.lag_s),
            machine_code=sound.size > WORTH_IT,
        ).x[..., :6]  # fmt: skip
        x[:, 1:][np.logical_or.accumulate(~sound, axis=1)] = np.nan
        return x

    def _around(self, commands: Commands) -> Surroundings | None:
        """The measured wind of each step, else the file's own; None: none was measured, or it moves nothing."""
        if commands.wind_m_s is None or "wind" not in self.vessel.terms:
            return None
        own = values("wind", self.vessel.terms["wind"])
        north, east = np.moveaxis(commands.wind_m_s, -1, 0)
        known = np.isfinite(north)
        return Surroundings(
            V_w_m_s=np.where(known, np.hypot(north, east), steady_speed(own)),
            beta_w_deg=np.where(known, np.degrees(np.arctan2(east, north)), own["beta_w_deg"]),
        )

    def _forces(self, commands: Commands) -> tuple[np.ndarray, np.ndarray]:
        """Commanded forces after the dead time (m, k, n) and actual forces at the start (m, n), both [N]."""
        m, b, n = commands.before_us.shape
        pwm = np.concatenate([commands.before_us, commands.pwm_us], axis=1)
        volts = np.concatenate([np.repeat(commands.battery_v[:, :1], b, axis=1), commands.battery_v], axis=1)
        settings = {
            name: np.concatenate([np.repeat(values[:, :1], b, axis=1), values], axis=1).ravel()
            for name, values in commands.settings.items()
        }
        forces = thruster_forces(self.vessel, pwm.reshape(-1, n), volts.ravel(), settings).reshape(m, -1, n)
        late = min(round(self.vessel.propulsion.dead_time_s / STEP_S), b)
        f = forces[:, 0]
        for i in range(b - late):
            f = first_order_lag(f, forces[:, i], STEP_S, self.vessel.propulsion.lag_s)
        return forces[:, b - late : forces.shape[1] - late], f


@dataclass(frozen=True)
class TaylorSimulator:
    """The 23-term series with coefficients (3, 23); forces by the vessel file's thruster map, without lag."""

    name: str
    coefficients: np.ndarray
    vessel: VesselFile

    def simulate(self, x0: np.ndarray, commands: Commands) -> np.ndarray:
        """As `Simulator`."""
        m, k, n = commands.pwm_us.shape
        settings = {name: values.ravel() for name, values in commands.settings.items()}
        f = thruster_forces(self.vessel, commands.pwm_us.reshape(-1, n), commands.battery_v.ravel(), settings)
        t_kgf = (f @ configuration_matrix(self.vessel).T / KGF_N).reshape(m, k, 3)
        return simulate_taylor(self.coefficients, x0, t_kgf, STEP_S, substeps=1)


@dataclass(frozen=True)
class ConstantVelocity:
    """Baseline: u, v, r stay constant, whatever the commands."""

    name: str = "velocity stays"

    def simulate(self, x0: np.ndarray, commands: Commands) -> np.ndarray:
        """As `Simulator`."""
        return _kinematics(x0, np.ones(3), commands)


@dataclass(frozen=True)
class ZeroVelocity:
    """Baseline: u = v = r = 0 from the first step on; the pose stays."""

    name: str = "velocity is zero"

    def simulate(self, x0: np.ndarray, commands: Commands) -> np.ndarray:
        """As `Simulator`."""
        return _kinematics(x0, np.zeros(3), commands)


def _kinematics(x0: np.ndarray, factor: np.ndarray, commands: Commands) -> np.ndarray:
    """Exact poses under constant body velocities: nu of x0 times `factor` from the first step on.

    The path is an arc; its chord after t is t sinc(r t / 2) |nu| at the mean heading psi_0 + r t / 2.
    """
    k = commands.pwm_us.shape[1]
    nu = np.asarray(x0)[:, None, 3:] * factor
    t = STEP_S * np.arange(k + 1)[None]
    psi0, half = np.asarray(x0)[:, None, 2], nu[..., 2] * t / 2
    reach = t * np.sinc(half / np.pi)  # chord of the arc
    out = np.empty((len(x0), k + 1, 6))
    away = rotate(psi0 + half, nu[..., 0], nu[..., 1])
    for axis in (0, 1):
        out[..., axis] = np.asarray(x0)[:, None, axis] + reach * away[axis]
    out[..., 2] = psi0 + nu[..., 2] * t
    out[..., 3:] = nu
    out[:, 0] = x0
    return out
