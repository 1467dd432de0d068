"""Boats drawn at random, and the first file that somebody has of each: its length and its thrusters' places."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace

from companion.core.configuration.vessel_file import Thruster, VesselFile
from companion.core.model.first_vessel import Answers, first_vessel
from companion.core.model.load_vessel import load_vessel
from companion.core.model.vessel_text import vessel_toml
from sim.studies.boats.draw import draw_boat
from sim.world.environment import Weather

HULL_SHARE, GAIN_SHARE, COMPASS_DEG = 0.5, 0.4, 10.0
TWO, CAUSE, WIRED, OFF = 0.25, 0.25, 0.1, 0.1
"""Shares of boats with two thrusters, one more hidden cause, a wiring fault, a compass that is off."""
CAUSES = ("advance_loss", "speed_damping", "munk_moment", "hard_iron")
ARMS_M = 0.2
"""Tag and IMU are within this of the body origin; the first file knows neither."""


@dataclass(frozen=True)
class DrawnBoat:
    """A boat, its first file, the weather, and what is hidden in it, by name."""

    seed: int
    true: VesselFile
    first: VesselFile
    weather: Weather
    hidden: tuple[str, ...]


def drawn(seed: int, reference: VesselFile) -> DrawnBoat:
    """The boat of a seed. `reference`: the boat around which X boats are drawn."""
    rng = np.random.default_rng([seed, 25])
    layout = "differential" if rng.random() < TWO else "x"
    hull = reference.hull
    answers = Answers(hull.length_m, hull.beam_m, None, layout, None, "uwb")
    first = first_vessel(answers, "first", reference.force_maps["t200"])
    around = reference if layout == "x" else first
    true = draw_boat(around, rng, share=HULL_SHARE, gain_sigma=0.0)
    gains = [t.gain * (1 + float(rng.uniform(-GAIN_SHARE, GAIN_SHARE))) for t in true.thrusters]
    true = replace(true, thrusters=tuple(replace(t, gain=g) for t, g in zip(true.thrusters, gains, strict=True)))
    true = _with_arms(true, rng)
    pairs = zip(first.thrusters, true.thrusters, strict=True)
    first = replace(first, thrusters=tuple(_placed(f, t) for f, t in pairs))
    hidden = [layout] if layout != "x" else []
    if rng.random() < CAUSE:
        true, name = _with_cause(true, rng)
        hidden.append(name)
    if rng.random() < WIRED:
        true, name = _with_wiring(true, rng)
        hidden.append(name)
    if rng.random() < OFF:
        angle = float(np.radians(COMPASS_DEG) * rng.choice([-1.0, 1.0]))
        true = _with_imu(true, heading_offset_rad=angle)
        hidden.append("compass")
    weather = Weather(
        V_c_m_s=float(rng.uniform(0, 0.12)),
        beta_c_deg=float(rng.uniform(0, 360)),
        V_w_m_s=float(rng.uniform(0, 4)),
        beta_w_deg=float(rng.uniform(0, 360)),
        gustiness=0.2,
    )
    return DrawnBoat(seed, load_vessel(vessel_toml(true), name="true"), first, weather, tuple(hidden))


def _placed(first: Thruster, true: Thruster) -> Thruster:
    """A thruster of the first file at the place, and on the channel, of the true one."""
    return replace(
        first, name=true.name, channel=true.channel, x_m=true.x_m, y_m=true.y_m, azimuth_deg=true.azimuth_deg
    )


def _with_arms(true: VesselFile, rng: np.random.Generator) -> VesselFile:
    x, y, tag_x, tag_y = (float(v) for v in rng.uniform(-ARMS_M, ARMS_M, 4))
    uwb = replace(true.sensors.tag, x_m=tag_x, y_m=tag_y)
    return _with_imu(replace(true, sensors=replace(true.sensors, uwb=uwb)), x_m=x, y_m=y)


def _with_imu(true: VesselFile, **changes: float) -> VesselFile:
    return replace(true, sensors=replace(true.sensors, imu=replace(true.sensors.imu, **changes)))


def _with_cause(true: VesselFile, rng: np.random.Generator) -> tuple[VesselFile, str]:
    name = str(rng.choice(CAUSES))
    size = float(rng.uniform(0.5, 1.0))
    if name == "advance_loss":
        return replace(true, propulsion=replace(true.propulsion, advance_loss_s_m=0.3 * size)), name
    if name == "hard_iron":
        return _with_imu(true, hard_iron_cos_rad=0.1 * size), name
    inertia, damping = true.inertia, true.damping
    key, value = {
        "speed_damping": ("N_ur_N_s2", 3.0 * damping.N_r_N_m_s * size),
        "munk_moment": ("k_kg", 0.2 * inertia.Y_vdot_kg * size),
    }[name]
    return replace(true, terms={**true.terms, name: {key: value, "source": "drawn"}}), name


def _with_wiring(true: VesselFile, rng: np.random.Generator) -> tuple[VesselFile, str]:
    """Two thrusters that have changed places, or one that pushes the wrong way."""
    thrusters = list(true.thrusters)
    i, k = (int(v) for v in rng.choice(len(thrusters), 2, replace=False))
    if rng.random() < 0.5:
        thrusters[i] = replace(thrusters[i], mirrored=not thrusters[i].mirrored)
        return replace(true, thrusters=tuple(thrusters)), "reversed"
    there = {n: {key: getattr(thrusters[n], key) for key in ("x_m", "y_m", "azimuth_deg")} for n in (i, k)}
    thrusters[i], thrusters[k] = replace(thrusters[i], **there[k]), replace(thrusters[k], **there[i])
    return replace(true, thrusters=tuple(thrusters)), "swapped"
