"""Some thirty-five small errors of the base that every case has at once, none near the smallest size worth naming."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from tests.hidden.effects.propulsion import whole_steps
from tests.hidden.plant.world import World

SHARE = 0.35
"""Largest part of its smallest nameable size that an imperfection with a name in the catalogue may have."""

COEFFICIENTS = ("m", "I_z", "X_udot", "Y_vdot", "N_rdot", "X_u", "Y_v", "Y_r", "N_v", "N_r", "X_uu", "Y_vv", "N_rr")
DAMPING = ("X_u", "Y_v", "Y_r", "N_v", "N_r", "X_uu", "Y_vv", "N_rr")

SMALL = {
    "hull.x_g": 0.005, "hull.y_g": 0.005, "hull.cross_flow": 0.03, "hull.munk": 1.0,
    "drive.dead_band_us": 1.2, "drive.lag": 0.008, "drive.voltage_exponent": 0.08,
    "drive.advance": 0.015, "drive.wash": 0.03, "drive.astern_gain": 0.015,
    "sense.gyro_bias": 0.0005, "sense.gyro_scale": 0.005, "sense.heading_deg": 0.3, "sense.misalign_deg": 0.4,
    "sense.imu_x": 0.01, "sense.imu_y": 0.01, "sense.uwb_x": 0.008, "sense.uwb_y": 0.008, "sense.scale": 0.002,
    "sense.latency": 0.010, "sense.iron_deg": 0.25, "sense.drift": 0.00005,
}  # fmt: skip
POSITIVE = ("hull.cross_flow", "drive.advance", "drive.wash", "sense.latency")

OWNERS = {
    "payload": ("hull.m",), "added_mass": ("hull.X_udot", "hull.Y_vdot"), "yaw_inertia": ("hull.I_z", "hull.N_rdot"),
    "cg_shift": ("hull.x_g", "hull.y_g"), "cross_flow": ("hull.cross_flow",), "munk_moment": ("hull.munk",),
    "yaw_sway_coupling": ("hull.Y_r", "hull.N_v"), "dead_band": ("drive.dead_band_us",), "lag": ("drive.lag",),
    "dead_time": ("drive.dead_time",), "voltage_exponent": ("drive.voltage_exponent",), "wash": ("drive.wash",),
    "advance_loss": ("drive.advance",), "astern_asymmetry": ("drive.astern_gain",),
    "gyro_bias": ("sense.gyro_bias",), "gyro_scale": ("sense.gyro_scale",), "heading_offset": ("sense.heading_deg",),
    "imu_misalignment": ("sense.misalign_deg",), "imu_lever_arm": ("sense.imu_x", "sense.imu_y"),
    "uwb_lever_arm": ("sense.uwb_x", "sense.uwb_y"), "uwb_scale": ("sense.scale",), "uwb_latency": ("sense.latency",),
    "hard_iron": ("sense.iron_deg",), "clock_drift": ("sense.drift",), "accel_bias": ("sense.accel_bias",),
    "current": ("water.ambient_V_c",), "turning_current": ("water.ambient_V_c",),
    "wind": ("water.ambient_V_w",), "gusty_wind": ("water.ambient_V_w",), "thruster_gain": (), "nlos": (),
}  # fmt: skip
"""Where an effect itself sets a number there is no imperfection of that number: the truth is the effect's size."""


def add_imperfections(world: World, rng: np.random.Generator, causes: Iterable[tuple[str, dict]]) -> dict[str, float]:
    """Change `world` (before its effects are applied) and return what was changed: name to amount."""
    causes = list(causes)
    kept_clean = {key for name, _ in causes for key in OWNERS.get(name, ())}
    done: dict[str, float] = {}
    coefficients = {k: float(rng.uniform(-0.04, 0.04)) for k in COEFFICIENTS}
    if any(name == "hull_fouling" for name, _ in causes):
        mean = sum(coefficients[k] for k in DAMPING) / len(DAMPING)
        coefficients |= {k: coefficients[k] - mean for k in DAMPING}
    for key, share in coefficients.items():
        if f"hull.{key}" not in kept_clean:
            setattr(world.hull, key, getattr(world.hull, key) * (1 + share))
            done[f"hull.{key} share"] = share
    for key, most in SMALL.items():
        value = float(rng.uniform(0 if key in POSITIVE else -most, most))
        if key not in kept_clean:
            part, field = key.split(".")
            target = getattr(world, part)
            setattr(target, field, getattr(target, field) + value)
            done[key] = value
    done |= _thrusters(world, rng, causes)
    if "drive.dead_time" not in kept_clean:
        world.drive.dead_time += (late := whole_steps(float(rng.uniform(-0.012, 0.012))))
        done["drive.dead_time"] = late
    return done | _pairs(world, rng, kept_clean)


def _thrusters(world: World, rng: np.random.Generator, causes: list[tuple[str, dict]]) -> dict[str, float]:
    """Gains off by 1 to 2.5 %, neutral by up to 2 us."""
    gains = rng.choice([-1, 1], 4) * rng.uniform(0.010, 0.025, 4)
    if any(name in ("common_loss", "astern_asymmetry") for name, _ in causes):
        gains = gains - gains.mean()
    done = {}
    for thruster, share in zip(world.drive.thrusters, gains.tolist(), strict=True):
        thruster.trim_us += (trim := float(rng.uniform(-2, 2)))
        done[f"trim_us {thruster.name}"] = trim
        if not any(p.get("thruster") == thruster.name for _, p in causes):
            thruster.gain *= 1 + share
            done[f"gain share {thruster.name}"] = share
    return done


def _pairs(world: World, rng: np.random.Generator, clean: set[str]) -> dict[str, float]:
    """Ambient current and wind, accelerometers, everyday force noise, fixes."""
    water, sense = world.water, world.sense
    done: dict[str, float] = {}

    def vector(key: str, most: float) -> tuple[float, float]:
        size, angle = rng.uniform(0, most), rng.uniform(0, 2 * np.pi)
        if key in clean:
            return 0.0, 0.0
        done[key] = float(size)
        return float(size * np.cos(angle)), float(size * np.sin(angle))

    water.ambient_V_c = vector("water.ambient_V_c", 0.005)
    water.ambient_V_w = vector("water.ambient_V_w", 0.3)
    sense.accel_bias = vector("sense.accel_bias", 0.006)
    sense.accel_scale = (1 + float(rng.uniform(-0.01, 0.01)), 1 + float(rng.uniform(-0.01, 0.01)))
    sense.iron_at_deg = float(rng.uniform(-180, 180))
    water.ambient_N = (float(rng.uniform(0.08, 0.2)), float(rng.uniform(0.08, 0.2)), float(rng.uniform(0.02, 0.06)))
    sense.warp_m, sense.odd_fixes = float(rng.uniform(0, 0.008)), float(rng.uniform(0, 0.005))
    sense.lost_fixes = float(rng.uniform(0, 0.02))
    return done | {"ambient_X_N": water.ambient_N[0], "warp_m": sense.warp_m, "odd_fixes": sense.odd_fixes}
