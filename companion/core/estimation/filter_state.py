"""The filter at one instant, as a value: state, covariance, thruster forces, gates.

x = [x y psi | u v r | X_d Y_d N_d | b_ax b_ay | b_gz | b_psi | phi theta | b_gx b_gy | c_gx c_gy c_gz | e_1 .. e_k]

c: how fast the gyro's biases drift [rad/s^2].
e: slow errors of the other sensors (`Sensor.error_states`), in the order of the boat's table; of UWB a bias an anchor.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import msgspec
import numpy as np

from companion.core.estimation.gates import Gate
from companion.core.estimation.latent_activity import CALM, Activity, LatentMeans
from companion.core.estimation.ranging.ranges import AnchorHistory, RangeLayout
from companion.core.messages import Innovation, Measured

ETA, NU, LATENT = slice(0, 3), slice(3, 6), slice(6, 9)
DYNAMIC, SPEED = slice(0, 9), slice(3, 5)
NU_INDICES, LATENT_INDICES = range(3, 6), range(6, 9)
B_ACCEL, B_GYRO, B_PSI = slice(9, 11), 11, 12
TILT, B_TILT, B_RANGE = slice(13, 15), slice(15, 17), 20
B_GYRO_XYZ, GYRO_DRIFT = [*range(B_TILT.start, B_TILT.stop), B_GYRO], [17, 18, 19]
"""Lists of indices: the gyro's biases about x, y, z, and how fast they drift."""
R = 5
LAYOUT = RangeLayout(position=(0, 1), velocity=(3, 4), bias=B_RANGE)

Rates = tuple[float, float, float]
"""p, q, r."""


class Tilt(NamedTuple):
    """Roll and pitch [rad]."""

    phi_rad: float = 0.0
    theta_rad: float = 0.0


class AgreedPlace(NamedTuple):
    """Of the body origin, and since when ranges agree on it."""

    t_ns: int
    north_m: float
    east_m: float


class AccelerometerNoise(NamedTuple):
    """Mean `variance` [m^2/s^4] of an axis by the second differences of specific force, and its last two values."""

    variance: float = 0.0
    last: tuple[tuple[float, float], ...] = ()


class FilterState(msgspec.Struct, frozen=True, kw_only=True):
    """State x (20 + k,) with covariance P at t_ns; arrays are never changed in place.

    `f_n`: thruster forces delivered now [N]. `rates_rad_s`, `rates_ns`: p, q, r of the last attitude, and when;
    `slopes_rad_s2`: their slopes by the last two attitudes, 0 after a gap. `gates`: of components of channels, by name.
    `imu_ns`, `position_ns`, `ranges_ns`: the last IMU sample, accepted position, ranges. `accelerometers`: how noisy
    they are. `since_ns`: the start, or the end of the last gap in all sensors, or in positions while speed was not
    known; `fixes`: positions accepted since then; `settled`: speed is known since then. `displaced_ns`: when positions
    last moved the boat against its motion; `astray`: another place on which ranges agree since then. `doubt`: the
    cumulative sum of `model_confidence`; `activity`: of the latent force, see `latent_activity`; `latent_means`: of it.
    """

    t_ns: int
    x: np.ndarray
    P: np.ndarray
    f_n: np.ndarray
    rates_rad_s: Rates
    rates_ns: int
    slopes_rad_s2: Rates = (0.0, 0.0, 0.0)
    anchor_gates: tuple[Gate, ...]
    heading_gate: Gate
    position_gates: tuple[Gate, ...]
    gates: Mapping[str, Gate] = msgspec.field(default_factory=dict)
    latest: tuple[AnchorHistory | None, ...]
    imu_ns: int | None
    accelerometers: AccelerometerNoise = AccelerometerNoise()
    position_ns: int
    ranges_ns: int | None
    since_ns: int
    fixes: int = 0
    settled: bool = False
    displaced_ns: int | None = None
    astray: AgreedPlace | None = None
    doubt: float = 0.0
    activity: Activity = CALM
    latent_means: LatentMeans = LatentMeans()

    @property
    def tilt(self) -> Tilt:
        """Roll and pitch [rad]."""
        return Tilt(float(self.x[TILT.start]), float(self.x[TILT.start + 1]))

    @property
    def is_finite(self) -> bool:
        """Whether all numbers of state and covariance are."""
        return math.isfinite(self.x.sum() + self.P.sum())

    def was_displaced(self, t_ns: int, within_s: float) -> bool:
        """Whether positions moved the boat against its motion so short a time before `t_ns`."""
        return self.displaced_ns is not None and 0 <= t_ns - self.displaced_ns < within_s * 1e9

    def is_settling(self, most_s: float) -> bool:
        """Whether speed is not known yet, at most so long after the start or the last gap."""
        return not self.settled and self.t_ns - self.since_ns <= most_s * 1e9


class BufferedMeasurement(NamedTuple):
    """One message at the instant when it was measured, and the filter after it."""

    t_ns: int
    message: Measured
    belief: FilterState


Result = tuple[FilterState, tuple[Innovation, ...]]


def innovation_message(t_ns: int, sensor: str, nu: np.ndarray, S: np.ndarray, accepted: bool) -> Innovation:
    """The message for one measurement, d2 = nu^T S^-1 nu."""
    d2 = float(nu[0] ** 2 / S[0, 0]) if len(nu) == 1 else float(nu @ np.linalg.solve(S, nu))
    return Innovation(
        t_ns=t_ns, sensor=sensor, innovation=tuple(nu.tolist()), S=tuple(S.ravel().tolist()), d2=d2,
        accepted=accepted,
    )  # fmt: skip
