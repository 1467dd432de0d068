"""A fitted boat as a vessel file: loads with `load_vessel` as it is, and says where its numbers come from."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np
from msgspec.structs import replace

from companion.core.vessel_file import Damping, Inertia, VesselFile
from companion.core.vessel_load import load_vessel
from sim.identify.structured.parameters import DAMPING, Parameters
from sim.identify.structured.result import FitResult

DIGITS = 6
ROOM = 0.98  # of M that the rigid body may take, where the file's mass would leave no added mass


def identified_vessel(vessel: VesselFile, result: FitResult, *, date: str) -> VesselFile:
    """`vessel` with the fitted inertia, damping, gains, dead time, lag, UWB latency and tag place.

    Only M is known, not how it divides: mass and I_z stay as they are and added mass takes the difference, unless that
    would be positive; then mass or I_z gives way. Either way the motion is the same.
    """
    names = Parameters(vessel).names
    q = dict(zip(names, (result[name].value for name in names), strict=True))
    runs = ", ".join(h[:12] for h in result.data_hashes)
    source = f"identified {date} from {result.samples} samples (run {runs}), prior: vessel file {vessel.name}"
    thrusters = tuple(
        replace(t, gain=_round(q[f"gain_{t.name}"]), source=f"{t.source}; gain {source}") for t in vessel.thrusters
    )
    uwb = replace(
        vessel.sensors.uwb,
        latency_s=max(0.0, _round(q["uwb_latency_s"])),
        x_m=_round(q["tag_x_m"]),
        y_m=_round(q["tag_y_m"]),
        source=f"{vessel.sensors.uwb.source}; latency and place {source}",
    )
    return replace(
        vessel,
        inertia=_inertia(vessel.inertia, q, source),
        damping=Damping(**{name: _round(q[name]) for name in DAMPING}, source=source),
        propulsion=replace(
            vessel.propulsion,
            dead_time_s=_round(q["dead_time_s"]),
            lag_s=_round(q["lag_s"]),
            source=f"{vessel.propulsion.source}; dead time and lag {source}",
        ),
        thrusters=thrusters,
        sensors=replace(vessel.sensors, uwb=uwb),
    )


def _inertia(given: Inertia, q: Mapping[str, float], source: str) -> Inertia:
    M11, M22, M33, M23 = (q[k] for k in ("M11_kg", "M22_kg", "M33_kg_m2", "M23_kg_m"))
    mass = min(given.mass_kg, ROOM * min(M11, M22))
    y_g = given.y_g_m * given.mass_kg / mass  # M13 = -m y_g is not fitted
    at_origin = mass * (given.x_g_m**2 + y_g**2)
    I_z = min(given.I_z_kg_m2, ROOM * (M33 - at_origin))
    kept = (
        "mass and I_z kept, added mass fitted"
        if mass == given.mass_kg and I_z == given.I_z_kg_m2
        else ("only M is determined: mass or I_z lowered so that added mass keeps its sign")
    )
    return Inertia(
        mass_kg=_round(mass),
        I_z_kg_m2=_round(I_z),
        x_g_m=given.x_g_m,
        y_g_m=y_g,
        X_udot_kg=_round(mass - M11),
        Y_vdot_kg=_round(mass - M22),
        Y_rdot_kg_m=_round(mass * given.x_g_m - M23),
        N_rdot_kg_m2=_round(I_z + at_origin - M33),
        source=f"{source}; {kept}",
    )


def _round(value: float) -> float:
    return float(np.format_float_positional(value, DIGITS, unique=False, fractional=False, trim="k"))


def vessel_toml(vessel: VesselFile, comment: str = "") -> str:
    """A vessel file as TOML text; what it says loads back as the same vessel (checked)."""
    data = msgspec.to_builtins(vessel)
    lines = [f"# {line}" for line in comment.splitlines()]
    lines += _table((), data)
    text = "\n".join(lines) + "\n"
    if load_vessel(text, name=vessel.name) != vessel:
        raise ValueError(f"{vessel.name}: the text does not load back as the vessel it was made from")
    return text


def _table(path: tuple[str, ...], data: Mapping[str, Any]) -> list[str]:
    """Lines of one table: its own keys, then tables in it, then arrays of tables."""
    plain = {k: v for k, v in data.items() if v is not None and not isinstance(v, dict | list | tuple)}
    lists = {k: v for k, v in data.items() if isinstance(v, list | tuple)}
    lines = [f"\n[{'.'.join(path)}]"] if path and plain else []
    lines += [f"{k} = {_value(v)}" for k, v in plain.items()]
    for key, inner in data.items():
        if isinstance(inner, dict):
            lines += _table((*path, key), inner)
    for key, items in lists.items():
        for item in items:
            lines.append(f"\n[[{'.'.join((*path, key))}]]")
            lines += [f"{k} = {_value(v)}" for k, v in item.items() if v is not None]
    return lines


def _value(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str) else repr(value)
