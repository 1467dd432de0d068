"""Edits of a vessel file: one function for each family of effects, from the file without it to the file with it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from msgspec.structs import replace

from companion.core.configuration.vessel_file import Thruster, VesselFile, Wash
from companion.core.model.loads import RHO_AIR, values
from companion.core.model.sensor_errors import apply_imu_errors
from sim.fitting.diagnose.catalogue.effect import Effect
from sim.fitting.diagnose.catalogue.hull import RHO_WATER
from sim.fitting.diagnose.catalogue.propulsion import WASH_N
from sim.fitting.diagnose.vessel_edits.public_form import family
from sim.fitting.wiring.thrusters import append_note, exchanged

MOST_LATENCY_S = 1.0


class NotInVesselFileError(ValueError):
    """The vessel file has no key for this effect; the message says why."""


@dataclass(frozen=True)
class CauseValues:
    """An effect with its values.

    engine      the fit's values by parameter name, origin added
    public      values by public name, as in findings
    note        text for `source` of the tables that it changes
    forces_n    (k, n) thruster forces of the logs [N]
    """

    effect: Effect
    engine: Mapping[str, float]
    public: Mapping[str, float]
    note: str
    forces_n: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def kind(self) -> str:
        """Name of the effect without its thruster; `base` for effects that are never named."""
        return "base" if self.effect.family == "base" else family(self.effect.name)

    @property
    def tail(self) -> str:
        """The thruster or pair in the effect's name."""
        return self.effect.name.partition(":")[2]


def _thrusters(vessel: VesselFile, edit: Callable[[Thruster], Thruster]) -> VesselFile:
    return replace(vessel, thrusters=tuple(edit(t) for t in vessel.thrusters))


def _gain(vessel: VesselFile, cause: CauseValues, name: str | None) -> VesselFile:
    """Gain of the thruster `name`, or of all (None)."""
    share = cause.public["gain"]
    return _thrusters(
        vessel,
        lambda t: (
            replace(t, gain=t.gain * share, source=append_note(t.source, cause.note)) if name in (None, t.name) else t
        ),
    )


def _swapped(vessel: VesselFile, cause: CauseValues) -> VesselFile:
    """The command of thruster A drives the thruster at B's place, and the reverse."""
    one, other = cause.tail.split("+")
    return exchanged(vessel, {one: other, other: one}, cause.note)


def _inertia(key: str) -> Callable[[VesselFile, CauseValues], VesselFile]:
    def place(vessel: VesselFile, cause: CauseValues) -> VesselFile:
        i = vessel.inertia
        return replace(vessel, inertia=replace(i, **{key: getattr(i, key) + cause.public[key]},
                                               source=append_note(i.source, cause.note)))  # fmt: skip

    return place


def _cg(vessel: VesselFile, cause: CauseValues) -> VesselFile:
    i, p = vessel.inertia, cause.public
    moved = replace(i, x_g_m=i.x_g_m + p["x_g_m"], y_g_m=i.y_g_m + p["y_g_m"], source=append_note(i.source, cause.note))
    return replace(vessel, inertia=moved)


def _sensor(table: str, scale: float = 1.0, /, **keys: str) -> Callable[[VesselFile, CauseValues], VesselFile]:
    """Public numbers times `scale` added to keys of a table of `[sensors]`: key = public name."""

    def place(vessel: VesselFile, cause: CauseValues) -> VesselFile:
        now = getattr(vessel.sensors, table)
        moved = {key: getattr(now, key) + scale * cause.public[public] for key, public in keys.items()}
        if "latency_s" in moved:
            moved["latency_s"] = float(np.clip(moved["latency_s"], 0.0, MOST_LATENCY_S))
        return _sensed(vessel, cause, table, **moved)

    return place


def _sensed(vessel: VesselFile, cause: CauseValues, table: str, **keys: float) -> VesselFile:
    now = getattr(vessel.sensors, table)
    new = replace(now, **keys, source=append_note(now.source, cause.note))
    return replace(vessel, sensors=replace(vessel.sensors, **{table: new}))


def _accel_bias(vessel: VesselFile, cause: CauseValues) -> VesselFile:
    """Bias in body axes, turned into the axes of the IMU, which the file uses."""
    x, y, _ = apply_imu_errors(vessel.sensors.imu, cause.public["b_x_m_s2"], cause.public["b_y_m_s2"], 0.0)
    return _sensed(vessel, cause, "imu", accel_bias_x_m_s2=float(x), accel_bias_y_m_s2=float(y))


def _iron(vessel: VesselFile, cause: CauseValues) -> VesselFile:
    imu = vessel.sensors.imu
    more = {f"hard_iron_{k}_rad": getattr(imu, f"hard_iron_{k}_rad") + float(np.radians(cause.engine[f"{k}_deg"]))
            for k in ("cos", "sin")}  # fmt: skip
    return _sensed(vessel, cause, "imu", **more)


def _propulsion(vessel: VesselFile, cause: CauseValues, **keys: object) -> VesselFile:
    p = vessel.propulsion
    return replace(vessel, propulsion=replace(p, **keys, source=append_note(p.source, cause.note)))


def _slew(vessel: VesselFile, cause: CauseValues) -> VesselFile:
    """Rate limit, in place of the file's, which is part of the public value."""
    return _propulsion(vessel, cause, slew_N_s=cause.public["rate_limit_N_s"])


def _advance(vessel: VesselFile, cause: CauseValues) -> VesselFile:
    """k sqrt|f| u of the file for loss |f| u: k = loss sum |f|^1.5 / sum |f|, least squares over the logs' forces."""
    f = np.abs(cause.forces_n)
    if not f.any():
        raise NotInVesselFileError("no thrust in the logs to compare with")
    k = cause.public["loss_s_m"] * float((f**1.5).sum() / f.sum())
    return _propulsion(vessel, cause, advance_loss_sqrt_N_s_m=vessel.propulsion.advance_loss_sqrt_N_s_m + k)


def _wash(vessel: VesselFile, cause: CauseValues) -> VesselFile:
    """Wash of each pair one behind the other on a side, added to the shares of the file."""
    shares = {(w.behind, w.ahead): w.share for w in vessel.propulsion.wash}
    blown = False
    for ahead in vessel.thrusters:
        for behind in vessel.thrusters:
            if ahead.x_m > behind.x_m and np.sign(ahead.y_m) == np.sign(behind.y_m):
                share = cause.public["loss"] * max(ahead.force_max_N, -ahead.force_min_N) / WASH_N
                pair, blown = (behind.name, ahead.name), True
                shares[pair] = shares.get(pair, 0.0) + share
    if not blown or min(shares.values()) < 0:
        raise NotInVesselFileError("no thruster lies in another's jet, or the loss is negative")
    return _propulsion(vessel, cause, wash=tuple(Wash(behind=b, ahead=a, share=s) for (b, a), s in shares.items()))


def _cross_flow(vessel: VesselFile, cause: CauseValues) -> VesselFile:
    """Strips in pure sway and in pure yaw as Y_vv and N_rr; their interaction has no key in the file."""
    h, d = vessel.hull, vessel.damping
    per_m = RHO_WATER / 2 * cause.public["C_d"] * 1.5 * h.draft_m
    more = {
        "Y_vv_N_s2_m2": d.Y_vv_N_s2_m2 - per_m * h.length_m,
        "N_rr_N_m_s2": d.N_rr_N_m_s2 - per_m * h.length_m**4 / 32,
    }
    return replace(vessel, damping=replace(d, **more, source=append_note(d.source, cause.note)))


def _term(vessel: VesselFile, name: str, cause: CauseValues, **numbers: float) -> VesselFile:
    table = {k: float(v) for k, v in numbers.items()} | {"source": cause.note}
    return replace(vessel, terms=vessel.terms | {name: table})


def _current(vessel: VesselFile, cause: CauseValues) -> VesselFile:
    """Current added as a vector to that of the file."""
    now = values("current", vessel.terms.get("current", {}))
    angle = np.radians(now["beta_c_deg"])
    north, east = (
        now["V_c_m_s"] * f(angle) + cause.engine[k] for f, k in ((np.cos, "north_m_s"), (np.sin, "east_m_s"))
    )
    return _term(
        vessel, "current", cause, V_c_m_s=np.hypot(north, east), beta_c_deg=np.degrees(np.arctan2(east, north))
    )


def _wind(vessel: VesselFile, cause: CauseValues) -> VesselFile:
    """Wind added to that of the file by vectors of dynamic pressure, which is right for light winds."""
    now = values("wind", vessel.terms.get("wind", {}))
    angle = np.radians(now["beta_w_deg"])
    pressure = RHO_AIR / 2 * now["V_w_m_s"] ** 2
    north, east = (-pressure * f(angle) + cause.engine[k] for f, k in ((np.cos, "north_Pa"), (np.sin, "east_Pa")))
    speed = float(np.sqrt(2 * np.hypot(north, east) / RHO_AIR))
    own = {k: now[k] for k in ("c_x", "c_y", "c_n")}
    return _term(vessel, "wind", cause, V_w_m_s=speed, beta_w_deg=np.degrees(np.arctan2(-east, -north)), **own)


def _gusty(vessel: VesselFile, cause: CauseValues) -> VesselFile:
    """The steady wind of the same mean force; gusts have no key in the file."""
    p = cause.public
    pressure, angle = RHO_AIR / 2 * p["V_w_m_s"] ** 2 * (1 + p["gustiness"] ** 2), np.radians(p["beta_w_deg"])
    own = {"north_Pa": -pressure * np.cos(angle), "east_Pa": -pressure * np.sin(angle)}
    return _wind(vessel, CauseValues(cause.effect, own, p, cause.note))


def _tether(vessel: VesselFile, cause: CauseValues) -> VesselFile:
    """Tether at the body origin; the moment of a line fastened elsewhere has no key in the file.

    Two springs without slack act as one of k = k_1 + k_2 anchored at the weighted mean of their anchors.
    """
    p, now = cause.public, values("tether", vessel.terms.get("tether", {}))
    k = now["stiffness_N_m"] + p["k_N_m"]
    if now["stiffness_N_m"] and now["slack_m"]:
        raise NotInVesselFileError("the file has a tether with slack already")
    share = p["k_N_m"] / k if now["stiffness_N_m"] else 1.0
    place = {f"{at}_m": (1 - share) * now[f"{at}_m"] + share * p[f"anchor_{at}_m"] for at in ("north", "east")}
    return _term(vessel, "tether", cause, **place, stiffness_N_m=k)


def _zone(vessel: VesselFile, cause: CauseValues) -> VesselFile:
    p = cause.public
    if values("shallow_zone", vessel.terms.get("shallow_zone", {}))["share"]:
        raise NotInVesselFileError("the file has a shallow zone already")
    where = {k: p[k] for k in ("north_m", "east_m")}
    return _term(vessel, "shallow_zone", cause, **where, radius_m=max(p["radius_m"], 0.01), share=p["gain"] - 1)


def _munk(vessel: VesselFile, cause: CauseValues) -> VesselFile:
    now = values("munk_moment", vessel.terms.get("munk_moment", {}))
    return _term(vessel, "munk_moment", cause, k_kg=now["k_kg"] + cause.public["N_uv_kg"])


RAD = float(np.pi / 180)
EDITS: dict[str, Callable[[VesselFile, CauseValues], VesselFile]] = {
    "current": _current,
    "wind": _wind,
    "gusty_wind": _gusty,
    "tether": _tether,
    "shallow_zone": _zone,
    "thruster_gain": lambda vessel, cause: _gain(vessel, cause, cause.tail),
    "thruster_fouling": lambda vessel, cause: _gain(vessel, cause, cause.tail),
    "common_loss": lambda vessel, cause: _gain(vessel, cause, None),
    "swapped_pair": _swapped,
    "rate_limit": _slew,
    "advance_loss": _advance,
    "wash": _wash,
    "payload": _inertia("mass_kg"),
    "yaw_inertia": _inertia("I_z_kg_m2"),
    "cg_shift": _cg,
    "cross_flow": _cross_flow,
    "munk_moment": _munk,
    "accel_bias": _accel_bias,
    "gyro_bias": _sensor("imu", gyro_bias_rad_s="b_r_rad_s"),
    "gyro_scale": _sensor("imu", gyro_scale="scale"),
    "heading_offset": _sensor("imu", RAD, heading_offset_rad="offset_deg"),
    "hard_iron": _iron,
    "imu_misalignment": _sensor("imu", RAD, misalignment_rad="yaw_deg"),
    "imu_lever_arm": _sensor("imu", x_m="x_m", y_m="y_m"),
    "uwb_latency": _sensor("uwb", latency_s="latency_s"),
    "uwb_lever_arm": _sensor("uwb", x_m="x_m", y_m="y_m"),
    "gnss_latency": _sensor("gnss", latency_s="latency_s"),
    "gnss_lever_arm": _sensor("gnss", x_m="x_m", y_m="y_m"),
    "uwb_scale": _sensor("uwb", scale="scale"),
    "clock_drift": _sensor("uwb", clock_drift_s_s="drift"),
}
"""By family. Other effects are written by their hook (hull coefficients, force maps), or have no key."""
