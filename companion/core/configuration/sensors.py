"""Sensors of a vessel file: IMU, and one sensor of positions, UWB or GNSS. Reference: docs/vessel-file.md."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import msgspec
from msgspec.structs import replace

from companion.core.configuration.tables import ConfigError, SourcedTable, Table

Arm = Annotated[float, msgspec.Meta(ge=-30, le=30)]
"""A place in the hull [m], from its origin."""
MOST_HARD_IRON_RAD = 0.5
HardIronRad = Annotated[float, msgspec.Meta(ge=-MOST_HARD_IRON_RAD, le=MOST_HARD_IRON_RAD)]


class Imu(SourcedTable, frozen=True, kw_only=True):
    """IMU and attitude. Lever arm from the origin [m]; noise is one sigma of a sample at `rate_Hz`.

    The keys with a default of 0 behind the noise are known errors; equations in `sensor_errors`.
    """

    x_m: Arm = 0.0
    y_m: Arm = 0.0
    z_m: Arm = 0.0
    rate_Hz: Annotated[float, msgspec.Meta(ge=0.1, le=1000)]
    accel_sigma_m_s2: Annotated[float, msgspec.Meta(ge=1e-6, le=20)]
    accel_bias_sigma_m_s2: Annotated[float, msgspec.Meta(ge=0, le=20)]
    accel_bias_walk_m_s2_sqrt_s: Annotated[float, msgspec.Meta(ge=0, le=1)]
    gyro_sigma_rad_s: Annotated[float, msgspec.Meta(ge=1e-7, le=5)]
    gyro_bias_sigma_rad_s: Annotated[float, msgspec.Meta(ge=0, le=5)]
    gyro_bias_walk_rad_s_sqrt_s: Annotated[float, msgspec.Meta(ge=0, le=1)]
    heading_sigma_rad: Annotated[float, msgspec.Meta(ge=1e-6, le=3.15)]
    heading_wander_sigma_rad: Annotated[float, msgspec.Meta(ge=0, le=3.15)]
    heading_wander_time_s: Annotated[float, msgspec.Meta(ge=0.01, le=1e6)]
    accel_bias_x_m_s2: Annotated[float, msgspec.Meta(ge=-5, le=5)] = 0.0
    accel_bias_y_m_s2: Annotated[float, msgspec.Meta(ge=-5, le=5)] = 0.0
    gyro_bias_rad_s: Annotated[float, msgspec.Meta(ge=-1, le=1)] = 0.0
    gyro_scale: Annotated[float, msgspec.Meta(ge=-0.5, le=0.5)] = 0.0
    misalignment_rad: Annotated[float, msgspec.Meta(ge=-3.15, le=3.15)] = 0.0
    heading_offset_rad: Annotated[float, msgspec.Meta(ge=-3.15, le=3.15)] = 0.0
    hard_iron_cos_rad: HardIronRad = 0.0
    hard_iron_sin_rad: HardIronRad = 0.0


class Uwb(SourcedTable, frozen=True, kw_only=True):
    """UWB tag. Lever arm [m]; `latency_s` from measuring to the arrival of the bytes, growing by `clock_drift_s_s`
    since the first of them; `scale`: how much too far from the site's origin it appears; `nlos_*`: of which part of the
    measurements an anchor is out of sight. Equations in `sensor_errors`.
    """

    x_m: Arm = 0.0
    y_m: Arm = 0.0
    z_m: Arm = 0.0
    rate_Hz: Annotated[float, msgspec.Meta(ge=0.01, le=1000)]
    range_sigma_m: Annotated[float, msgspec.Meta(ge=1e-5, le=20)]
    range_bias_sigma_m: Annotated[float, msgspec.Meta(ge=0, le=20)]
    latency_s: Annotated[float, msgspec.Meta(ge=0, le=1.0)]
    clock_drift_s_s: Annotated[float, msgspec.Meta(ge=-0.05, le=0.05)] = 0.0
    scale: Annotated[float, msgspec.Meta(ge=-0.5, le=0.5)] = 0.0
    nlos_share: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.0
    nlos_extra_m: Annotated[float, msgspec.Meta(ge=0, le=100)] = 0.0
    nlos_anchor: str = ""
    wire_format: str


FIX_TYPES = {"3d": 3, "dgps": 4, "float": 5, "fixed": 6}
"""Least quality of a fix by name -> GPS_FIX_TYPE of MAVLink."""


class Gnss(SourcedTable, frozen=True, kw_only=True):
    """GNSS receiver behind the autopilot. Lever arm of its antenna [m]; equations in `core.sensors.gnss`.

    `position_sigma_m`: white noise of one coordinate of a fix; `position_wander_sigma_m`: error that wanders, with
    correlation time `position_wander_time_s`; `velocity_sigma_m_s`: white noise of a component of the velocity;
    `latency_s`: how much older a fix is than its stamp; `fix`: least quality of a position that is used.
    """

    x_m: Arm = 0.0
    y_m: Arm = 0.0
    z_m: Arm = 0.0
    rate_Hz: Annotated[float, msgspec.Meta(ge=0.01, le=1000)]
    position_sigma_m: Annotated[float, msgspec.Meta(ge=1e-5, le=20)]
    position_wander_sigma_m: Annotated[float, msgspec.Meta(ge=0, le=20)] = 0.0
    position_wander_time_s: Annotated[float, msgspec.Meta(ge=1, le=1e6)] = 120.0
    velocity_sigma_m_s: Annotated[float, msgspec.Meta(ge=1e-3, le=5)] = 0.05
    latency_s: Annotated[float, msgspec.Meta(ge=0, le=1.0)]
    fix: Literal["3d", "dgps", "float", "fixed"] = "3d"


class Dvl(SourcedTable, frozen=True, kw_only=True):
    """Doppler velocity log on a wire of its own. Lever arm [m]; `azimuth_deg`: of its x axis, clockwise from ahead;
    `velocity_sigma_m_s`: white noise of a component; `latency_s`: beyond what its own stamps account for.
    """

    x_m: Arm = 0.0
    y_m: Arm = 0.0
    z_m: Arm = 0.0
    azimuth_deg: Annotated[float, msgspec.Meta(ge=-360, le=360)] = 0.0
    rate_Hz: Annotated[float, msgspec.Meta(ge=0.1, le=50)]
    velocity_sigma_m_s: Annotated[float, msgspec.Meta(ge=1e-3, le=5)]
    latency_s: Annotated[float, msgspec.Meta(ge=0, le=1.0)] = 0.0


class Sensors(Table, frozen=True, kw_only=True):
    """What the boat measures with: an IMU, one sensor of positions, UWB or GNSS, and perhaps a DVL."""

    imu: Imu
    uwb: Uwb | None = None
    gnss: Gnss | None = None
    dvl: Dvl | None = None

    @property
    def position(self) -> Uwb | Gnss:
        """The sensor of positions."""
        sensor = self.uwb or self.gnss
        if sensor is None:
            raise ConfigError("sensors: expected a table uwb or gnss, found neither")
        return sensor

    @property
    def tag(self) -> Uwb:
        """The UWB tag, without which a boat cannot be driven. Raises ConfigError where there is none."""
        if self.uwb is None:
            raise ConfigError("sensors.uwb: missing table")
        return self.uwb

    @property
    def position_sigma_m(self) -> float:
        """Error of one coordinate of a position; of UWB the noise of a range stands for it (assumed). That a fix of
        GNSS wanders slowly is left out of account: the whole of its error counts in each of them.
        """
        if isinstance(self.position, Uwb):
            return self.position.range_sigma_m
        return math.hypot(self.position.position_sigma_m, self.position.position_wander_sigma_m)

    @property
    def position_bias_sigma_m(self) -> float:
        """Error of positions that changes with the place: what anchors make; GNSS has none."""
        return self.uwb.range_bias_sigma_m if self.uwb else 0.0

    def with_position(self, **keys: float | str) -> Sensors:
        """These sensors with `keys` of the sensor of positions changed."""
        return replace(self, **{"uwb" if self.uwb else "gnss": replace(self.position, **keys)})
