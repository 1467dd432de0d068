"""One sample of a trajectory as a CasADi function: the plant's own equations, with what is wanted of them as inputs.

    V     = V_open - R_i I(f)         or V as measured
    F     = force map(pwm, V)         with dead band, trim and gain, held over the sample; angle of a servo by its pulse
    dx/dt = state_rate(model, x, F, force_n)       `substeps` of Runge-Kutta; current and wind held over the sample

Nothing of the model is written here: `manoeuvring`, `integrate` and `actuators` of `companion.core.model` have it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import casadi as ca
import numpy as np
from msgspec.structs import replace as replace_fields

from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.actuators.propulsion import channels_of
from companion.core.model.integrate import rk4, state_rate
from companion.core.model.manoeuvring import StructuredModel, coefficients
from sim.world.plant import R_BATTERY_OHM, battery_current, in_weather

GONE = 1e3
"""[m/s, rad/s] No boat is as fast: from here on a trajectory is NaN. So is one whose heading passes `TURNED`."""
TURNED = 1e6
"""[rad]"""

Drive = Literal["pwm", "pwm at voltage", "force"]
"""Pulse widths at a pack's open-circuit voltage, at the voltage that reaches the ESCs; forces."""


@dataclass(frozen=True)
class StepKind:
    """What a step is compiled for. `parameters`: numbers of the vessel file that are inputs, by path.

    `given`: name and width of every other input, and whether it changes from sample to sample; the first is the drive.
    """

    drive: Drive
    given: tuple[tuple[str, int, bool], ...]
    parameters: tuple[str, ...]
    substeps: int


@dataclass(frozen=True)
class _Boat(StructuredModel):
    """The model with a lag that may be a symbol."""

    lag: Any = None

    @property
    def lag_s(self) -> Any:
        """As StructuredModel's."""
        return self.lag


def parameters_of(vessel: VesselFile) -> dict[str, float]:
    """Numbers of a vessel file that may differ between trajectories, by their paths in the file."""
    tables = {"inertia": vessel.inertia, "damping": vessel.damping}
    found = {f"{name}.{k}": getattr(t, k) for name, t in tables.items() for k in t.__struct_fields__ if k != "source"}
    found["propulsion.lag_s"] = vessel.propulsion.lag_s
    found |= {f"thrusters.{t.name}.gain": t.gain for t in vessel.thrusters}
    for name, given in StructuredModel.of(vessel).term_values.items():
        found |= {f"terms.{name}.{p}": value for p, value in given.items()}
    return found


def step_function(vessel: VesselFile, kind: StepKind) -> ca.Function:
    """(x, constants, series ..) -> x after the sample, twice: as what is carried on and as the row that is kept.

    constants: sample length [s], what of `given` is constant, `parameters`.
    """
    n, thrusts = len(vessel.controls), slice(6, 6 + len(vessel.thrusters))
    x = ca.SX.sym("x", 6 + n)
    h: Any = ca.SX.sym("h")
    symbols: dict[str, Any] = {name: ca.SX.sym(name, width) for name, width, _ in kind.given}
    free = {name: ca.SX.sym("q") for name in kind.parameters}
    boat = replace_fields(vessel, thrusters=tuple(replace_fields(t, gain=1.0) for t in vessel.thrusters))
    model = in_weather(_model(vessel, free, symbols.get("t_s")), symbols.get("current"), symbols.get("wind"))
    f_cmd = symbols["drive"]
    if kind.drive != "force":
        volts = symbols["voltage_v"]
        if kind.drive == "pwm":
            volts = ca.fmax(volts - _sag(x[thrusts], volts), 0.0)
        gains = ca.vertcat(
            *(free.get(f"thrusters.{t.name}.gain", t.gain) for t in vessel.thrusters), *(1.0 for _ in vessel.servos)
        )
        f_cmd = gains * ca.vertcat(*(c.expression(f_cmd[i], volts) for i, c in enumerate(channels_of(boat))))
    tau_ext = symbols.get("force_n", ca.SX.zeros(3))
    after = rk4(lambda s: state_rate(model, s, f_cmd, tau_ext), x, h, kind.substeps)
    small = ca.vertcat(ca.fabs(after[2]) / TURNED, ca.fabs(after[3:6]) / GONE)
    sound = ca.logic_and(ca.logic_and(small[0] < 1, small[1] < 1), ca.logic_and(small[2] < 1, small[3] < 1))
    after = ca.vertcat(*(ca.if_else(sound, after[i], np.nan) for i in range(6 + n)))
    constants = ca.vertcat(h, *(symbols[name] for name, _, varies in kind.given if not varies), *free.values())
    series = [symbols[name] for name, _, varies in kind.given if varies]
    (after,) = ca.cse([after])
    return ca.Function("sample", [x, constants, *series], [after, after])


def _model(vessel: VesselFile, free: Mapping[str, Any], t_s: Any) -> StructuredModel:
    """The vessel file's model with symbols where `free` has them, at t_s [s]; None: no clock."""
    base = StructuredModel.of(vessel)
    tables = {k: name for name in ("inertia", "damping") for k in getattr(vessel, name).__struct_fields__}
    c = {k: free.get(f"{tables[k]}.{k}", value) for k, value in coefficients(vessel).items()}
    terms = {
        name: {p: free.get(f"terms.{name}.{p}", value) for p, value in given.items()}
        for name, given in base.term_values.items()
    }
    lag, own = free.get("propulsion.lag_s", vessel.propulsion.lag_s), [one.lag_s for one in vessel.controls]
    if any(value is not None for value in own):
        lag = ca.vertcat(*(lag if value is None else value for value in own))
    return _Boat(vessel, c, terms, t_s, lag=lag)


def _sag(f: Any, open_v: Any) -> Any:
    """R_i I [V] of thruster forces f [N]; |f|^1.5 as |f| sqrt|f|, which is quicker than a power."""
    size: Any = ca.fabs(f)
    return R_BATTERY_OHM * battery_current(ca.dot(size, ca.sqrt(size)), open_v)
