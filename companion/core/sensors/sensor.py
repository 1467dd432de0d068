"""What a sensor is: one object that knows its message, its equation, its noise and its limits.

A sensor whose measurement is a function of the motion states that function once, as `SensorChannel`s:

    z = h(motion, e) + w,   w ~ N(0, sigma^2)      e: slow errors of the sensor, states of the filter (`ErrorState`)

h is written for floats and CasADi expressions alike. The filter fuses it with its exact Jacobian
(`estimation.channel_fusion`), the simulator draws from it (`sim.world.channel_sensor`). IMU, attitude and ranges have
equations of their own in `estimation`; the rest of what is known of them is here as well.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, ClassVar, Literal, NamedTuple

from companion.core.configuration.tables import Table
from companion.core.geometry.frames import point_position, point_velocity, to_level
from companion.core.messages import Measured


class GateRule(Table, frozen=True, kw_only=True):
    """Limits of one kind of measurement (`estimation.gates`); `floor`, `ceiling`, `agreement` in its own unit."""

    limit: float
    floor: float
    ceiling: float
    reopen_count: int
    reopen_span_s: float
    agreement: float


class BodyMotion(NamedTuple):
    """Of the body origin: eta = [x y psi], nu = [u v r], tilt = [phi theta] [rad], roll_rates = [p q] [rad/s]."""

    eta: Any
    nu: Any
    tilt: Any
    roll_rates: Any


class ErrorState(NamedTuple):
    """One slow error e of a sensor, a state of the filter: e' = e exp(-dt / time_s), and a random walk.

    `sigma`: at the start; `stationary`: that of the Gauss-Markov part; `walk`: per root of a second. Unit of z.
    """

    sigma: float
    stationary: float = 0.0
    time_s: float = math.inf
    walk: float = 0.0


class SensorChannel(NamedTuple):
    """One vector that a sensor measures. `expected(motion, errors)`: h, one component for each of `axes`.

    `about`: what is uncertain again when its gate re-opens; `sigma`: white noise of a component [its unit].
    """

    name: str
    axes: tuple[str, ...]
    about: Literal["position", "velocity"]
    expected: Callable[[BodyMotion, Sequence[Any]], tuple[Any, ...]]
    sigma: float
    rule: GateRule


class ChannelReading(NamedTuple):
    """Values z of one channel."""

    channel: str
    z: tuple[float, ...]


class PositionHealth(NamedTuple):
    """When an estimate that lives on this sensor is degraded or lost. `sigma_m`: along the position's worst axis."""

    label: str
    timeout_s: float
    degraded_sigma_m: float
    lost_sigma_m: float


class PositionWords(NamedTuple):
    """How alerts speak of a sensor of positions that contradicts the motion: what may be wrong with it, its parts, and
    what it says. `counts_Hz`: so often a second contradictions count in full (`pilot.trust.sensors.motion_check`).
    """

    astray: str
    source: str
    readings: str
    counts_Hz: float = 2.0

    def weight(self, rate_Hz: float) -> float:
        """What one contradiction counts, of a sensor that measures so often: neighbouring ones share their errors."""
        return min(1.0, self.counts_Hz / rate_Hz)


POSITION_INNOVATIONS = "range", "position"
"""What the names of innovations of such a sensor begin with."""


class SensorCheck(NamedTuple):
    """A row of the pre-flight table (`preflight.rows.Row`), without its area."""

    level: Literal["ok", "warning", "refuse"]
    name: str
    found: str
    needed: str
    why: str
    fix: str = ""


class Sensor:
    """One sensor of one boat. `key`: its table in `[sensors.*]`; `label`: how people call it.

    `health`: given by a sensor of positions. `rate_Hz`: how often it measures;
    `latency_s`: how much older a measurement is than its stamp. `aids`: it corrects what the inertial
    sensors add up, and is fused after them at the same instant. Methods are pure.
    """

    key: ClassVar[str]
    label: ClassVar[str]
    messages: ClassVar[tuple[type[Measured], ...]]
    aids: ClassVar[bool] = True
    words: ClassVar[PositionWords] = PositionWords("a sensor that errs", "sensors", "readings")
    rate_Hz: float
    latency_s: float = 0.0
    channels: tuple[SensorChannel, ...] = ()
    error_states: tuple[ErrorState, ...] = ()
    health: PositionHealth | None = None

    @staticmethod
    def screen(m: Any) -> tuple[Any | None, str]:
        """The message with what is finite and within what such a sensor can measure; or None, and the reason."""
        raise NotImplementedError

    def correct(self, m: Any) -> Any:
        """The message as a sensor without the known errors of the vessel file would have sent it."""
        return m

    def measured_ns(self, m: Measured, zero_ns: int | None) -> int:
        """When it was measured [ns], never after its arrival. `zero_ns`: arrival of the first of its messages."""
        return min(m.t_ns, m.t_rx_ns) - round(self.latency_s * 1e9)

    @staticmethod
    def repeatable(m: Any) -> tuple[str, tuple[float, ...]] | None:
        """Name and numbers that a sensor in order never sends for long while the boat moves; None: not looked for."""
        return None

    def figure(self, m: Any) -> str:
        """What the sensor says of its own quality, for people; empty: nothing."""
        return ""

    def readings(self, m: Any) -> tuple[ChannelReading, ...]:
        """What a message says of each channel."""
        return ()

    def message(self, values: Mapping[str, Sequence[float]], t_ns: int) -> Measured:
        """The inverse of `readings`: the message with these values by channel (simulator)."""
        raise NotImplementedError

    def place(self, m: Any) -> tuple[float, float] | None:
        """North and east of the sensor [m], site axes, by this message alone; None: it does not say."""
        return None

    def checks(self, heard: Sequence[Any], rate_Hz: float) -> Iterator[SensorCheck]:
        """Rows of the pre-flight table, from what was heard at `rate_Hz`."""
        yield from ()


ENOUGH = 0.65
"""Share of its rate at which a sensor is often enough heard."""


def velocity_gate(sigma_m_s: float) -> GateRule:
    """Gate of a component of a velocity with this white noise; what lasts for 3 s is no outlier. Assumed."""
    return GateRule(
        limit=3.72, floor=sigma_m_s, ceiling=max(0.3, 4 * sigma_m_s), reopen_count=8, reopen_span_s=3.0,
        agreement=max(0.3, 6 * sigma_m_s),
    )  # fmt: skip


def rate_check(rate_Hz: float, wanted_Hz: float, why: str, fix: str) -> SensorCheck:
    """Row of how often a sensor is heard; `fix`: where that is too seldom."""
    enough = rate_Hz >= ENOUGH * wanted_Hz
    level = "ok" if enough else "warning"
    return SensorCheck(level, "rate", f"{rate_Hz:.1f} Hz", f"{wanted_Hz:g} Hz", why, "" if enough else fix)


def within(limit: float, *values: float) -> bool:
    """Whether all values are finite and no larger than the limit."""
    return all(math.isfinite(v) and abs(v) <= limit for v in values)


def verdict(m: Any, good: bool, kind: str) -> tuple[Any | None, str]:
    """The message, or the reason why not."""
    return (m, "") if good else (None, f"{kind}: not finite or absurd")


def place_of(motion: BodyMotion, arm_m: tuple[float, float, float]) -> tuple[Any, Any]:
    """North and east of a point of the hull [m], by its lever arm in body axes [m]; roll and pitch included."""
    x, y, _ = to_level(motion.tilt[0], motion.tilt[1], *arm_m)
    return point_position(motion.eta, (x, y))


def velocity_of(motion: BodyMotion, arm_m: tuple[float, float, float]) -> tuple[Any, Any]:
    """Its velocity over ground in level axes that keep the heading, ahead and to starboard [m/s]; small angles.

    nu + omega x l:   u + q l_z - r l_y,   v + r l_x - p l_z
    """
    x, y, z = to_level(motion.tilt[0], motion.tilt[1], *arm_m)
    u, v = point_velocity(motion.nu, (x, y))
    p, q = motion.roll_rates[0], motion.roll_rates[1]
    return u + q * z, v - p * z
