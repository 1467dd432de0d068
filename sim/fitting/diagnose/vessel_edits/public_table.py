"""Table of public forms: for each family its public numbers, units, sentence. Used by `public_form`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from companion.core.model.effects.wind import RHO_AIR

DIRECTIONS = ("beta_c_deg", "beta_w_deg", "beta_wave_deg", "phase_deg")
"""Public names of directions: values from 0 to 360 deg, intervals may reach beyond."""
Numbers = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class LogReference:
    """Reference point of the fit's parameters: mean of all positions (2,) [m], middle of the shared clock [s]."""

    centre_m: np.ndarray
    middle_s: float


Form = Callable[[Numbers, LogReference], dict[str, np.ndarray]]


@dataclass(frozen=True)
class PublicEntry:
    """Public form of one family: units, format of its sentence, map of its values, map of its smallest size."""

    units: Mapping[str, str]
    says: str
    form: Form | None = None
    smallest: Callable[[float], float] = field(default=lambda size: size)
    smallest_unit: str = ""


def _direction(north: np.ndarray, east: np.ndarray) -> np.ndarray:
    return np.degrees(np.arctan2(east, north)) % 360


def _current(p: Numbers, _: LogReference) -> dict[str, np.ndarray]:
    north, east = p["north_m_s"], p["east_m_s"]
    return {"V_c_m_s": np.hypot(north, east), "beta_c_deg": _direction(north, east)}


def _turning(p: Numbers, place: LogReference) -> dict[str, np.ndarray]:
    """The fit's direction is that at the middle of the clock; the public one is that at its beginning."""
    now = _current(p, place)
    return now | {
        "beta_c_deg": (now["beta_c_deg"] - p["turn_deg_s"] * place.middle_s) % 360,
        "turn_deg_s": p["turn_deg_s"],
    }


def _wind(p: Numbers, _: LogReference) -> dict[str, np.ndarray]:
    north, east = p["north_Pa"], p["east_Pa"]
    return {"V_w_m_s": _wind_speed(np.hypot(north, east)), "beta_w_deg": _direction(-north, -east)}


def _wind_speed(pressure_Pa):
    return np.sqrt(2 * pressure_Pa / RHO_AIR)


def _tether(p: Numbers, place: LogReference) -> dict[str, np.ndarray]:
    k = np.maximum(p["k_N_m"], 1e-6)
    return {
        "k_N_m": p["k_N_m"],
        "anchor_north_m": place.centre_m[0] + p["north_N"] / k,
        "anchor_east_m": place.centre_m[1] + p["east_N"] / k,
        "x_t_m": p["arm_m"],
    }


def _zone(p: Numbers, _: LogReference) -> dict[str, np.ndarray]:
    return {"gain": 1 + p["share"], **{k: p[k] for k in ("north_m", "east_m", "radius_m")}}


def _iron(p: Numbers, _: LogReference) -> dict[str, np.ndarray]:
    """cos_deg cos psi + sin_deg sin psi = A sin(psi - phase)."""
    return {
        "amplitude_deg": np.hypot(p["cos_deg"], p["sin_deg"]),
        "phase_deg": _direction(p["sin_deg"], -p["cos_deg"]),
    }


def _gain(key: str, sign: float = 1.0, **others: str) -> Form:
    """`gain` = 1 + sign times the parameter `key`; `others`: public name = the fit's name."""
    return lambda p, _: {"gain": 1 + sign * p[key], **{public: p[own] for public, own in others.items()}}


def _renamed(**names: str) -> Form:
    return lambda p, _: {public: p[own] for public, own in names.items()}


PUBLIC: dict[str, PublicEntry] = {
    "current": PublicEntry(
        {"V_c_m_s": "m/s", "beta_c_deg": "deg"},
        "The water moves at {V_c_m_s}, towards {beta_c_deg} from north.",
        _current,
    ),
    "turning_current": PublicEntry(
        {"V_c_m_s": "m/s", "beta_c_deg": "deg", "turn_deg_s": "deg/s"},
        "The water moves at {V_c_m_s}; its direction was {beta_c_deg} from north at the beginning and turns by "
        "{turn_deg_s:clockwise/anticlockwise}.",
        _turning,
    ),
    "wind": PublicEntry(
        {"V_w_m_s": "m/s", "beta_w_deg": "deg"},
        "A wind of {V_w_m_s} blows from {beta_w_deg}, clockwise from north.",
        _wind,
        lambda size: float(_wind_speed(size)),
        "m/s",
    ),
    "tether": PublicEntry(
        {"k_N_m": "N/m", "anchor_north_m": "m", "anchor_east_m": "m", "x_t_m": "m"},
        "Something pulls the boat with {k_N_m} towards north {anchor_north_m}, east {anchor_east_m}.",
        _tether,
    ),
    "shallow_zone": PublicEntry(
        {"gain": "1", "north_m": "m", "east_m": "m", "radius_m": "m"},
        "Within {radius_m} of north {north_m}, east {east_m} the hull has {gain:gain| damping than the model}.",
        _zone,
    ),
    "thruster_gain": PublicEntry(
        {"gain": "1"}, "Thruster {name} gives {gain:gain| thrust than the model}.", _gain("gain")
    ),
    "swapped_pair": PublicEntry(
        {}, "Thrusters {both} have changed places: each gets the other's commands.", lambda p, _: {}, smallest_unit="1"
    ),
    "thruster_fouling": PublicEntry(
        {"gain": "1", "t_on_s": "s"},
        "Thruster {name} gives {gain:gain| thrust than the model} from "
        "{t_on_s:after/before| the first log's beginning} on.",
        _gain("gain", t_on_s="onset_s"),
    ),
    "common_loss": PublicEntry(
        {"gain": "1"},
        "All thrusters give {gain:gain| thrust than the model} (or it is all mass and damping: no log can tell).",
        _gain("loss", -1.0),
    ),
    "astern_asymmetry": PublicEntry(
        {"gain": "1"}, "Running astern, thrusters give {gain:gain| thrust than the model}.", _gain("share")
    ),
    "voltage_exponent": PublicEntry(
        {"exponent": "1"},
        "Thrust goes with the battery's voltage to a power that is {exponent:higher/lower| than the model's}.",
    ),
    "dead_band": PublicEntry(
        {"dead_band_us": "us"},
        "The band without thrust is {dead_band_us:wider/narrower| on each side of neutral}.",
        _renamed(dead_band_us="delta_us"),
    ),
    "lag": PublicEntry({"lag_s": "s"}, "The lag of the forces is {lag_s:longer/shorter| than in the model}."),
    "dead_time": PublicEntry(
        {"dead_time_s": "s"}, "Forces begin {dead_time_s:later/sooner| after a command than in the model}."
    ),
    "rate_limit": PublicEntry(
        {"rate_limit_N_s": "N/s"},
        "No thruster's force changes faster than {rate_limit_N_s}.",
        lambda p, _: {"rate_limit_N_s": 1 / np.maximum(p["slowness_s_N"], 1e-6)},
        lambda size: 1 / size,
        "N/s",
    ),
    "advance_loss": PublicEntry(
        {"loss_s_m": "s/m"},
        "Thrust falls with speed through the water: the share lost is {loss_s_m:larger/smaller| than the model's}.",
    ),
    "wash": PublicEntry(
        {"loss": "1"},
        "The thruster behind another loses {loss:%more/less| of its thrust than in the model} while that one pushes "
        "with 30 N.",
    ),
    "hull_fouling": PublicEntry({"gain": "1"}, "The hull has {gain:gain| damping than the model}.", _gain("share")),
    "payload": PublicEntry({"mass_kg": "kg"}, "The boat is {mass_kg:heavier/lighter| than the model}."),
    "added_mass": PublicEntry(
        {"gain": "1"}, "Added mass in surge and sway is {gain:gain| than in the model}.", _gain("share")
    ),
    "yaw_inertia": PublicEntry(
        {"I_z_kg_m2": "kg m2"}, "The moment of inertia in yaw is {I_z_kg_m2:larger/smaller| than the model's}."
    ),
    "cg_shift": PublicEntry(
        {"x_g_m": "m", "y_g_m": "m"},
        "The centre of gravity lies {x_g_m:further forward/further aft} and {y_g_m:further to "
        "starboard/further to port}.",
    ),
    "cross_flow": PublicEntry(
        {"C_d": "1"}, "Cross-flow drag has a C_d that is {C_d:larger/smaller| than the model's}."
    ),
    "yaw_sway_coupling": PublicEntry(
        {"Y_r_N_s": "N s", "N_v_N_s": "N s"},
        "Yaw and sway are coupled otherwise than in the model: Y_r differs by {Y_r_N_s}, N_v by {N_v_N_s}.",
    ),
    "munk_moment": PublicEntry(
        {"N_uv_kg": "kg"},
        "Drifting at speed turns the boat by a Munk moment that is {N_uv_kg:larger/smaller| than the model's}.",
    ),
    "accel_bias": PublicEntry(
        {"b_x_m_s2": "m/s^2", "b_y_m_s2": "m/s^2"},
        "The accelerometers read {b_x_m_s2:too much/too little} ahead and {b_y_m_s2:too much/too little} to "
        "starboard (or the mounting is tilted: "
        "no log can tell).",
    ),
    "gyro_bias": PublicEntry({"b_r_rad_s": "rad/s"}, "The yaw gyro reads {b_r_rad_s:too high/too low}, always."),
    "gyro_scale": PublicEntry({"scale": "1"}, "The yaw gyro reads {scale:%too much/too little| of the yaw rate}."),
    "imu_misalignment": PublicEntry(
        {"yaw_deg": "deg"}, "The accelerometers are turned by {yaw_deg:clockwise/anticlockwise}."
    ),
    "imu_lever_arm": PublicEntry(
        {"x_m": "m", "y_m": "m"},
        "The IMU sits {x_m:further forward/further aft} and {y_m:further to starboard/further to port}.",
    ),
    "heading_offset": PublicEntry(
        {"offset_deg": "deg"},
        "The heading reads {offset_deg:too high/too low} (or the UWB frame is turned: no log can tell).",
    ),
    "hard_iron": PublicEntry(
        {"amplitude_deg": "deg", "phase_deg": "deg"},
        "The compass error goes with the heading: {amplitude_deg}, zero at {phase_deg}.",
        _iron,
    ),
    "uwb_latency": PublicEntry({"latency_s": "s"}, "Positions are {latency_s:older/younger| than the model has it}."),
    "clock_drift": PublicEntry(
        {"drift": "1"},
        "The clock of the positions drifts: they come {drift:s later/s earlier| with every second of the log}.",
        _renamed(drift="drift"),
    ),
    "uwb_lever_arm": PublicEntry(
        {"x_m": "m", "y_m": "m"},
        "The UWB tag sits {x_m:further forward/further aft} and {y_m:further to starboard/further to port}.",
    ),
    "gnss_latency": PublicEntry({"latency_s": "s"}, "Positions are {latency_s:older/younger| than the model has it}."),
    "gnss_lever_arm": PublicEntry(
        {"x_m": "m", "y_m": "m"},
        "The GNSS antenna sits {x_m:further forward/further aft} and {y_m:further to starboard/further to port}.",
    ),
    "uwb_scale": PublicEntry({"scale": "1"}, "UWB distances are {scale:%too long/too short}."),
    "waves": PublicEntry(
        {"F_w_N": "N", "T_p_s": "s", "beta_wave_deg": "deg"},
        "Waves rock the boat: {F_w_N} rms with a period of {T_p_s}, from {beta_wave_deg}, clockwise from north.",
    ),
    "gusty_wind": PublicEntry(
        {"V_w_m_s": "m/s", "beta_w_deg": "deg", "gustiness": "1", "gust_time_s": "s"},
        "A wind of {V_w_m_s} blows from {beta_w_deg}, clockwise from north, in gusts of {gustiness:%} that last "
        "{gust_time_s}.",
    ),
    "nlos": PublicEntry(
        {"share": "1", "extra_m": "m", "anchor": "1"},
        "{share:%} of positions lie too far from one anchor, by {extra_m} in the mean, as if it were out of sight.",
    ),
}
"""By family. Names, units and signs: docs/diagnose.md."""
