"""Whole trajectories of a boat, one or many at once, from the model of its vessel file.

    simulate(vessel, x0, pwm_us, dt_s)            pulse widths, through dead time, battery and force map
    simulate_forces(vessel, x0, f_cmd_n, dt_s)    commanded thruster forces and angles of servos, through the lag

Reference: docs/simulate.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from sim.trajectory.arguments import Surroundings, Task, delayed, forces, task
from sim.trajectory.run import states
from sim.trajectory.step import parameters_of

__all__ = ["Surroundings", "Trajectory", "parameters_of", "simulate", "simulate_forces"]


@dataclass(frozen=True)
class Trajectory:
    """x = [x y psi | u v r | f_1 .. f_n] at `t_s` (k + 1,): (k + 1, 6 + n), or (m, k + 1, 6 + n) of several.

    NED pose [m, m, rad], psi not wrapped; body velocities [m/s, m/s, rad/s]; thruster forces [N], then angles of servos
    [rad]. NaN from where a trajectory has run away (1000 m/s or rad/s, a million rad). `why_interpreted`: empty where
    machine code ran.
    """

    t_s: np.ndarray
    x: np.ndarray
    why_interpreted: str = ""

    @property
    def eta(self) -> np.ndarray:
        """Pose, (..., k + 1, 3)."""
        return self.x[..., :3]

    @property
    def nu(self) -> np.ndarray:
        """Body velocities, (..., k + 1, 3)."""
        return self.x[..., 3:6]

    @property
    def f(self) -> np.ndarray:
        """Thruster forces [N], angles of servos [rad], (..., k + 1, n)."""
        return self.x[..., 6:]


def simulate(
    vessel: VesselFile,
    x0: Any,
    pwm_us: Any,
    dt_s: float,
    *,
    before_us: Any = None,
    voltage_v: Any = None,
    loaded: bool = False,
    around: Surroundings | None = None,
    parameters: Mapping[str, Any] | None = None,
    substeps: int = 1,
    machine_code: bool = True,
) -> Trajectory:
    """Move a boat by pulse widths [us], each held for `dt_s`: what `sim.world.plant.Plant` does, all steps at once.

    x0          [x y psi u v r] or [x y psi u v r f_1 .. f_n] (forces 0): one, or (m, .)
    pwm_us      (k, n) or (m, k, n), all thrusters, then all servos, in the vessel file's order; limited to what an ESC
                knows
    before_us   what was sent before, (b, n) or (m, b, n), for the dead time (rounded up to samples); None: 1500
    voltage_v   number, (k,), (m, 1) or (m, k); None: the file's nominal one. Without load, unless `loaded`: as it
                reaches the ESCs
    parameters  numbers of the vessel file by path (`parameters_of`), each a number or (m,), in place of its own; what
                `around` says stands above the file's own current and wind, a thruster's own lag above propulsion's
    substeps    of Runge-Kutta in each sample
    machine_code  False: CasADi's interpreter, as where there is no machine code; equal to round-off

    Trajectories do not touch each other: the same in any company, bit for bit. Raises ValueError: shapes, numbers that
    are not finite, unknown parameters, steps too long for the lag.
    """
    drive = delayed(vessel, pwm_us, before_us, dt_s)
    volts = vessel.propulsion.nominal_voltage_V if voltage_v is None else voltage_v
    work = task(
        vessel, x0, drive, "pwm at voltage" if loaded else "pwm", dt_s,
        voltage_v=volts, around=around, parameters=parameters, substeps=substeps,
    )  # fmt: skip
    return _trajectory(vessel, work, dt_s, machine_code)


def simulate_forces(
    vessel: VesselFile,
    x0: Any,
    f_cmd_n: Any,
    dt_s: float,
    *,
    around: Surroundings | None = None,
    parameters: Mapping[str, Any] | None = None,
    substeps: int = 1,
    machine_code: bool = True,
) -> Trajectory:
    """As `simulate`, by commanded thruster forces [N], (k, n) or (m, k, n), after dead time and force map."""
    work = task(
        vessel, x0, forces(vessel, f_cmd_n), "force", dt_s, around=around, parameters=parameters, substeps=substeps
    )
    return _trajectory(vessel, work, dt_s, machine_code)


def _trajectory(vessel: VesselFile, work: Task, dt_s: float, machine_code: bool) -> Trajectory:
    x, why = states(vessel, work, machine_code)
    return Trajectory(np.arange(work.samples + 1) * dt_s, x[0] if work.one else x, why)
