"""The vessel file: what one boat is made of. Reference: docs/vessel-file.md.

Body axes: x forward, y starboard, z down; origin where `hull` says. Hydrodynamic derivatives carry SNAME
signs, so added mass and damping coefficients of a stable hull are negative (X_udot < 0, X_u < 0). Bounds: `ranges`.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import msgspec
import numpy as np

from companion.core.configuration import file_kinds
from companion.core.configuration.sensors import Arm, Sensors
from companion.core.configuration.servos import DeadTime, Lag, Pulse, RcChannel, Rudder, Servo, Steering, Trim
from companion.core.configuration.tables import SourcedTable, Table

Area = Annotated[float, msgspec.Meta(ge=0, le=500)]
AddedMass = Annotated[float, msgspec.Meta(ge=-1e6, le=0)]
LinearDamping = Annotated[float, msgspec.Meta(ge=-1e6, le=0)]
QuadraticDamping = Annotated[float, msgspec.Meta(ge=-1e6, le=0)]
Coupling = Annotated[float, msgspec.Meta(ge=-1e6, le=1e6)]
"""Terms between sway and yaw, of added mass [kg m] or damping [N s]."""
Force = Annotated[float, msgspec.Meta(ge=0.001, le=50_000)]
"""What one thruster can give [N]."""
ForceRate = Annotated[float, msgspec.Meta(ge=0.001, le=1e6)]
Voltage = Annotated[float, msgspec.Meta(ge=1, le=1000)]


class Hull(SourcedTable, frozen=True, kw_only=True):
    """Outer size [m] and the areas above water that wind sees [m^2], 0 where nobody measured: then wind
    does nothing. `origin` says where the axes sit.
    """

    length_m: Annotated[float, msgspec.Meta(ge=0.1, le=30)]
    beam_m: Annotated[float, msgspec.Meta(ge=0.02, le=20)]
    draft_m: Annotated[float, msgspec.Meta(ge=0.005, le=5)]
    origin: str
    frontal_area_m2: Area = 0.0
    lateral_area_m2: Area = 0.0


class Inertia(SourcedTable, frozen=True, kw_only=True):
    """Rigid body and added mass. I_z about the body origin's CG; x_g, y_g: CG from the origin [m]."""

    mass_kg: Annotated[float, msgspec.Meta(ge=0.1, le=1e5)]
    I_z_kg_m2: Annotated[float, msgspec.Meta(ge=1e-4, le=1e7)]
    x_g_m: Arm = 0.0
    y_g_m: Arm = 0.0
    X_udot_kg: AddedMass
    Y_vdot_kg: AddedMass
    Y_rdot_kg_m: Coupling = 0.0
    N_rdot_kg_m2: Annotated[float, msgspec.Meta(ge=-1e7, le=0)]


class Damping(SourcedTable, frozen=True, kw_only=True):
    """D(nu) = -[X_u + X_uu |u|, ...]: linear with yaw-sway coupling, quadratic on the diagonal."""

    X_u_N_s_m: LinearDamping
    Y_v_N_s_m: LinearDamping
    Y_r_N_s: Coupling = 0.0
    N_v_N_s: Coupling = 0.0
    N_r_N_m_s: Annotated[float, msgspec.Meta(ge=-1e7, le=0)]
    X_uu_N_s2_m2: QuadraticDamping
    Y_vv_N_s2_m2: QuadraticDamping
    N_rr_N_m_s2: Annotated[float, msgspec.Meta(ge=-1e8, le=0)]


AsternShare = Annotated[float, msgspec.Meta(ge=0.05, le=20)] | None
"""Thrust astern on this hull over that of the map, which is of open water; where it stands, `identify` estimates it."""


class RotorMap(SourcedTable, frozen=True, kw_only=True, tag="rotor", tag_field="kind"):
    """Propeller behind an ESC: n(pwm, V) [rev/s], then F = k n |n| [N]. Equations in `thrusters`."""

    dead_band_us: Annotated[float, msgspec.Meta(ge=0, le=100)]
    V_ref_V: Voltage
    k_ahead_N_s2: Annotated[float, msgspec.Meta(ge=1e-8, le=1000)]
    k_astern_N_s2: Annotated[float, msgspec.Meta(ge=1e-8, le=1000)]
    ahead: RotorCurve
    astern: RotorCurve
    astern_share: AsternShare = None


class RotorCurve(Table, frozen=True, kw_only=True):
    """n = (V / V_ref)^(a0 + a1 e) (c1 e^q + c2 e^2) [rev/s] over the command e beyond the dead band."""

    a0: Annotated[float, msgspec.Meta(ge=-5, le=5)]
    a1: Annotated[float, msgspec.Meta(ge=-5, le=5)]
    q: Annotated[float, msgspec.Meta(ge=0.05, le=10)]
    c1_rps: Annotated[float, msgspec.Meta(ge=0.01, le=1000)]
    c2_rps: Annotated[float, msgspec.Meta(ge=0, le=1000)]


class LinearMap(SourcedTable, frozen=True, kw_only=True, tag="linear", tag_field="kind"):
    """Force proportional to the command in -1..1 (1500 us is 0, 1900 us is 1); voltage plays no part."""

    ahead_N: Force
    astern_N: Force
    astern_share: AsternShare = None


class PitchMap(SourcedTable, frozen=True, kw_only=True, tag="pitch", tag_field="kind"):
    """Propeller of controllable pitch (Voith-Schneider) at a speed that is set apart: force by the command in -1..1,
    bent by `curve`, and by the setting's power. Forces stand at `nominal_setting`, which is what counts where no log
    says what was set; `setting` is its name in logs (`setting_<name>`). Equations in `thrusters`.
    """

    setting: str
    nominal_setting: Annotated[float, msgspec.Meta(ge=1e-6, le=1e6)]
    exponent: Annotated[float, msgspec.Meta(ge=0, le=4)] = 2.0
    curve: Annotated[float, msgspec.Meta(ge=-1, le=1)] = 0.0
    ahead_N: Force
    astern_N: Force


ForceMap = RotorMap | LinearMap | PitchMap


class Wash(Table, frozen=True, kw_only=True):
    """The jet of thruster `ahead` takes `share` of the thrust of `behind` when it gives `at_N`; None: all it can."""

    behind: str
    ahead: str
    share: Annotated[float, msgspec.Meta(ge=0, le=1)]
    at_N: Force | None = None


class Propulsion(SourcedTable, frozen=True, kw_only=True):
    """Dynamics of all thrusters without their own: dead time from command to ESC, then a first-order lag on force.

    `rate_limit_N_s`: what control asks for at most; `slew_N_s`: what the thrusters can do (None: the lag alone).
    `advance_loss_s_m`, `advance_loss_sqrt_N_s_m`, `wash`: how water that moves past a thruster weakens it; equations
    in `companion.core.model.effects`.
    """

    dead_time_s: DeadTime
    lag_s: Lag
    nominal_voltage_V: Voltage
    rate_limit_N_s: ForceRate
    slew_N_s: ForceRate | None = None
    advance_loss_s_m: Annotated[float, msgspec.Meta(ge=-5, le=5)] = 0.0
    advance_loss_sqrt_N_s_m: Annotated[float, msgspec.Meta(ge=-5, le=5)] = 0.0
    wash: tuple[Wash, ...] = ()


class Thruster(SourcedTable, frozen=True, kw_only=True):
    """One thruster. `azimuth_deg`: direction of positive thrust, from x towards y; of one that is steered, at 1500 us.

    `gain`: 0 is a dead thruster, below 0 one that is wired or turned the wrong way round.
    `mirrored`: its pulses are mirrored about neutral, 1100 us is ahead; unlike with a gain of -1, the map's curve ahead
    stays that of its thrust ahead.
    `gain_sigma`: how well `gain` is known, as a share; None: as fits assume of thrusters of one make.
    `lag_s`, `dead_time_s`: its own; None: those of `propulsion`. `steering`: the servo that turns it; `rudder`: one in
    its race.
    """

    name: str
    x_m: Arm
    y_m: Arm
    azimuth_deg: Annotated[float, msgspec.Meta(ge=-360, le=360)]
    channel: RcChannel
    force_map: str
    gain: Annotated[float, msgspec.Meta(ge=-10, le=10)] = 1.0
    gain_sigma: Annotated[float, msgspec.Meta(ge=0, le=2)] | None = None
    trim_us: Trim = 0
    mirrored: bool = False
    pwm_min_us: Pulse = 1100
    pwm_max_us: Pulse = 1900
    force_min_N: Annotated[float, msgspec.Meta(ge=-50_000, le=0)]
    force_max_N: Force
    lag_s: Lag | None = None
    dead_time_s: DeadTime | None = None
    steering: Steering | None = None
    rudder: Rudder | None = None

    @property
    def most_N(self) -> float:
        """Largest force that it is asked for, either way."""
        return max(self.force_max_N, -self.force_min_N)

    @property
    def servos(self) -> tuple[Servo, ...]:
        """Its servo, if it has one."""
        return tuple(servo for servo in (self.steering, self.rudder) if servo is not None)


class ModelError(SourcedTable, frozen=True, kw_only=True):
    """What model and thrusters leave out, as one sigma of a slowly changing body force [N, N, N m]."""

    X_sigma_N: Annotated[float, msgspec.Meta(gt=0, le=1000)]
    Y_sigma_N: Annotated[float, msgspec.Meta(gt=0, le=1000)]
    N_sigma_N_m: Annotated[float, msgspec.Meta(gt=0, le=1000)]


class VesselFile(Table, frozen=True, kw_only=True):
    """One boat. `terms`: optional model terms by name with their parameters (`terms.REGISTRY`).

    `model_error`: how far the filter may trust the model; None: as its own tuning has it.
    """

    FILE: ClassVar = file_kinds.VESSEL
    format: Literal[1]
    name: str
    hull: Hull
    inertia: Inertia
    damping: Damping
    propulsion: Propulsion
    force_maps: dict[str, RotorMap | LinearMap | PitchMap]
    thrusters: Annotated[tuple[Thruster, ...], msgspec.Meta(min_length=1)]
    sensors: Sensors
    terms: dict[str, dict[str, float | str]] = msgspec.field(default_factory=dict)
    model_error: ModelError | None = None

    @property
    def settings(self) -> dict[str, float]:
        """Settings that the force maps name, each with its nominal value."""
        maps = [m for m in self.force_maps.values() if isinstance(m, PitchMap)]
        return {m.setting: m.nominal_setting for m in maps}

    @property
    def servos(self) -> tuple[Servo, ...]:
        """Servos of all thrusters, in their order."""
        return tuple(servo for t in self.thrusters for servo in t.servos)

    @property
    def controls(self) -> tuple[Thruster | Servo, ...]:
        """Everything that a pulse width commands, in the order used everywhere: all thrusters, then all servos."""
        return (*self.thrusters, *self.servos)

    @property
    def positions(self) -> np.ndarray:
        """Thruster places and azimuths, shape (n, 3): x [m], y [m], azimuth [rad]."""
        return np.array([(t.x_m, t.y_m, np.deg2rad(t.azimuth_deg)) for t in self.thrusters])
