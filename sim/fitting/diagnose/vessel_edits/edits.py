"""Edits of a vessel file: one function for each family of effects, from the file without it to the file with it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace

from companion.core.configuration.vessel_file import Thruster, VesselFile, Wash
from companion.core.model.effects.current import water_velocity
from companion.core.model.effects.wash import jets
from companion.core.model.effects.wind import RHO_AIR, steady_speed
from companion.core.model.loads import values
from companion.core.model.sensor_errors import apply_imu_errors
from sim.fitting.diagnose.catalogue.effect import Effect
from sim.fitting.diagnose.catalogue.environment import LEAST_RADIUS_M, beside_file
from sim.fitting.diagnose.catalogue.propulsion import WASH_N, washed_pairs
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
    """

    effect: Effect
    engine: Mapping[str, float]
    public: Mapping[str, float]
    note: str

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


def _sensed(vessel: VesselFile, cause: CauseValues, table: str, **keys: float | str) -> VesselFile:
    now = getattr(vessel.sensors, table)
    new = replace(now, **keys, source=append_note(now.source, cause.note))
    return replace(vessel, sensors=replace(vessel.sensors, **{table: new}))


def _nlos(vessel: VesselFile, cause: CauseValues) -> VesselFile:
    """One anchor out of sight, which a file has one of."""
    p, now = cause.public, vessel.sensors.tag
    if now.nlos_share:
        raise NotInVesselFileError("the file has an anchor out of sight already")
    keys = {"nlos_share": p["share"], "nlos_extra_m": p["extra_m"], "nlos_anchor": f"{p['anchor']:.0f}"}
    return _sensed(vessel, cause, "uwb", **keys)


def _bias(vessel: VesselFile, cause: CauseValues) -> VesselFile:
    """Biases of what the file's errors leave, in body axes; a file has them in the axes and the scale of the IMU."""
    p = {"b_x_m_s2": 0.0, "b_y_m_s2": 0.0, "b_r_rad_s": 0.0} | dict(cause.public)
    x, y, r = apply_imu_errors(vessel.sensors.imu, *p.values())
    keys = {"accel_bias_x_m_s2": x, "accel_bias_y_m_s2": y, "gyro_bias_rad_s": r}
    return _sensed(vessel, cause, "imu", **{k: float(v) for k, v in keys.items()})


def _scale(table: str, key: str) -> Callable[[VesselFile, CauseValues], VesselFile]:
    """A scale times the one that the file knows of."""

    def place(vessel: VesselFile, cause: CauseValues) -> VesselFile:
        now = getattr(getattr(vessel.sensors, table), key)
        return _sensed(vessel, cause, table, **{key: (1 + now) * (1 + cause.public["scale"]) - 1})

    return place


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
    return _propulsion(vessel, cause, advance_loss_s_m=vessel.propulsion.advance_loss_s_m + cause.public["loss_s_m"])


def _wash(vessel: VesselFile, cause: CauseValues) -> VesselFile:
    """Wash of each pair in line on one side, added to the share of the file."""
    names, loss = [t.name for t in vessel.thrusters], cause.public["loss"]
    blowing = {(w.behind, w.ahead): w for w in vessel.propulsion.wash}
    known = {(names[jet.behind], names[jet.ahead]): jet.per_N for jet in jets(vessel)}
    for behind, ahead, _ in washed_pairs(vessel):
        pair = names[behind], names[ahead]
        share = loss + WASH_N * known.get(pair, 0.0)
        blowing[pair] = Wash(behind=pair[0], ahead=pair[1], share=share, at_N=WASH_N)
    if any(w.share < 0 for w in blowing.values()):
        raise NotInVesselFileError("a jet that adds to the thrust of another")
    return _propulsion(vessel, cause, wash=tuple(blowing.values()))


def _term(vessel: VesselFile, name: str, cause: CauseValues, **numbers: float) -> VesselFile:
    """The term `name` of the file with these of its parameters."""
    table = values(name, vessel.terms.get(name, {})) | {k: float(v) for k, v in numbers.items()}
    return replace(vessel, terms=vessel.terms | {name: table | {"source": cause.note}})


def _added(name: str, key: str, public: str) -> Callable[[VesselFile, CauseValues], VesselFile]:
    """The public number `public` added to the parameter `key` of the term `name`."""

    def place(vessel: VesselFile, cause: CauseValues) -> VesselFile:
        now = values(name, vessel.terms.get(name, {}))[key]
        return _term(vessel, name, cause, **{key: now + cause.public[public]})

    return place


def _new(name: str, size: str, **keys: str | float) -> Callable[[VesselFile, CauseValues], VesselFile]:
    """A term of which a file has one at most: key = public name, or a number. `size`: 0 where the file has none."""

    def place(vessel: VesselFile, cause: CauseValues) -> VesselFile:
        if values(name, vessel.terms.get(name, {}))[size]:
            raise NotInVesselFileError(
                f"the file has {'' if name == 'waves' else 'a '}{name.replace('_', ' ')} already"
            )
        numbers = {k: cause.public[v] if isinstance(v, str) else v for k, v in keys.items()}
        return _term(vessel, name, cause, **numbers)

    return place


def _current(vessel: VesselFile, cause: CauseValues) -> VesselFile:
    """A steady current added as a vector to that of the file."""
    now = values("current", vessel.terms.get("current", {}))
    if now["turn_deg_s"] and now["V_c_m_s"]:
        raise NotInVesselFileError("the file has a current that turns already")
    north, east = (a + cause.engine[k] for a, k in zip(water_velocity(now), ("north_m_s", "east_m_s"), strict=True))
    direction = np.degrees(np.arctan2(east, north))
    return _term(vessel, "current", cause, V_c_m_s=np.hypot(north, east), beta_c_deg=direction, turn_deg_s=0.0)


def _wind(vessel: VesselFile, cause: CauseValues, **gusts: float) -> VesselFile:
    """Wind added to that of the file by vectors of dynamic pressure, as in the fit."""
    speed, direction = beside_file(vessel, cause.engine["north_Pa"], cause.engine["east_Pa"])
    gustiness = (gusts or values("wind", vessel.terms.get("wind", {})))["gustiness"]
    mean = speed / steady_speed({"V_w_m_s": 1.0, "gustiness": gustiness})
    return _term(vessel, "wind", cause, V_w_m_s=mean, beta_w_deg=direction, **gusts)


def _gusty(vessel: VesselFile, cause: CauseValues) -> VesselFile:
    """As the wind of the same mean force, with gusts."""
    p = cause.public
    pressure, angle = RHO_AIR / 2 * steady_speed(p) ** 2, np.radians(p["beta_w_deg"])
    own = {"north_Pa": -pressure * np.cos(angle), "east_Pa": -pressure * np.sin(angle)}
    gusts = {key: p[key] for key in ("gustiness", "gust_time_s")}
    return _wind(vessel, CauseValues(cause.effect, own, p, cause.note), **gusts)


def _zone(vessel: VesselFile, cause: CauseValues) -> VesselFile:
    share, radius_m = cause.public["gain"] - 1, max(cause.public["radius_m"], LEAST_RADIUS_M)
    place = _new("shallow_zone", "share", north_m="north_m", east_m="east_m", radius_m=radius_m, share=share)
    return place(vessel, cause)


RAD = float(np.pi / 180)
EDITS: dict[str, Callable[[VesselFile, CauseValues], VesselFile]] = {
    "current": _current,
    "wind": _wind,
    "gusty_wind": _gusty,
    "turning_current": _new("current", "V_c_m_s", V_c_m_s="V_c_m_s", beta_c_deg="beta_c_deg", turn_deg_s="turn_deg_s"),
    "waves": _new("waves", "F_w_N", F_w_N="F_w_N", T_p_s="T_p_s", beta_wave_deg="beta_wave_deg"),
    "tether": _new(
        "tether",
        "stiffness_N_m",
        north_m="anchor_north_m",
        east_m="anchor_east_m",
        stiffness_N_m="k_N_m",
        x_t_m="x_t_m",
    ),
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
    "cross_flow": _added("cross_flow", "C_d", "C_d"),
    "munk_moment": _added("munk_moment", "k_kg", "N_uv_kg"),
    "accel_bias": _bias,
    "gyro_bias": _bias,
    "gyro_scale": _scale("imu", "gyro_scale"),
    "heading_offset": _sensor("imu", RAD, heading_offset_rad="offset_deg"),
    "hard_iron": _iron,
    "imu_misalignment": _sensor("imu", RAD, misalignment_rad="yaw_deg"),
    "imu_lever_arm": _sensor("imu", x_m="x_m", y_m="y_m"),
    "uwb_latency": _sensor("uwb", latency_s="latency_s"),
    "uwb_lever_arm": _sensor("uwb", x_m="x_m", y_m="y_m"),
    "gnss_latency": _sensor("gnss", latency_s="latency_s"),
    "gnss_lever_arm": _sensor("gnss", x_m="x_m", y_m="y_m"),
    "uwb_scale": _scale("uwb", "scale"),
    "nlos": _nlos,
    "clock_drift": _sensor("uwb", clock_drift_s_s="drift"),
}
"""By family. Other effects are written by their hook (hull coefficients, force maps), or have no key."""
