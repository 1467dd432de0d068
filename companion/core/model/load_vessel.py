"""Reading a vessel file, with the checks that span several of its tables."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from companion.core.configuration.servos import Rudder, Servo, Steering
from companion.core.configuration.tables import ConfigError, parse_toml
from companion.core.configuration.vessel_file import Damping, PitchMap, RotorMap, Thruster, VesselFile
from companion.core.constants import NEUTRAL_US, WATER_KG_M3
from companion.core.model import loads
from companion.core.model import manoeuvring as model
from companion.core.model.effects.cross_flow import most_negative_C_d
from companion.core.model.thrusters import SPAN_US


def load_vessel(text: str, *, name: str) -> VesselFile:
    """Vessel file text -> VesselFile, checked across tables. Raises ConfigError naming file and key."""
    vessel = parse_toml(text, VesselFile, name=name)
    for problem in _problems(vessel):
        raise ConfigError(f"{name}: {problem}")
    return vessel


def _problems(vessel: VesselFile) -> Iterator[str]:
    """Yield what no single table can know to be wrong."""
    if (vessel.sensors.uwb is None) == (vessel.sensors.gnss is None):
        found = "both" if vessel.sensors.uwb else "neither"
        yield f"sensors: expected one of the tables uwb and gnss, found {found}"
    yield from _thruster_problems(vessel)
    yield from _mass_problems(vessel)
    yield from _place_problems(vessel)
    if np.linalg.eigvalsh(model.mass_matrix(vessel)).min() <= 0:
        yield "inertia: M_RB + M_A is not positive definite; look at Y_rdot_kg_m, x_g_m and y_g_m"
    D = model.linear_damping(vessel)
    if np.linalg.eigvalsh(D + D.T).min() < 0:
        yield "damping: the linear part feeds energy into the hull; |Y_r_N_s + N_v_N_s| is too large"
    if "wind" in vessel.terms:
        for key in ("frontal_area_m2", "lateral_area_m2"):
            if not getattr(vessel.hull, key):
                yield f"hull.{key}: missing key: terms.wind needs it"
    yield from loads.problems(vessel.terms)
    yield from _wash_problems(vessel)
    yield from _moment_problems(vessel)
    yield from _cross_flow_problems(vessel)


def _thruster_problems(vessel: VesselFile) -> Iterator[str]:
    for i, t in enumerate(vessel.thrusters):
        at = f"thrusters[{i}]"
        if t.force_map not in vessel.force_maps:
            yield f"{at}.force_map: no table force_maps.{t.force_map}; there are {sorted(vessel.force_maps)}"
        if not t.pwm_min_us < NEUTRAL_US < t.pwm_max_us:
            yield f"{at}.pwm_min_us: expected pwm_min_us < 1500 < pwm_max_us"
        if not t.force_min_N < t.force_max_N:
            yield f"{at}.force_min_N: expected force_min_N < force_max_N"
        fmap = vessel.force_maps.get(t.force_map)
        if isinstance(fmap, RotorMap) and t.trim_us and abs(t.trim_us) >= fmap.dead_band_us:
            yield f"{at}.trim_us: expected less than the dead band of {fmap.dead_band_us:g} us: 1500 us must be neutral"
        if isinstance(fmap, PitchMap) and t.mirrored:
            yield f"{at}.mirrored: only with an ESC; turn azimuth_deg of a pitch propeller by 180 instead"
    yield from _servo_problems(vessel)
    before = list[Thruster | Servo]()
    for at, one in _controls(vessel):
        if one.name in [other.name for other in before]:
            yield f"{at}.name: {one.name!r} is there twice"
        if one.channel in [other.channel for other in before]:
            yield f"{at}.channel: channel {one.channel} is there twice"
        before.append(one)


def _controls(vessel: VesselFile) -> Iterator[tuple[str, Thruster | Servo]]:
    """Thrusters and servos, each with its place in the file."""
    for i, t in enumerate(vessel.thrusters):
        yield f"thrusters[{i}]", t
        for key in ("steering", "rudder"):
            if servo := getattr(t, key):
                yield f"thrusters[{i}].{key}", servo


def _servo_problems(vessel: VesselFile) -> Iterator[str]:
    for at, servo in _controls(vessel):
        if not isinstance(servo, Servo):
            continue
        if not servo.pwm_min_us < NEUTRAL_US < servo.pwm_max_us:
            yield f"{at}.pwm_min_us: expected pwm_min_us < 1500 < pwm_max_us"
        least = min(servo.pwm_max_us - NEUTRAL_US - servo.trim_us, NEUTRAL_US + servo.trim_us - servo.pwm_min_us)
        reached = servo.full_angle_deg * least / SPAN_US
        if servo.angle_max_deg > reached + 1e-9:
            yield f"{at}.angle_max_deg: pulses reach {reached:.3g} deg either way, found {servo.angle_max_deg:g}"
        if isinstance(servo, Rudder) and servo.angle_max_deg > MOST_RUDDER_DEG:
            yield f"{at}.angle_max_deg: expected at most {MOST_RUDDER_DEG:g}: beyond that a rudder stalls"
        if isinstance(servo, Steering) and servo.angle_max_deg < LEAST_STEERING_DEG:
            yield (
                f"{at}.angle_max_deg: expected at least {LEAST_STEERING_DEG:g}, found {servo.angle_max_deg:g}: "
                "a thruster that turns by less, as an outboard, cannot push to the side, and is not driven yet"
            )
    washed = {name for w in vessel.propulsion.wash for name in (w.behind, w.ahead)}
    for i, t in enumerate(vessel.thrusters):
        if t.steering and t.rudder:
            yield f"thrusters[{i}]: has steering and a rudder; leave one out"
        if t.rudder and t.azimuth_deg:
            yield f"thrusters[{i}].azimuth_deg: a rudder's propeller pushes ahead: expected 0, found {t.azimuth_deg:g}"
        if t.steering and t.name in washed:
            yield f"thrusters[{i}].steering: propulsion.wash is for thrusters that do not turn"
        for key in ("advance_loss_s_m", "advance_loss_sqrt_N_s_m"):
            if t.steering and getattr(vessel.propulsion, key):
                yield f"thrusters[{i}].steering: propulsion.{key} is for thrusters that do not turn"


def _wash_problems(vessel: VesselFile) -> Iterator[str]:
    names = [t.name for t in vessel.thrusters]
    for i, wash in enumerate(vessel.propulsion.wash):
        for key in ("behind", "ahead"):
            if getattr(wash, key) not in names:
                yield f"propulsion.wash[{i}].{key}: no thruster {getattr(wash, key)!r}; there are {', '.join(names)}"
        if wash.behind == wash.ahead:
            yield f"propulsion.wash[{i}].ahead: a thruster does not lie in its own jet"


MOST_RUDDER_DEG = 45.0
"""Beyond this the equation of the rudder's force has nothing to do with rudders; assumed."""
LEAST_STEERING_DEG = 90.0
"""With less a thruster reaches no force across its azimuth alone, which allocation and guidance take for granted."""
MASS_SHARES = (0.01, 3.0)
"""Of what the box around the hull displaces: one that floats has less than 1 (example boats 0.4 to 0.5), but beam and
draft are often guessed; assumed."""


def _mass_problems(vessel: VesselFile) -> Iterator[str]:
    hull = vessel.hull
    box_kg = WATER_KG_M3 * hull.length_m * hull.beam_m * hull.draft_m
    least_kg, most_kg = (share * box_kg for share in MASS_SHARES)
    if not least_kg <= vessel.inertia.mass_kg <= most_kg:
        size = f"{hull.length_m:g} x {hull.beam_m:g} x {hull.draft_m:g} m (length, beam, draft)"
        expected = f"expected {least_kg:.3g} to {most_kg:.3g}, found {vessel.inertia.mass_kg:g}"
        yield f"inertia.mass_kg: {expected}: a hull of {size} displaces at most {box_kg:.3g} kg"


FARTHEST_PLACE, FARTHEST_M = 2.0, 3.0
"""A place from the origin over the hull's length (or beam): an origin at one end, and a boom as long; or so far, for
the mast of a model boat. Assumed."""


def _place_problems(vessel: VesselFile) -> Iterator[str]:
    """Places far beyond the hull: centimetres for metres, which move the boat on the map by as much."""
    tables = {"inertia": vessel.inertia, **dict(_controls(vessel))}
    tables |= {f"sensors.{key}": getattr(vessel.sensors, key) for key in vessel.sensors.__struct_fields__}
    hull = vessel.hull
    most_m = max(FARTHEST_M, FARTHEST_PLACE * max(hull.length_m, hull.beam_m))
    for at, table in tables.items():
        for key in ("x_g_m", "y_g_m", "x_m", "y_m", "z_m"):
            if abs(value := getattr(table, key, 0.0)) > most_m:
                expected = f"expected {-most_m:g} to {most_m:g}, found {value:g}"
                yield f"{at}.{key}: {expected}: a hull of {hull.length_m:g} x {hull.beam_m:g} m; metres from its origin"


MUNK_SPEED_M_S = 3.0
"""Speed up to which linear damping alone may have to hold a Munk moment; assumed: twice what such boats do."""


def munk_limit_kg(d: Damping) -> float:
    """Largest |k| of k u v r that feeds nothing: damping takes as much, the quadratic part at any speed, or the linear

    one up to U.

    X_uu |u|^3 + Y_vv |v|^3 + N_rr |r|^3 >= 3 (X_uu Y_vv N_rr)^(1/3) |u v r|;   Y_v v^2 + (Y_r + N_v) v r + N_r r^2 >=
    (2 sqrt(Y_v N_r) - |Y_r + N_v|) |v r|.
    """
    quadratic = 3 * abs(d.X_uu_N_s2_m2 * d.Y_vv_N_s2_m2 * d.N_rr_N_m_s2) ** (1 / 3)
    coupling = abs(d.Y_r_N_s + d.N_v_N_s) / 2
    linear = 2 * ((d.Y_v_N_s_m * d.N_r_N_m_s) ** 0.5 - coupling)
    return max(quadratic, linear / MUNK_SPEED_M_S)


def asymmetry_limit_N_s2_m(d: Damping, k_kg: float = 0.0) -> float:
    """Largest |N_uu| of N_uu |u| u that feeds nothing, as `munk_limit_kg`, beside a Munk moment of `k_kg`.

    X_uu |u|^3 + N_rr |r|^3 >= (27/4 X_uu^2 N_rr)^(1/3) u^2 |r|;   X_u u^2 + N r^2 >= 2 sqrt(X_u N) |u r|, with what the
    coupling leaves of N_r: N = N_r - (Y_r + N_v)^2 / (4 Y_v).
    """
    quadratic = abs(27 / 4 * d.X_uu_N_s2_m2**2 * d.N_rr_N_m_s2) ** (1 / 3)
    left = abs(d.N_r_N_m_s) - (d.Y_r_N_s + d.N_v_N_s) ** 2 / (4 * abs(d.Y_v_N_s_m)) if d.Y_v_N_s_m else 0.0
    linear = 2 * (abs(d.X_u_N_s_m) * max(left, 0.0)) ** 0.5
    munk = munk_limit_kg(d)
    free = 1.0 - min(abs(k_kg) / munk, 1.0) if munk else 1.0
    return free * max(quadratic, linear / MUNK_SPEED_M_S)


def _moment_problems(vessel: VesselFile) -> Iterator[str]:
    k, most_kg = vessel.terms.get("munk_moment", {}).get("k_kg", 0.0), munk_limit_kg(vessel.damping)
    if not isinstance(k, int | float):
        return
    if abs(k) > most_kg:
        yield f"terms.munk_moment.k_kg: feeds energy into the hull; this damping holds at most {most_kg:.3g} kg"
    N_uu, most = vessel.terms.get("asymmetry", {}).get("N_uu_N_s2_m", 0.0), asymmetry_limit_N_s2_m(vessel.damping, k)
    if isinstance(N_uu, int | float) and abs(N_uu) > most:
        yield f"terms.asymmetry.N_uu_N_s2_m: feeds energy into the hull; this damping holds at most {most:.3g} N s2/m"


def _cross_flow_problems(vessel: VesselFile) -> Iterator[str]:
    C_d = vessel.terms.get("cross_flow", {}).get("C_d", 0.0)
    if isinstance(C_d, int | float) and C_d < 0 and C_d < (least := most_negative_C_d(vessel)):
        yield f"terms.cross_flow.C_d: feeds energy into the hull; this damping holds {least:.3g} at the lowest"
