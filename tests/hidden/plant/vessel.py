"""The vessel file as somebody believes it: written in and read from the TOML form of docs/vessel-file.md."""

from __future__ import annotations

import tomllib
from typing import Any

from tests.hidden.plant.world import Curve, Drive, Hull, Sense, Thruster, World

_HULL = {"length": "length_m", "beam": "beam_m", "draft": "draft_m", "frontal": "frontal_area_m2",
         "lateral": "lateral_area_m2"}  # fmt: skip
_INERTIA = {"m": "mass_kg", "I_z": "I_z_kg_m2", "x_g": "x_g_m", "y_g": "y_g_m", "X_udot": "X_udot_kg",
            "Y_vdot": "Y_vdot_kg", "Y_rdot": "Y_rdot_kg_m", "N_rdot": "N_rdot_kg_m2"}  # fmt: skip
_DAMPING = {"X_u": "X_u_N_s_m", "Y_v": "Y_v_N_s_m", "Y_r": "Y_r_N_s", "N_v": "N_v_N_s", "N_r": "N_r_N_m_s",
            "X_uu": "X_uu_N_s2_m2", "Y_vv": "Y_vv_N_s2_m2", "N_rr": "N_rr_N_m_s2"}  # fmt: skip
_IMU = {"imu_hz": "rate_Hz", "accel_sigma": "accel_sigma_m_s2", "gyro_sigma": "gyro_sigma_rad_s",
        "heading_sigma": "heading_sigma_rad", "wander": "heading_wander_sigma_rad",
        "wander_time": "heading_wander_time_s", "imu_x": "x_m", "imu_y": "y_m"}  # fmt: skip
_UWB = {"uwb_hz": "rate_Hz", "uwb_sigma": "range_sigma_m", "latency": "latency_s", "uwb_x": "x_m", "uwb_y": "y_m",
        "uwb_z": "z_m"}  # fmt: skip
_SOURCE = "as believed by whoever wrote this file: assumed"


def vessel_toml(world: World, name: str) -> str:
    """Text of a vessel file with the base numbers of `world`; effects are not in it."""
    h, d, s = world.hull, world.drive, world.sense
    maps = {"kind": "rotor", "dead_band_us": d.dead_band_us, "V_ref_V": d.V_ref, "k_ahead_N_s2": d.ahead.k,
            "k_astern_N_s2": d.astern.k}  # fmt: skip
    switch_on = {"z_m": -0.1, "accel_bias_sigma_m_s2": 0.008, "accel_bias_walk_m_s2_sqrt_s": 0.0001,
                 "gyro_bias_sigma_rad_s": 0.0006, "gyro_bias_walk_rad_s_sqrt_s": 0.000005}  # fmt: skip
    propulsion = {"dead_time_s": d.dead_time, "lag_s": d.lag, "nominal_voltage_V": d.V_nominal, "rate_limit_N_s": 120.0}
    parts = [
        _table("hull", _named(h, _HULL) | {"origin": "midships on the centreline at the waterline"}),
        _table("inertia", _named(h, _INERTIA)),
        _table("damping", _named(h, _DAMPING)),
        _table("propulsion", propulsion),
        _table("force_maps.t200", maps),
        _table("force_maps.t200.ahead", _curve(d.ahead), source=False),
        _table("force_maps.t200.astern", _curve(d.astern), source=False),
        *(_table("[thrusters]", _thruster(t)) for t in d.thrusters),
        _table("sensors.imu", _named(s, _IMU) | switch_on),
        _table("sensors.uwb", _named(s, _UWB) | {"range_bias_sigma_m": 0.02, "wire_format": "dwm1001-lec"}),
    ]
    return f'format = 1\nname = "{name}"\n\n' + "\n".join(parts)


def _given(table: dict[str, Any], keys: dict[str, str]) -> dict[str, Any]:
    return {field: float(table.get(key, 0.0)) for field, key in keys.items()}


def _named(part: Any, keys: dict[str, str]) -> dict[str, Any]:
    return {key: getattr(part, field) for field, key in keys.items()}


def _curve(c: Curve) -> dict[str, Any]:
    return {"a0": c.a0, "a1": c.a1, "q": c.q, "c1_rps": c.c1, "c2_rps": c.c2}


def _thruster(t: Thruster) -> dict[str, Any]:
    return {"name": t.name, "x_m": t.x, "y_m": t.y, "azimuth_deg": t.azimuth_deg, "channel": t.channel,
            "force_map": "t200", "gain": t.gain, "trim_us": round(t.trim_us), "force_min_N": -30.0,
            "force_max_N": 38.0}  # fmt: skip


def _table(name: str, values: dict[str, Any], *, source: bool = True) -> str:
    shown = values | ({"source": _SOURCE} if source else {})
    lines = [f"{k} = " + (f'"{v}"' if isinstance(v, str) else repr(v)) for k, v in shown.items()]
    return f"[{name}]\n" + "\n".join(lines) + "\n"


def read_vessel(text: str) -> World:
    """The base numbers of a vessel file with rotor maps, all thrusters on one map. Raises KeyError, TypeError."""
    t = tomllib.loads(text)
    hull = Hull(**_given(t["hull"], _HULL), **_given(t["inertia"], _INERTIA), **_given(t["damping"], _DAMPING))
    thrusters = [
        Thruster(str(x["name"]), float(x["x_m"]), float(x["y_m"]), float(x["azimuth_deg"]), int(x["channel"]),
                 float(x.get("gain", 1.0)), float(x.get("trim_us", 0.0)))
        for x in t["thrusters"]
    ]  # fmt: skip
    rotor, p = t["force_maps"][t["thrusters"][0]["force_map"]], t["propulsion"]
    drive = Drive(
        thrusters=thrusters,
        ahead=_read_curve(rotor, "ahead"),
        astern=_read_curve(rotor, "astern"),
        V_ref=float(rotor["V_ref_V"]),
        V_nominal=float(p["nominal_voltage_V"]),
        dead_band_us=float(rotor["dead_band_us"]),
        dead_time=float(p["dead_time_s"]),
        lag=float(p["lag_s"]),
        wire=list(range(len(thrusters))),
    )
    imu, uwb = t["sensors"]["imu"], t["sensors"]["uwb"]
    sense = Sense(**_given(imu, _IMU), **_given(uwb, _UWB))
    return World(hull, drive, sense)


def _read_curve(rotor: dict[str, Any], side: str) -> Curve:
    c = rotor[side]
    return Curve(float(rotor[f"k_{side}_N_s2"]), float(c["a0"]), float(c["a1"]), float(c["q"]),
                 float(c["c1_rps"]), float(c["c2_rps"]))  # fmt: skip
