"""The fitted boat as a vessel file, which `load_vessel` reads; its `source` keys state where the numbers come from."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import cast

import numpy as np
from msgspec.inspect import FloatType, StructType, type_info
from msgspec.structs import replace

from companion.core.configuration.sensors import MOST_HARD_IRON_RAD, Imu
from companion.core.configuration.vessel_file import (
    Damping,
    ForceMap,
    Inertia,
    LinearMap,
    PitchMap,
    Propulsion,
    Thruster,
    VesselFile,
)
from companion.core.model.load_vessel import asymmetry_limit_N_s2_m, munk_limit_kg
from sim.fitting.engine.free_parameters import ADVANCE_LOSS, HARD_IRON, IMU, SURROUNDINGS, fitted_terms, unit_of
from sim.fitting.engine.parameters import DAMPING, Parameters
from sim.fitting.identify.result import FitResult

DIGITS = 6  # significant digits of fitted numbers
FITTED_INERTIA = ("mass_kg", "I_z_kg_m2", "X_udot_kg", "Y_vdot_kg", "Y_rdot_kg_m", "N_rdot_kg_m2")
TRIM_US = 200  # as the vessel file's bounds
COMPASS_RAD = np.radians(3.0)  # a heading that is off by less is within what compasses do; assumed
TOLD_RAD = np.radians(1.0)  # a heading that is off by less is not worth a sentence: the prior's sigma; assumed
IMU_BOUNDS = dict.fromkeys(HARD_IRON, (-MOST_HARD_IRON_RAD, MOST_HARD_IRON_RAD))
ROOM = 0.98  # largest share of M that is rigid body, where the file's mass would leave no added mass; of a limit, too


def identified_vessel(vessel: VesselFile, result: FitResult, *, date: str, session: bool = False) -> VesselFile:
    """`vessel` with the fitted inertia, damping, gains, azimuths, dead time, lag, terms, UWB latency and tag place;
    with its advance loss, where it states one.

    Fitted trims are written only for the `session` of the fitted logs itself: where blades stand at neutral changes
    from day to day (docs/cse1.md). Otherwise the file's trims stay; the fitted ones served to keep the other parameters
    unbiased.

    Only M is determined, not its division: mass and I_z stay and added mass takes the difference (`inertia_of`).
    """
    q = _within_bounds(vessel, {name: result[name].value for name in Parameters(vessel).names})
    loss_s_m = q.get(ADVANCE_LOSS.name)
    runs = ", ".join(h[:12] for h in result.data_hashes)
    source = f"identified {date} from {result.samples} samples (run {runs}), prior: vessel file {vessel.name}"
    thrusters = tuple(_thruster(t, q, source, session) for t in vessel.thrusters)
    sensors = vessel.sensors.with_position(
        latency_s=_round(q["uwb_latency_s"]),
        x_m=_round(q["tag_x_m"]),
        y_m=_round(q["tag_y_m"]),
        source=f"{vessel.sensors.position.source}; latency and place {source}",
    )
    sensors = replace(sensors, imu=_imu(sensors.imu, result, source))
    inertia = inertia_of(vessel.inertia, q, source)
    return replace(
        vessel,
        inertia=replace(inertia, **{k: _round(getattr(inertia, k)) for k in FITTED_INERTIA}),
        damping=Damping(**{name: _round(q[name]) for name in DAMPING}, source=source),
        propulsion=replace(
            vessel.propulsion,
            dead_time_s=_round(q["dead_time_s"]),
            lag_s=_round(q["lag_s"]),
            advance_loss_s_m=0.0 if loss_s_m is None else _round(loss_s_m),
            source=f"{vessel.propulsion.source}; dead time, lag{'' if loss_s_m is None else ', advance loss'} {source}",
        ),
        force_maps={name: _map(name, force_map, q, source) for name, force_map in vessel.force_maps.items()},
        thrusters=thrusters,
        sensors=sensors,
        terms=_terms(vessel, q, source),
    )


def _imu(imu: Imu, result: FitResult, source: str) -> Imu:
    """The IMU with its fitted place and hard iron, where they were free, and a constant error of the heading that no
    compass has.
    """
    fitted = {p.name: p.value for p in result.parameters if p.name in IMU}
    if fitted:
        new = {name.removeprefix("imu_"): _round(value) for name, value in _limited(fitted, IMU_BOUNDS).items()}
        imu = replace(imu, **new, source=f"{imu.source}; place, hard iron {source}")
    if abs(result.heading_offset_rad) > COMPASS_RAD:
        total = imu.heading_offset_rad + round(result.heading_offset_rad, 4)
        imu = replace(imu, heading_offset_rad=total, source=f"{imu.source}; heading offset {source}")
    return imu


def written_otherwise(vessel: VesselFile, result: FitResult) -> list[str]:
    """Sentences on fitted values that no vessel file may hold, and what is written in their place."""
    lines, late_s = [], result["uwb_latency_s"].value
    fitted = {p.name: p.value for p in result.parameters}
    if late_s < 0:
        lines.append(
            f"uwb_latency_s: fitted as {late_s:.3g} s, so positions would be ahead of the other sensors, and written "
            "as 0: look at the clocks of the log."
        )
    names = (*Parameters(vessel).names, *(name for name in HARD_IRON if name in fitted))
    written = _within_bounds(vessel, {name: fitted[name] for name in names})
    for name, value in written.items():
        if value != fitted[name] and not (name == "uwb_latency_s" and late_s < 0):
            lines.append(
                f"{name}: fitted as {fitted[name]:.3g}, which no vessel file may hold, written as {value:.3g}: look at "
                "the logs, and at what else is doubtful here."
            )
    for name, value in _held_by_damping(written).items():
        if abs(fitted[name] - value) > 1e-3:
            unit = unit_of(name)
            lines.append(
                f"{name}: fitted as {fitted[name]:.3g} {unit}, which would feed energy into the hull, written as "
                f"{value:.3g} {unit}."
            )
    return lines


def not_written(result: FitResult) -> list[str]:
    """Sentences on what was fitted beside the numbers of the vessel file, and is not in it."""
    off_deg = float(np.degrees(abs(result.heading_offset_rad)))
    if not TOLD_RAD < abs(result.heading_offset_rad) <= COMPASS_RAD:
        return []
    return [
        f"The heading was off by {off_deg:.1f} degrees in these logs, and the numbers of hull and thrusters allow for "
        f"it. vessel.toml does not have it: up to {np.degrees(COMPASS_RAD):.0f} degrees are within what compasses do "
        "from one day to the next."
    ]


def _within_bounds(vessel: VesselFile, q: Mapping[str, float]) -> dict[str, float]:
    """Fitted parameters `q` by name, within what a vessel file may hold; trims, curves and M have their own places."""
    bounds = {
        "uwb_latency_s": _bounds(type(vessel.sensors.position), "latency_s"),
        **{name: _bounds(type(vessel.sensors.position), name.removeprefix("tag_")) for name in ("tag_x_m", "tag_y_m")},
        **{name: _bounds(Propulsion, name) for name in ("dead_time_s", "lag_s")},
        **{name: _bounds(Damping, name) for name in DAMPING},
        **{f"gain_{t.name}": _bounds(Thruster, "gain") for t in vessel.thrusters},
        **{f"azimuth_{t.name}_deg": _bounds(Thruster, "azimuth_deg") for t in vessel.thrusters},
        **{f"astern_{name}": _bounds(LinearMap, "astern_share") for name in vessel.force_maps},
        **{p.name: (p.lower, p.upper) for _, p in fitted_terms(vessel)},
        **IMU_BOUNDS,
    }
    return _limited(q, bounds)


def _limited(q: Mapping[str, float], bounds: Mapping[str, tuple[float, float]]) -> dict[str, float]:
    return {name: float(np.clip(value, *bounds.get(name, (-np.inf, np.inf)))) for name, value in q.items()}


@cache
def _bounds(table: type, key: str) -> tuple[float, float]:
    """Least and largest value of a number in a table of the vessel file."""
    told = next(one.type for one in cast(StructType, type_info(table)).fields if one.encode_name == key)
    number = next(t for t in getattr(told, "types", (told,)) if isinstance(t, FloatType))
    return (-np.inf if number.ge is None else number.ge), (np.inf if number.le is None else number.le)


def _held_by_damping(q: Mapping[str, float]) -> dict[str, float]:
    """Those moments of `q` that may feed energy, within what the fitted damping holds."""
    damping, held = Damping(**{name: q[name] for name in DAMPING}, source="fitted"), dict[str, float]()
    if "k_kg" in q:
        most_kg = ROOM * munk_limit_kg(damping)
        held["k_kg"] = float(np.clip(q["k_kg"], -most_kg, most_kg))
    if "N_uu_N_s2_m" in q:
        most = ROOM * asymmetry_limit_N_s2_m(damping, held.get("k_kg", 0.0))
        held["N_uu_N_s2_m"] = float(np.clip(q["N_uu_N_s2_m"], -most, most))
    return held


def _map(name: str, force_map: ForceMap, q: Mapping[str, float], source: str) -> ForceMap:
    """A force map with its fitted curve or share astern, within the bounds of a vessel file."""
    if not isinstance(force_map, PitchMap):
        if f"astern_{name}" not in q:
            return force_map
        share, text = _round(q[f"astern_{name}"]), f"{force_map.source}; share astern {source}"
        return replace(force_map, astern_share=share, source=text)
    if f"curve_{name}" not in q:
        return force_map
    curve = float(np.clip(_round(q[f"curve_{name}"]), -1.0, 1.0))
    return replace(force_map, curve=curve, source=f"{force_map.source}; curve {source}")


def _thruster(thruster: Thruster, q: Mapping[str, float], source: str, session: bool) -> Thruster:
    """A thruster with its fitted gain, azimuth and trim; trims are whole microseconds within the file's bounds."""
    gain = replace(thruster, gain=_round(q[f"gain_{thruster.name}"]), source=f"{thruster.source}; gain {source}")
    if (trim := q.get(f"trim_{thruster.name}_us")) is None:
        return gain
    turned = replace(gain, azimuth_deg=_round(q[f"azimuth_{thruster.name}_deg"]))
    if not session:
        return replace(turned, source=f"{thruster.source}; gain and azimuth {source}")
    trim_us = int(np.clip(round(trim), -TRIM_US, TRIM_US))
    return replace(turned, trim_us=trim_us, source=f"{thruster.source}; gain, azimuth and trim {source}")


def _terms(vessel: VesselFile, q: Mapping[str, float], source: str) -> dict[str, dict[str, float | str]]:
    """The vessel's terms with their fitted parameters, moments within what the damping holds."""
    held = _held_by_damping(q)
    terms = {name: dict(values) for name, values in vessel.terms.items()}
    for name, p in fitted_terms(vessel):
        if name not in terms:
            continue
        terms[name] |= {p.name: _round(held.get(p.name, q[p.name])), "source": source}
    return terms


def in_surroundings(vessel: VesselFile, fit: FitResult) -> VesselFile:
    """The vessel in current and wind as they were fitted; as it is where they were not."""
    fitted = {p.name: p.value for p in fit.parameters}
    if SURROUNDINGS[0][1].name not in fitted:
        return vessel
    c_n, c_e, w_n, w_e = (fitted[p.name] for _, p in SURROUNDINGS)
    day: dict[str, dict[str, float | str]] = {
        "current": {"V_c_m_s": float(np.hypot(c_n, c_e)), "beta_c_deg": _deg(c_n, c_e), "source": "fitted: the day's"},
        "wind": {**vessel.terms.get("wind", {}), "source": "fitted: the day's"},
    }
    if w_n or w_e:  # else it was measured
        speed_m_s = min(float(np.hypot(w_n, w_e)), 25.0)
        day["wind"] |= {"V_w_m_s": speed_m_s, "beta_w_deg": _deg(w_n, w_e), "gustiness": 0.0}
    return replace(vessel, terms={**vessel.terms, **day})


def _deg(north: float, east: float) -> float:
    return float(np.degrees(np.arctan2(east, north)))


def inertia_of(base: Inertia, q: Mapping[str, float], source: str) -> Inertia:
    """`base` with the mass matrix M11_kg, M22_kg, M33_kg_m2, M23_kg_m of q: added mass takes the difference.

        X_udot = m - M11,   Y_vdot = m - M22,   Y_rdot = m x_g - M23,   N_rdot = I_z + m (x_g^2 + y_g^2) - M33

    Where added mass would change its sign, mass or I_z is lowered; the motion is the same.
    """
    M11, M22, M33, M23 = (q[k] for k in ("M11_kg", "M22_kg", "M33_kg_m2", "M23_kg_m"))
    mass = min(base.mass_kg, ROOM * min(M11, M22))
    y_g = base.y_g_m * base.mass_kg / mass  # M13 = -m y_g is not fitted
    at_origin = mass * (base.x_g_m**2 + y_g**2)
    I_z = min(base.I_z_kg_m2, ROOM * (M33 - at_origin))
    kept = (
        "mass and I_z kept, added mass fitted"
        if mass == base.mass_kg and I_z == base.I_z_kg_m2
        else ("only M is determined: mass or I_z lowered so that added mass keeps its sign")
    )
    return Inertia(
        mass_kg=mass,
        I_z_kg_m2=I_z,
        x_g_m=base.x_g_m,
        y_g_m=y_g,
        X_udot_kg=mass - M11,
        Y_vdot_kg=mass - M22,
        Y_rdot_kg_m=mass * base.x_g_m - M23,
        N_rdot_kg_m2=I_z + at_origin - M33,
        source=f"{source}; {kept}",
    )


def _round(value: float) -> float:
    """`value` to `DIGITS` significant digits."""
    return float(np.format_float_positional(value, DIGITS, unique=False, fractional=False, trim="k"))
