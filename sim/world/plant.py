"""The hull and its actuators: pulse widths in, motion out, by the one model of `companion.core`.

    f_cmd = F(pwm(t - dead time), V) of each channel;   dx/dt = state_rate(model, x, f_cmd, waves)

at 100 Hz by Runge-Kutta, in two steps where a command begins to act between. Current and wind enter as the model's own
terms, with values that may change at every step. Battery: V = V_open - R_i I with the current of the bollard table's
power law.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from msgspec.structs import replace as replace_fields

from companion.core.configuration.vessel_file import VesselFile
from companion.core.constants import NEUTRAL_US
from companion.core.model.actuators.propulsion import channels_of
from companion.core.model.effects.waves import pattern
from companion.core.model.integrate import BufferedStep, DelayLine, rk4, state_rate
from companion.core.model.loads import values
from companion.core.model.manoeuvring import StructuredModel
from sim.world.environment import Moment

R_BATTERY_OHM = 0.05  # assumed: 4S pack with leads
WATTS_PER_N15 = 0.92  # P = 0.92 |F|^1.5: 203 W at 36.4 N, manufacturer's table at 12 V
HOTEL_A = 1.5  # assumed: computer, autopilot, radio


def battery_current(load_n15: Any, open_v: Any) -> Any:
    """Current [A] of a pack of open-circuit voltage `open_v` [V] under the load sum |f_i|^1.5 [N^1.5] of thrusters."""
    return HOTEL_A + WATTS_PER_N15 * load_n15 / open_v


@dataclass(frozen=True)
class Motion:
    """Where the boat is and how it moves: x = [x y psi u v r f_1..f_n] and nu_dot, both at `t_ns`."""

    t_ns: int
    x: np.ndarray
    nu_dot: np.ndarray


class Plant:
    """One boat in the water."""

    def __init__(self, vessel: VesselFile, x0: np.ndarray, *, step_ns: int, voltage_v: float, t_ns: int = 0):
        self.step_ns, self._thrusts = step_ns, slice(6, 6 + len(vessel.thrusters))
        self._channels = channels = channels_of(vessel)
        n = len(channels)
        self._open_v = self.voltage_v = voltage_v
        self.function = _plant_function(vessel)
        self._step = BufferedStep(self.function)
        self._pwm = [DelayLine(round(c.dead_time_s * 1e9), (float(NEUTRAL_US),)) for c in channels]
        self.motion = Motion(t_ns, np.concatenate([np.asarray(x0, dtype=float)[:6], np.zeros(n)]), np.zeros(3))

    @property
    def current_a(self) -> float:
        """Battery current [A]."""
        return float(battery_current((np.abs(self.motion.x[self._thrusts]) ** 1.5).sum(), self._open_v))

    def command(self, t_ns: int, pwm_us: tuple[float, ...]) -> None:
        """Pulse widths [us] that reach ESCs and servos from `t_ns` on, in the order of `vessel.controls`."""
        for line, pulse in zip(self._pwm, pwm_us, strict=True):
            line.push(t_ns, (pulse,))

    def step(self, moment: Moment, step_ns: int | None = None) -> Motion:
        """Advance by one step (`step_ns` long where given) in the given environment."""
        end_ns = self.motion.t_ns + (step_ns or self.step_ns)
        while (t_ns := self.motion.t_ns) < end_ns:
            pulses = [line.at(t_ns)[0] for line in self._pwm]
            changes = (due_ns for line in self._pwm if (due_ns := line.next_ns()) is not None)
            self._advance(moment, pulses, min((end_ns, *changes)) - t_ns)
        return self.motion

    def _advance(self, moment: Moment, pulses: list[float], step_ns: int) -> None:
        """`step_ns` on under these pulse widths [us], which act all the time."""
        t_ns = self.motion.t_ns
        f_cmd = [c.value(pwm, self.voltage_v) for c, pwm in zip(self._channels, pulses, strict=True)]
        waves_n = moment.wave_n
        if moment.along_waves_n:
            q = np.radians(moment.beta_wave_deg) + np.pi - self.motion.x[2]
            waves_n = waves_n + moment.along_waves_n * np.array(pattern(q))
        air_and_water = (moment.V_c_m_s, moment.beta_c_deg, moment.V_w_m_s, moment.beta_w_deg)
        out = self._step(self.motion.x, f_cmd, waves_n, air_and_water, step_ns * 1e-9)
        self.motion = Motion(t_ns + step_ns, out[:-3], out[-3:])
        self.voltage_v = self._open_v - R_BATTERY_OHM * self.current_a


def in_weather(model: StructuredModel, current: Any = None, wind: Any = None) -> StructuredModel:
    """The model in water that flows (V_c [m/s], beta_c [deg] towards) and in wind (V_w [m/s], beta_w [deg] from).

    Numbers or symbols, in place of what the vessel file has; None: as it has it.
    """
    sky = dict(model.term_values)
    if current is not None:
        sky["current"] = {"V_c_m_s": current[0], "beta_c_deg": current[1]}
    if wind is not None:
        shape = model.term_values.get("wind") or values("wind", {})
        sky["wind"] = {**shape, "V_w_m_s": wind[0], "beta_w_deg": wind[1], "gustiness": 0.0}
    return replace(model, term_values=sky)


def _plant_function(vessel: VesselFile) -> ca.Function:
    """(x, f_cmd, wave, [V_c, beta_c, V_w, beta_w], h) -> [x after h; nu_dot there]."""
    weather = ca.SX.sym("weather", 4)
    h: Any = ca.SX.sym("h")
    model = in_weather(StructuredModel.of(vessel), weather[:2], weather[2:])
    n = len(vessel.controls)
    x, f_cmd, wave = ca.SX.sym("x", 6 + n), ca.SX.sym("f_cmd", n), ca.SX.sym("wave", 3)
    x_next = rk4(lambda s: state_rate(model, s, f_cmd, wave), x, h)
    nu_dot = state_rate(model, x_next, f_cmd, wave)[3:6]
    return ca.Function("plant", [x, f_cmd, wave, weather, h], [ca.vertcat(x_next, nu_dot)])


def perturbed(vessel: VesselFile, rng: np.random.Generator, share: float) -> VesselFile:
    """A boat like `vessel` with inertia, damping and thruster gains off by up to `share` (uniform)."""

    def shake(table, keys):
        return {k: getattr(table, k) * (1 + float(rng.uniform(-share, share))) for k in keys}

    inertia = shake(vessel.inertia, ("mass_kg", "I_z_kg_m2", "X_udot_kg", "Y_vdot_kg", "N_rdot_kg_m2"))
    damping = shake(vessel.damping, [k for k in vessel.damping.__struct_fields__ if k != "source"])
    thrusters = tuple(replace_fields(t, **shake(t, ("gain",))) for t in vessel.thrusters)
    return replace_fields(
        vessel,
        inertia=replace_fields(vessel.inertia, **inertia),
        damping=replace_fields(vessel.damping, **damping),
        thrusters=thrusters,
    )
