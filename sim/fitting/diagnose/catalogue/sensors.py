"""Effects of the sensors: readings = truth + error. Hooks `imu` on psi, r, a_x, a_y; hooks `tag` on positions (NED)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.core.geometry.frames import point_acceleration, unrotate
from companion.core.model.sensor_errors import drifted
from sim.fitting.diagnose.catalogue.effect import Effect, EffectParameter, Scene, TagKinematics, Values
from sim.fitting.diagnose.catalogue.parts import scalar_parameter, vector_parameters

PSI, RATE, SURGE, SWAY = range(4)
LEAN = 0.4
"""Sigma of the share of its own acceleration that a leaning boat adds, where roll and pitch are not logged; assumed."""
SECANT = 0.02  # largest step of a secant of these shares
WITH_THE_MOTION = ("imu_misalignment", "imu_lever_arm")
"""Entries that change accelerations with the motion, as lean does."""
ImuHook = Callable[[Values, Scene, np.ndarray], np.ndarray]
ACCEL_SCALE = 0.005  # sigma of the accelerometer's scale: ICM-42688-P data sheet, +-0.5 %, uncalibrated


def accelerometers(vessel: VesselFile, levelled: bool) -> Iterator[Effect]:
    """Scales of the two accelerometers, and where roll and pitch are not logged, lean: free in every fit, never named.

    Thrust, drag and weight act at different heights, so that a boat leans in proportion to its acceleration, to the
    drag of its hull, and to its turning (added mass differs ahead and across). Where roll and pitch are not logged
    (`levelled`: they are), g sin(lean) is read as acceleration.
    """
    sigma = ACCEL_SCALE if levelled else LEAN
    for axis, (name, channel) in enumerate((("x", SURGE), ("y", SWAY))):
        yield _entry(f"accel_{name}", f"a_{name} (1 + share)", _scaled(channel), {"share": sigma}, f"a{name}")
        if not levelled:
            text = f"a_{name} + drag of the hull / m + turning"
            yield _entry(f"lean_{name}", text, _leaning(vessel, channel, axis), {"drag": LEAN, "turning": LEAN})


def _entry(id: str, equation: str, hook: ImuHook, sigmas: Mapping[str, float], scales: str = "") -> Effect:
    parameters = tuple(EffectParameter(name, "1", s, s, min(s, SECANT)) for name, s in sigmas.items())
    return Effect(f"base:{id}", "base", equation, "", parameters, {"imu": hook}, scaled_reading=scales)


def _leaning(vessel: VesselFile, channel: int, axis: int) -> ImuHook:
    d, mass_kg = vessel.damping, vessel.inertia.mass_kg
    linear, quadratic = ((d.X_u_N_s_m, d.X_uu_N_s2_m2), (d.Y_v_N_s_m, d.Y_vv_N_s2_m2))[axis]

    def hook(p: Values, scene: Scene, y: np.ndarray) -> np.ndarray:
        out, along = y.copy(), scene.nu_r[..., axis]
        turning = scene.r_rad_s * (-scene.v_m_s, scene.u_m_s)[axis]
        drag = (linear + quadratic * np.abs(along)) * along / mass_kg
        out[..., channel] += p["drag"] * drag + p["turning"] * turning
        return out

    return hook


def _scaled(channel: int) -> ImuHook:
    def hook(p: Values, scene: Scene, y: np.ndarray) -> np.ndarray:
        out = y.copy()
        out[..., channel] *= 1 + p["share"]
        return out

    return hook


def effects(vessel: VesselFile, levelled: bool) -> Iterator[Effect]:
    """Entries of the sensors that can be named; what only ranges have, not for a boat without UWB.

    Where roll and pitch are not known (`levelled`: they are), none that changes accelerations with the motion, as lean
    does.
    """
    uwb = vessel.sensors.uwb is not None
    yield from (e for e in _inertial() if levelled or e.id not in WITH_THE_MOTION)
    yield from _heading(uwb)
    yield from _positions(uwb)


def added(**terms: Callable[[Values, Scene, np.ndarray], np.ndarray | float]) -> ImuHook:
    """Hook that adds `terms` (p, scene, y) to channels by name: psi [rad], r [rad/s], ax, ay [m/s^2]."""
    index = {"psi": PSI, "r": RATE, "ax": SURGE, "ay": SWAY}

    def hook(p: Values, scene: Scene, y: np.ndarray) -> np.ndarray:
        out = y.copy()
        for name, term in terms.items():
            out[..., index[name]] += term(p, scene, y)
        return out

    return hook


def _inertial() -> Iterator[Effect]:
    def entry(
        id: str, equation: str, signature: str, parameters: tuple[EffectParameter, ...], hook: ImuHook, scales: str = ""
    ) -> Effect:
        several = len(parameters) > 1
        return Effect(
            id, "sensors", equation, signature, parameters, {"imu": hook}, vector=several, scaled_reading=scales
        )

    yield Effect(
        "accel_bias",
        "sensors",
        "a + b",
        "specific force that never goes away, the same whatever the boat does",
        vector_parameters("b_x_m_s2", "b_y_m_s2", "m/s^2", 0.1, 0.02),
        {"imu": added(ax=lambda p, s, y: p["b_x_m_s2"], ay=lambda p, s, y: p["b_y_m_s2"])},
        vector=True,
        same_as=("tilt",),
    )
    yield entry(
        "gyro_bias",
        "r + b",
        "yaw rate that the heading does not follow, also at rest",
        scalar_parameter("b_r_rad_s", "rad/s", 0.01, 0.002),
        added(r=lambda p, s, y: p["b_r_rad_s"]),
    )
    yield entry(
        "gyro_scale",
        "r (1 + scale)",
        "yaw rate larger than the change of heading, in proportion",
        scalar_parameter("scale", "1", 0.1, 0.02),
        added(r=lambda p, s, y: p["scale"] * y[..., RATE]),
        scales="r",
    )
    yield entry(
        "imu_misalignment",
        "a turned by an angle about z",
        "sideways force in pure surge and the other way round",
        scalar_parameter("yaw_deg", "deg", 6.0, 1.5),
        _misaligned,
    )
    yield entry(
        "imu_lever_arm",
        "a - r^2 l + r_dot x l",
        "specific force with every turn, as if the sensor sat elsewhere",
        vector_parameters("x_m", "y_m", "m", 0.2, 0.04),
        added(
            ax=lambda p, s, y: _of_arm(p, s)[0],
            ay=lambda p, s, y: _of_arm(p, s)[1],
        ),
    )


def _of_arm(p: Values, scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Specific force [m/s^2] that an IMU feels more where it is off its place by (x_m, y_m)."""
    turning, quickening = (0.0, 0.0, scene.r_rad_s), (0.0, 0.0, scene.nu_dot[..., 2])
    return point_acceleration(turning, quickening, (p["x_m"], p["y_m"]))


def _misaligned(p: Values, scene: Scene, y: np.ndarray) -> np.ndarray:
    out = y.copy()
    out[..., SURGE], out[..., SWAY] = unrotate(float(np.radians(p["yaw_deg"])), y[..., SURGE], y[..., SWAY])
    return out


def _heading(uwb: bool) -> Iterator[Effect]:
    yield Effect(
        "heading_offset",
        "sensors",
        "psi + offset",
        "goes off to one side of where it points, by a constant angle",
        scalar_parameter("offset_deg", "deg", 5.0, 1.0),
        {"imu": added(psi=lambda p, s, y: np.radians(p["offset_deg"]))},
        same_as=("uwb_rotation",) if uwb else (),
    )
    yield Effect(
        "hard_iron",
        "sensors",
        "psi + a cos psi + b sin psi",
        "heading error that depends on the heading",
        vector_parameters("cos_deg", "sin_deg", "deg", 5.0, 1.0),
        {"imu": added(psi=_iron)},
        vector=True,
    )


def _iron(p: Values, scene: Scene, y: np.ndarray) -> np.ndarray:
    return np.radians(p["cos_deg"] * np.cos(scene.psi_rad) + p["sin_deg"] * np.sin(scene.psi_rad))


def _of_positions(
    id: str, equation: str, signature: str, parameters: tuple[EffectParameter, ...], hook: Callable, scales: str = ""
) -> Effect:
    several = len(parameters) > 1
    return Effect(id, "sensors", equation, signature, parameters, {"tag": hook}, vector=several, scaled_reading=scales)


def _late(tag: TagKinematics, delay_s: np.ndarray) -> np.ndarray:
    """p(t - delay) - p(t), second order."""
    return -delay_s[:, None] * tag.velocity_m_s + (delay_s**2 / 2)[:, None] * tag.acceleration_m_s2


def _positions(uwb: bool) -> Iterator[Effect]:
    """Of the UWB tag or the GNSS antenna. A clock of its own, and distances that are too long, only UWB has."""
    sensor = "uwb" if uwb else "gnss"
    yield _of_positions(
        f"{sensor}_latency",
        "p(t - latency)",
        "positions lag behind in proportion to speed",
        scalar_parameter("latency_s", "s", 0.2, 0.04),
        lambda p, tag, place: place + _late(tag, np.full(len(place), p["latency_s"])),
    )
    if uwb:
        yield _of_positions(
            "clock_drift",
            "p(t - drift t)",
            "positions lag more and more",
            scalar_parameter("drift", "s/s", 1.5e-3, 3e-4),
            lambda p, tag, place: place + _late(tag, drifted(p["drift"], tag.t_s)),
        )
    yield _of_positions(
        f"{sensor}_lever_arm",
        "p + R l",
        "positions circle when the boat turns on the spot",
        vector_parameters("x_m", "y_m", "m", 0.15, 0.03),
        lambda p, tag, place: place + tag.carried(p["x_m"], p["y_m"]),
    )
    if uwb:
        yield _of_positions(
            "uwb_scale",
            "(1 + scale) p",
            "distances over ground too long or too short against speed and inertial sensors",
            scalar_parameter("scale", "1", 0.05, 0.01),
            lambda p, tag, place: place + p["scale"] * (place - tag.centre_m),
            scales="place",
        )
