"""Boats drawn round a 1.5 m catamaran with four T200 in X. All numbers assumed; none is of a real boat."""

from __future__ import annotations

import numpy as np

from tests.hidden.effects.propulsion import whole_steps
from tests.hidden.plant.world import Curve, Drive, Hull, Sense, Thruster, World


def boat(rng: np.random.Generator, uwb_hz: float, imu_hz: float) -> World:
    """A boat as its file believes it to be."""

    def near(value: float, share: float) -> float:
        return float(f"{value * rng.uniform(1 - share, 1 + share):.5g}")

    m, length = near(46.0, 0.2), near(1.47, 0.1)
    hull = Hull(
        length=length,
        beam=0.75,
        draft=near(0.10, 0.15),
        frontal=near(0.13, 0.2),
        lateral=near(0.30, 0.2),
        m=m,
        I_z=float(f"{m * (near(0.30, 0.08) * length) ** 2:.5g}"),
        x_g=float(f"{rng.uniform(-0.02, 0.03):.3f}"),
        y_g=0.0,
        X_udot=-float(f"{m * rng.uniform(0.07, 0.14):.4g}"),
        Y_vdot=-float(f"{m * rng.uniform(0.6, 0.95):.4g}"),
        Y_rdot=-near(0.8, 0.3),
        N_rdot=-near(4.0, 0.25),
        X_u=-near(3.6, 0.3),
        Y_v=-near(18.0, 0.25),
        Y_r=-near(1.0, 0.3),
        N_v=-near(1.0, 0.3),
        N_r=-near(3.2, 0.25),
        X_uu=-near(12.0, 0.25),
        Y_vv=-near(105.0, 0.2),
        N_rr=-near(11.0, 0.25),
    )
    return World(hull, _drive(rng, near), _sense(rng, uwb_hz, imu_hz))


def _drive(rng: np.random.Generator, near) -> Drive:
    x, y, angle = near(0.46, 0.12), near(0.25, 0.1), float(round(rng.uniform(36, 52)))
    places = (("front_port", x, -y, angle), ("front_starboard", x, y, -angle),
              ("rear_port", -x, -y, -angle), ("rear_starboard", -x, y, angle))  # fmt: skip
    nominal = float(f"{rng.uniform(14.4, 15.6):.1f}")
    return Drive(
        thrusters=[Thruster(n, a, b, c, 9 + i) for i, (n, a, b, c) in enumerate(places)],
        ahead=Curve(near(0.0146, 0.05), near(0.33, 0.05), near(0.26, 0.1), near(0.65, 0.03), near(49.0, 0.04), 4.0),
        astern=Curve(near(0.0116, 0.05), near(0.40, 0.05), near(0.14, 0.1), near(0.65, 0.03), near(49.5, 0.04), 3.2),
        V_ref=12.0,
        V_nominal=nominal,
        dead_band_us=float(round(rng.uniform(20, 30))),
        dead_time=whole_steps(rng.uniform(0.07, 0.13)),
        lag=near(0.11, 0.25),
        wire=[0, 1, 2, 3],
        open_V=nominal + float(rng.uniform(0.5, 0.9)),
        drop_V_Ah=float(rng.uniform(0.25, 0.45)),
        R_ohm=float(rng.uniform(0.05, 0.09)),
    )


FIX_SIGMA_M = {1: 0.10, 5: 0.07, 10: 0.05}


def _sense(rng: np.random.Generator, uwb_hz: float, imu_hz: float) -> Sense:
    def place(low: float, high: float) -> float:
        return float(f"{rng.uniform(low, high):.2f}")

    return Sense(
        imu_x=place(-0.1, 0.2),
        imu_y=place(-0.05, 0.05),
        uwb_x=place(-0.3, 0.1),
        uwb_y=place(-0.1, 0.1),
        uwb_z=-0.4,
        latency=place(0.05, 0.12),
        imu_hz=imu_hz,
        uwb_hz=uwb_hz,
        accel_sigma=float(f"{rng.uniform(0.03, 0.06):.3f}"),
        gyro_sigma=float(f"{rng.uniform(0.003, 0.006):.4f}"),
        heading_sigma=float(f"{rng.uniform(0.003, 0.006):.4f}"),
        wander=float(f"{rng.uniform(0.005, 0.010):.4f}"),
        wander_time=float(round(rng.uniform(40, 90))),
        uwb_sigma=FIX_SIGMA_M[round(uwb_hz)],
    )
