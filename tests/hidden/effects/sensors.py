"""Catalogue: IMU, compass, UWB."""

from __future__ import annotations

import numpy as np

from tests.hidden.effects.effect import Effect, Params, also, heading, one, two
from tests.hidden.plant.world import World


def _accel(world: World, p: Params) -> None:
    x, y = world.sense.accel_bias
    world.sense.accel_bias = (x + p["b_x_m_s2"], y + p["b_y_m_s2"])


def _adds(**fields: str):
    """Add parameters to fields of world.sense."""

    def apply(world: World, p: Params) -> None:
        for key, name in fields.items():
            setattr(world.sense, key, getattr(world.sense, key) + p[name])

    return apply


def _iron(rng: np.random.Generator, size: float, base: World) -> Params:
    return {"amplitude_deg": size, "phase_deg": heading(rng)}


def _hard(world: World, p: Params) -> None:
    world.sense.iron_deg, world.sense.iron_at_deg = p["amplitude_deg"], p["phase_deg"]


def _soft(world: World, p: Params) -> None:
    world.sense.soft_iron_deg = 0.5 * p["amplitude_deg"]


def _sight(rng: np.random.Generator, size: float, base: World) -> Params:
    return {"share": size, "extra_m": float(rng.uniform(0.6, 1.2)), "anchor": int(rng.integers(4))}


def _nlos(world: World, p: Params) -> None:
    s = world.sense
    s.nlos, s.nlos_m, s.nlos_anchor = p["share"], p["extra_m"], p["anchor"]


def _quarter(world: World, p: Params) -> None:
    world.sense.nlos_zone = True


def _north_less(world: World, p: Params) -> None:
    world.sense.scale_north = 0.5


def _late(world: World, p: Params) -> None:
    world.sense.drift_late = True


def _accel_warms(world: World, p: Params) -> None:
    world.sense.accel_drift = 0.5


def _gyro_warms(world: World, p: Params) -> None:
    world.sense.gyro_drift = 0.5


_GYRO, _SCALE, _DRIFT = _adds(gyro_bias="b_r_rad_s"), _adds(scale="scale"), _adds(drift="drift")
EFFECTS = (
    Effect("accel_bias", ("b_x_m_s2", "b_y_m_s2"), 0.02, two("b_x_m_s2", "b_y_m_s2"), _accel,
           {"warms": also(_accel, _accel_warms)}),
    Effect("gyro_bias", ("b_r_rad_s",), 0.002, one("b_r_rad_s"), _GYRO, {"warms": also(_GYRO, _gyro_warms)}),
    Effect("gyro_scale", ("scale",), 0.02, one("scale"), _adds(gyro_scale="scale")),
    Effect("heading_offset", ("offset_deg",), 1.0, one("offset_deg"), _adds(heading_deg="offset_deg")),
    Effect("hard_iron", ("amplitude_deg",), 1.0, _iron, _hard, {"soft_iron": also(_hard, _soft)}),
    Effect("imu_misalignment", ("yaw_deg",), 1.5, one("yaw_deg"), _adds(misalign_deg="yaw_deg")),
    Effect("imu_lever_arm", ("x_m", "y_m"), 0.04, two("x_m", "y_m"), _adds(imu_x="x_m", imu_y="y_m")),
    Effect("uwb_latency", ("latency_s",), 0.04, one("latency_s", positive=True), _adds(latency="latency_s")),
    Effect("uwb_lever_arm", ("x_m", "y_m"), 0.03, two("x_m", "y_m"), _adds(uwb_x="x_m", uwb_y="y_m")),
    Effect("uwb_scale", ("scale",), 0.01, one("scale"), _SCALE, {"uneven": also(_SCALE, _north_less)}),
    Effect("nlos", ("share",), 0.03, _sight, _nlos, {"quarter": also(_nlos, _quarter)}),
    Effect("clock_drift", ("drift",), 0.0003, one("drift"), _DRIFT, {"late": also(_DRIFT, _late)}),
)  # fmt: skip
