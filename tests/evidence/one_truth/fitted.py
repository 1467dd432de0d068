"""The model that a diagnosis fits: accelerations, steps and readings by the posterior's own physics and hooks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from msgspec.structs import replace as replace_fields

from companion.core.configuration.vessel_file import VesselFile
from companion.core.geometry.frames import rotate
from companion.core.model.integrate import rk4_step
from companion.logs.runs.decimate import decimated
from companion.logs.runs.run import Run
from sim.fitting.diagnose.catalogue import catalogue
from sim.fitting.diagnose.catalogue.effect import Effect, EffectParameter
from sim.fitting.diagnose.posterior.physics import EffectPhysics
from sim.fitting.diagnose.posterior.readings import Readings
from sim.fitting.diagnose.posterior.thrust import WindowThrust
from sim.fitting.diagnose.vessel_edits.edits import CauseValues
from sim.fitting.diagnose.vessel_edits.public_form import public_values
from sim.fitting.diagnose.vessel_edits.public_table import LogReference
from sim.fitting.engine.noise import L

Causes = Sequence[tuple[Effect, np.ndarray]]
"""Effects with the values of their parameters."""
STILL, MOST = 1e-14, 60
"""Change [m/s^2] below which accelerations on which hooks depend are found, and passes for it."""


class Engine:
    """The posterior's physics of a vessel file on a log, at random states."""

    def __init__(self, vessel: VesselFile, run: Run, rng: np.random.Generator):
        self.vessel, self.physics = vessel, EffectPhysics([run], vessel, 1.0)
        self.catalogue, self.readings = catalogue(vessel, [run]), Readings(self.physics)
        self._runs = self.physics.runs
        self._width_s = decimated(run).width_s
        W, K = self.physics.windows.size
        self._state = self.physics.one_pass((), {}, np.zeros((W, L)), None)
        low, high = np.array([0, 0, -3, -1.2, -0.6, -1.0]), np.array([30, 30, 3, 1.2, 0.6, 1.0])
        self.x = rng.uniform(low, high, (W, K + 1, 6))

    def cause(self, effect: Effect, values: np.ndarray) -> CauseValues:
        """The effect as it would be written into a file."""
        place = LogReference(self.physics.centre_m, self.physics.middle_s)
        return CauseValues(effect, effect.by_name(map(float, values)), public_values(effect, values, place), "drawn")

    def _in_order(self, causes: Causes) -> tuple[list[Effect], dict[str, np.ndarray]]:
        """Effects as the catalogue orders them, in which their hooks are called, and values by id."""
        theta = {effect.id: values for effect, values in causes}
        return [e for e in self.catalogue if e.id in theta], theta

    def forces_of(self, vessel: VesselFile) -> np.ndarray:
        """Thruster forces (W, K+1, n) [N] of a vessel file under the log's commands.

        The voltage between its samples is part of the log: by lag and dead time of the base, for fit and file alike.
        """
        as_in_base = replace_fields(vessel, propulsion=self.vessel.propulsion)
        thrust = WindowThrust(self._runs, as_in_base, self.physics.windows, [self._width_s])
        own = Effect("own", "base", "", "", (EffectParameter("there", "1", 1.0, 1.0, 1.0),),
                     {"maps": lambda _, v: replace_fields(v, propulsion=vessel.propulsion)})  # fmt: skip
        return thrust.forces([own], {"own": np.ones(1)}).f

    def nu_dot(self, causes: Causes, x: np.ndarray, clock_s: float) -> np.ndarray:
        """Accelerations (W, K+1, 3) at states x, whose forces may depend on them: a fixed point."""
        (effects, theta), none = self._in_order(causes), np.zeros((len(x), 3))
        self.physics.clock_s = np.full(x.shape[:2], clock_s)
        now = np.zeros((*x.shape[:2], 3))
        for _ in range(MOST):
            state = replace(self._state, x=x, nu_dot=now)
            missing = self.physics.remainder(effects, theta, state, none).nodes
            now = now - missing
            if np.abs(missing).max() < STILL:
                break
        return now

    def step(self, causes: Causes, x: np.ndarray, clock_s: float, h_s: float) -> np.ndarray:
        """States after h_s under constant thruster forces, by Runge-Kutta; water as it is at the start."""

        def rate(x: np.ndarray, _: None) -> np.ndarray:
            north, east = rotate(x[..., 2], x[..., 3], x[..., 4])
            return np.concatenate(
                [np.stack([north, east, x[..., 5]], axis=-1), self.nu_dot(causes, x, clock_s)], axis=-1
            )

        return rk4_step(rate, x, h_s, (None, None, None))

    def imu(self, causes: Causes, nu_dot: np.ndarray) -> np.ndarray:
        """Readings psi, r, a_x, a_y (W, K, 4) at the states."""
        state = replace(self._state, x=self.x, nu_dot=nu_dot)
        return self.readings.imu(*self._in_order(causes), state)

    def tag(self, causes: Causes, nu_dot: np.ndarray) -> np.ndarray:
        """Position samples (m, 2) [m] at the states."""
        state = replace(self._state, x=self.x, nu_dot=nu_dot)
        return self.readings.tag(*self._in_order(causes), state)
