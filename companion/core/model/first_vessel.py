"""A first vessel file from what anybody can say of a boat: size, mass, layout, thrusters, sensor of positions.

Hulls of length L, beam b and draft T carry the mass: m = rho C_B L b T for each. T from m, or m from T = 0.4 b.

    X_udot = -2.7 rho V^(5/3) / L^2 for each hull of volume V                       Soeding (1982), Fossen 2021
    Y_vdot = -a22 L,  N_rdot = -a22 L^3 / 12,  a22 = pi rho T^2 / 2 for each hull    strip theory: half an ellipse
    X_uu = -rho S C / 2,  Y_vv = -rho C_D T L / 2,  N_rr = -rho C_D T L^4 / 64        cross-flow drag, C_D = 1
    X_u = -M11 / T_u,  Y_v = -M22 / T_v,  N_r = -M33 / T_r                           time constants, Fossen 2021

Fossen 2021: Handbook of Marine Craft Hydrodynamics and Motion Control, 2nd edition, and its MSS toolbox (`otter.m`).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sqrt

from companion.core.configuration.sensors import Gnss, Imu, Sensors, Uwb
from companion.core.configuration.tables import ConfigError
from companion.core.configuration.vessel_file import (
    Damping,
    ForceMap,
    Hull,
    Inertia,
    LinearMap,
    Propulsion,
    Thruster,
    VesselFile,
)

RHO_KG_M3 = 1000.0
BLOCK, DRAFT_OF_BEAM = 0.6, 0.4
"""Block coefficient of a hull; its draft over its own beam where the mass is guessed. Assumed: as of `aritra.toml`."""
CATAMARAN = 0.5
"""Beam over length from which a boat is taken for two hulls: assumed."""
GYRATION = 0.25
"""Radius of gyration in yaw over length (Fossen 2021, MSS `otter.m`)."""
HULLS_SEEN = {1: 1.0, 2: 1.5}
"""Hulls that cross-flow meets: of two, one is half shielded; assumed."""
SURGE_C = 0.02
"""Resistance over rho / 2 wetted area U^2: friction (ITTC-57 at 1 m/s) four times, for waves and brackets; assumed."""
TIME_FROUDE = (35.0, 12.0, 11.0)
"""Time constants of surge, sway and yaw over sqrt(L / g): those of `aritra.toml`; assumed."""
G_M_S2 = 9.81
ASTERN = 0.75
"""Thrust astern over thrust ahead where only one force is known: a T200's, rounded."""
LAYOUTS = ("differential", "x", "bow")
"""Two thrusters astern; four at 45 degrees; two astern and one across the bow."""


@dataclass(frozen=True)
class Answers:
    """What was said of the boat. `mass_kg` None: guessed. `force_N` None: T200 thrusters, else the most of each."""

    length_m: float
    beam_m: float
    mass_kg: float | None
    layout: str
    force_N: float | None
    position: str  # "uwb" or "gnss"


def first_vessel(said: Answers, name: str, t200: ForceMap) -> VesselFile:
    """The vessel file. Raises ConfigError where so heavy a boat of that size does not float."""
    hulls, beam = _hulls(said)
    length, width = said.length_m, hulls * beam
    mass = said.mass_kg or float(f"{RHO_KG_M3 * BLOCK * length * width * DRAFT_OF_BEAM * beam:.2g}")
    draft = mass / (RHO_KG_M3 * BLOCK * length * width)
    if not 0.02 * beam <= draft <= 1.5 * beam:
        size = f"{hulls} hull{'s' * (hulls - 1)} of {length:g} x {beam:.2g} m"
        raise ConfigError(f"mass: {mass:g} kg on {size} would lie {draft:.2g} m deep; look at mass (kg) and size (m)")
    inertia = _inertia(said, mass, draft, hulls)
    return VesselFile(
        format=1,
        name=name,
        hull=_hull(said, draft, hulls, beam),
        inertia=inertia,
        damping=_damping(inertia, length, draft, hulls, beam),
        propulsion=_propulsion(said.force_N),
        force_maps={"t200": t200} if said.force_N is None else {"thruster": _linear(said.force_N)},
        thrusters=tuple(_thrusters(said, beam)),
        sensors=_sensors(said),
    )


def _hulls(said: Answers) -> tuple[int, float]:
    """How many hulls, and the beam of one [m]: a third of the boat's, a fifth of its length at most."""
    if said.beam_m < CATAMARAN * said.length_m:
        return 1, said.beam_m
    return 2, min(said.beam_m / 3, said.length_m / 5)


def _hull(said: Answers, draft: float, hulls: int, beam: float) -> Hull:
    length = said.length_m
    form = f"{hulls} hull{'s' * (hulls - 1)} of {beam:.2g} m beam"
    return Hull(
        length_m=length,
        beam_m=said.beam_m,
        draft_m=_round(draft),
        origin="midships on the centreline at the waterline",
        frontal_area_m2=_round(0.11 * length * said.beam_m),
        lateral_area_m2=_round(0.13 * length**2),
        source=f"length, beam: given; {form}, draft from the mass with block coefficient {BLOCK}, areas: assumed",
    )


def _inertia(said: Answers, mass: float, draft: float, hulls: int) -> Inertia:
    length = said.length_m
    volume = mass / RHO_KG_M3 / hulls
    section = hulls * 0.5 * pi * RHO_KG_M3 * draft**2
    weighed = (
        "given" if said.mass_kg else f"guessed from length and beam, draft {DRAFT_OF_BEAM} of a hull's beam: assumed"
    )
    return Inertia(
        mass_kg=mass,
        I_z_kg_m2=_round(mass * (GYRATION * length) ** 2),
        X_udot_kg=-_round(hulls * 2.7 * RHO_KG_M3 * volume ** (5 / 3) / length**2),
        Y_vdot_kg=-_round(section * length),
        N_rdot_kg_m2=-_round(section * length**3 / 12),
        source=f"mass: {weighed}; radius of gyration {GYRATION} L and added mass in surge after Soeding: Fossen 2021; "
        "added mass in sway and yaw: strip theory, half an ellipse; centre of gravity midships: assumed",
    )


def _damping(inertia: Inertia, length: float, draft: float, hulls: int, beam: float) -> Damping:
    M = (
        inertia.mass_kg - inertia.X_udot_kg,
        inertia.mass_kg - inertia.Y_vdot_kg,
        inertia.I_z_kg_m2 - inertia.N_rdot_kg_m2,
    )
    linear = [_round(m / time_s) for m, time_s in zip(M, time_constants_s(length), strict=True)]
    wetted = hulls * length * (2 * draft + 0.8 * beam)
    sway, yaw = cross_flow(length, draft * HULLS_SEEN[hulls])
    return Damping(
        X_u_N_s_m=-linear[0],
        Y_v_N_s_m=-linear[1],
        N_r_N_m_s=-linear[2],
        X_uu_N_s2_m2=-_round(surge_drag(wetted)),
        Y_vv_N_s2_m2=-_round(sway),
        N_rr_N_m_s2=-_round(yaw),
        source="quadratic in sway and yaw: cross-flow drag, C_D = 1 (Fossen 2021); linear: time constants of "
        f"{TIME_FROUDE} sqrt(L / g), surge: {SURGE_C} of the wetted area, no coupling: assumed",
    )


def time_constants_s(length_m: float) -> tuple[float, float, float]:
    """T_u, T_v, T_r of a hull of this length."""
    surge, sway, yaw = (time * sqrt(length_m / G_M_S2) for time in TIME_FROUDE)
    return surge, sway, yaw


def surge_drag(wetted_m2: float) -> float:
    """-X_uu of a wetted area."""
    return 0.5 * RHO_KG_M3 * wetted_m2 * SURGE_C


def cross_flow(length_m: float, draft_m: float) -> tuple[float, float]:
    """-Y_vv and -N_rr of a hull; `draft_m`: as deep as cross-flow meets it."""
    across = 0.5 * RHO_KG_M3 * draft_m
    return across * length_m, across * length_m**4 / 32


def _propulsion(force_N: float | None) -> Propulsion:
    return Propulsion(
        dead_time_s=0.1,
        lag_s=0.1,
        nominal_voltage_V=15.0,
        rate_limit_N_s=120.0 if force_N is None else _round(3 * force_N),
        source="dead time and lag about 0.1 s each: observed on T200 with Basic ESC; voltage and rate limit: assumed",
    )


def _linear(force_N: float) -> LinearMap:
    return LinearMap(
        ahead_N=force_N,
        astern_N=_round(ASTERN * force_N),
        source=f"most thrust ahead: given; {ASTERN} of it astern, in proportion to the pulse: assumed",
    )


def _thrusters(said: Answers, beam: float) -> list[Thruster]:
    """In the order of their channels, from 9 on."""
    x, y = 0.4 * said.length_m, (said.beam_m - beam) / 2
    if beam == said.beam_m:
        y = 0.35 * said.beam_m
    astern = [("port", -x, -y, 0.0), ("starboard", -x, y, 0.0)]
    x4 = 0.3 * said.length_m
    places = {
        "differential": astern,
        "bow": [*astern, ("bow", x, 0.0, 90.0)],
        "x": [("front_port", x4, -y, 45.0), ("front_starboard", x4, y, -45.0),
              ("rear_port", -x4, -y, -45.0), ("rear_starboard", -x4, y, 45.0)],
    }[said.layout]  # fmt: skip
    low, high = (-30.0, 38.0) if said.force_N is None else (-_round(ASTERN * said.force_N), said.force_N)
    limits = "T200 table at 13 V" if said.force_N is None else "as the map"
    return [
        Thruster(
            name=name,
            x_m=_round(x_m),
            y_m=_round(y_m),
            azimuth_deg=azimuth,
            channel=9 + i,
            force_map="t200" if said.force_N is None else "thruster",
            force_min_N=low,
            force_max_N=high,
            source=f"layout: given; place: assumed, measure it; limits: {limits}",
        )
        for i, (name, x_m, y_m, azimuth) in enumerate(places)
    ]


def _sensors(said: Answers) -> Sensors:
    imu = Imu(
        rate_Hz=50.0,
        accel_sigma_m_s2=0.05,
        accel_bias_sigma_m_s2=0.05,
        accel_bias_walk_m_s2_sqrt_s=0.0005,
        gyro_sigma_rad_s=0.005,
        gyro_bias_sigma_rad_s=0.003,
        gyro_bias_walk_rad_s_sqrt_s=0.00002,
        heading_sigma_rad=0.005,
        heading_wander_sigma_rad=0.012,
        heading_wander_time_s=60.0,
        source="assumed: MEMS IMU of an autopilot, thrusters running; heading of a calibrated compass; place: assumed",
    )
    if said.position == "gnss":
        source = "assumed: a receiver without corrections, over minutes; delay of one fix at 5 Hz; place: assumed"
        gnss = Gnss(rate_Hz=5.0, position_sigma_m=0.5, latency_s=0.2, source=source)
        return Sensors(imu=imu, gnss=gnss)
    uwb = Uwb(
        rate_Hz=1.0,
        range_sigma_m=0.1,
        range_bias_sigma_m=0.02,
        latency_s=0.08,
        wire_format="dwm1001-lec",
        source="as of aritra.toml: assumed; place: assumed, measure it; wire format: look at the tag",
    )
    return Sensors(imu=imu, uwb=uwb)


def _round(value: float) -> float:
    """`value` to three significant digits."""
    return float(f"{value:.3g}")
