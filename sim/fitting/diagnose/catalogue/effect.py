"""An entry of the catalogue: one way in which boat, water or sensors may differ from what the vessel file says.

An effect is a table row plus one line of physics, written as hooks. A hook takes the effect's parameters `p` by name
(zero: as in the vessel file), the `Scene` or `TagKinematics`, and the value so far; it returns the new value:

    hull     (p, c)             coefficients by name, as `sim.fitting.engine.parameters.HULL`
    pwm      (p, pwm_us)        pulse widths (c, n) as they reach the ESCs
    maps     (p, vessel)        the vessel file's force maps and propulsion table: dead time, lag, rate limit
    thrust   (p, scene, f)      thruster forces (W, k, n) [N]
    water    (p, scene)         velocity of the water over ground, north and east, (W, k, 2) [m/s]
    force    (p, scene)         body force (W, k, 3) [N, N, N m]
    imu      (p, scene, y)      readings psi, r, a_x, a_y of heading, gyro and accelerometers, (W, k, 4)
    tag      (p, tag, place)    predicted position samples, (m, 2) [m]

W: windows, k: instants of a window, n: thrusters, m: position samples. Hooks act on whole logs at once (numpy arrays),
so that a user's entry is as fast as a built-in one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from companion.core.geometry.frames import unrotate

Values = Mapping[str, float]
Hook = Callable[..., Any]
TOLERANCE = 0.35  # sigma of a tolerance band over the smallest size worth a name; assumed
ABSENT = 1e-3  # the same of an entry that is practically held at zero; of a place or time: over its prior
READINGS = ("psi", "r", "ax", "ay", "place")
STAGES = ("hull", "pwm", "maps", "thrust", "water", "force", "imu", "tag")


@dataclass(frozen=True)
class EffectParameter:
    """One parameter of an effect, in `unit`.

    `prior`, `mean`: sigma and mean of its normal prior while the effect is active; a mean other than zero with a narrow
    prior makes an effect that is present as a whole or not at all. `smallest`: size below which it is not worth a name.
    `step`: step of the secant by which its Jacobian column is taken. `lower`, `upper`: physical limits.
    """

    name: str
    unit: str
    prior: float
    smallest: float
    step: float
    lower: float = -np.inf
    upper: float = np.inf
    mean: float = 0.0


@dataclass(frozen=True)
class Effect:
    """One entry of the catalogue. `equation` and `signature` are text for the report.

    id, family      key of its parameters in a fit; hull, propulsion, environment, sensors, or base (never named)
    parameters      P numbers, zero where the effect is absent; a parameter of infinite smallest size is a place or time
    hooks           physics by stage, see the module
    vector          the first two parameters are components of one vector, whose norm is the size
    same_as         names of effects with the same signature in every log: one equivalence class
    variant_of      name of the family of entries that differ in place or onset only; empty: `id` is the name
    origin          by parameter, what is added to the fit's value to get the full value (the onset, the zone's centre)
    nonlinear       so far from linear that a tolerance band means nothing: only tried as an active effect
    scaled_reading  reading (one of `READINGS`) that its one parameter p multiplies by 1 + p
    start_entries   entries of other `origin` between this one and its neighbours, from the best of which a fit starts
    contains        name of a simpler entry that is a special case of this one
    essential       parameter that must surely be above zero, or the entry is another effect; empty: none

    ValueError for an unknown hook or reading.
    """

    id: str
    family: str
    equation: str
    signature: str
    parameters: tuple[EffectParameter, ...]
    hooks: Mapping[str, Hook]
    vector: bool = False
    same_as: tuple[str, ...] = ()
    variant_of: str = ""
    origin: Mapping[str, float] = field(default_factory=dict)
    nonlinear: bool = False
    scaled_reading: str = ""
    start_entries: Callable[[], Sequence[Effect]] | None = None
    contains: str = ""
    essential: str = ""

    def __post_init__(self) -> None:
        if unknown := set(self.hooks) - set(STAGES):
            raise ValueError(f"effect {self.id}: unknown hook {sorted(unknown)[0]!r}; there are {', '.join(STAGES)}")
        if self.scaled_reading and self.scaled_reading not in READINGS:
            raise ValueError(
                f"effect {self.id}: unknown reading {self.scaled_reading!r}; there are {', '.join(READINGS)}"
            )

    @property
    def name(self) -> str:
        """Name in findings."""
        return self.variant_of or self.id

    @property
    def always_free(self) -> bool:
        """Whether its parameters are free in every fit, within their tolerance bands at least."""
        return not (self.nonlinear or self.origin)

    @property
    def all_or_nothing(self) -> bool:
        """Whether it is present as a whole or not at all."""
        return any(p.mean for p in self.parameters)

    def size(self, values: np.ndarray) -> float:
        """Size of parameter values (P,) in units of the smallest size worth a name."""
        shares = np.asarray(values) / np.array([p.smallest for p in self.parameters])
        return float(np.linalg.norm(shares)) if self.vector else float(np.abs(shares).max())

    def wide_prior(self) -> tuple[np.ndarray, np.ndarray]:
        """Sigma and mean (P,) of the parameters' normal prior while the effect is active."""
        return np.array([p.prior for p in self.parameters]), np.array([p.mean for p in self.parameters])

    def by_name(self, values: Iterable[Any]) -> dict[str, Any]:
        """Full values, `origin` added, of `values` (P, ..), by name of the parameter."""
        return {p.name: v + self.origin.get(p.name, 0.0) for p, v in zip(self.parameters, values, strict=True)}

    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper physical limit of each parameter, (P,)."""
        return np.array([p.lower for p in self.parameters]), np.array([p.upper for p in self.parameters])

    def tolerance(self) -> np.ndarray:
        """Sigma (P,) of the tolerance band: the prior round zero while the effect is not active.

        Practically zero for variants (of many places or onsets at most one is true) and for nonlinear entries.
        """
        if self.family == "base":
            return np.array([p.prior for p in self.parameters])
        share = TOLERANCE if self.always_free else ABSENT
        return np.array([share * p.smallest if np.isfinite(p.smallest) else ABSENT * p.prior for p in self.parameters])

    def held_at_zero(self) -> Effect:
        """The same effect with a tolerance band that holds it at zero in practice."""
        share = ABSENT * ABSENT / TOLERANCE
        return replace(self, parameters=tuple(replace(p, smallest=share * p.smallest) for p in self.parameters))


@dataclass(frozen=True)
class Scene:
    """The boat's motion at the k instants of all W windows, as hooks see it.

    t_s, clock_s    (W, k) time since the beginning of the log, and on the clock that all logs share [s]
    x               (W, k, 6) states [x y psi u v r]: NED position [m], heading [rad], body velocities [m/s, m/s, rad/s]
    nu_dot          (W, k, 3) body accelerations [m/s^2, m/s^2, rad/s^2]
    log             (W,) index of the log
    centre_m        (2,) mean of all position samples, north and east [m]
    middle_s        middle of the shared clock [s]
    water           (W, k, 2) velocity of the water over ground, north and east [m/s]; None: at rest
    hull            coefficients of the hull by name with their effects applied; None: as in the vessel file
    """

    t_s: np.ndarray
    clock_s: np.ndarray
    x: np.ndarray
    nu_dot: np.ndarray
    log: np.ndarray
    centre_m: np.ndarray
    middle_s: float
    water: np.ndarray | None = None
    hull: Mapping[str, float] | None = None

    def part(self, steps: int) -> Scene:
        """The same of the first `steps` instants of each window."""
        t, clock, x, nu_dot = (a[:, :steps] for a in (self.t_s, self.clock_s, self.x, self.nu_dot))
        water = None if self.water is None else self.water[:, :steps]
        return Scene(t, clock, x, nu_dot, self.log, self.centre_m, self.middle_s, water, self.hull)

    @property
    def north_m(self) -> np.ndarray:
        """North of the body origin, (W, k)."""
        return self.x[..., 0]

    @property
    def east_m(self) -> np.ndarray:
        """East of the body origin, (W, k)."""
        return self.x[..., 1]

    @property
    def psi_rad(self) -> np.ndarray:
        """Heading, unwrapped, (W, k)."""
        return self.x[..., 2]

    @property
    def u_m_s(self) -> np.ndarray:
        """Surge over ground, (W, k)."""
        return self.x[..., 3]

    @property
    def v_m_s(self) -> np.ndarray:
        """Sway over ground, (W, k)."""
        return self.x[..., 4]

    @property
    def r_rad_s(self) -> np.ndarray:
        """Yaw rate, (W, k)."""
        return self.x[..., 5]

    @cached_property
    def nu_r(self) -> np.ndarray:
        """Velocity through the water nu_r = nu - R^T(psi) `water`, (W, k, 3) [m/s, m/s, rad/s]. Read-only."""
        if self.water is None:
            return self.x[..., 3:]
        u_c, v_c = unrotate(self.psi_rad, self.water[..., 0], self.water[..., 1])
        through = self.x[..., 3:] - np.stack([u_c, v_c, 0 * u_c], axis=-1)
        through.flags.writeable = False  # it is handed out again
        return through

    @property
    def nu_r_dot(self) -> np.ndarray:
        """Acceleration through the water, (W, k, 3): nu_dot less that of water which turns in body axes."""
        u_c, v_c = (self.x[..., 3 + i] - self.nu_r[..., i] for i in (0, 1))
        return self.nu_dot - np.stack([self.r_rad_s * v_c, -self.r_rad_s * u_c, 0 * u_c], axis=-1)


@dataclass(frozen=True)
class TagKinematics:
    """Predicted motion of the UWB tag at the m position samples, NED.

    t_s, clock_s                     (m,) since the log's first position, where a clock begins to drift; shared [s]
    psi_rad, r_rad_s                 (m,) heading and yaw rate of the boat
    place_m, velocity_m_s, acceleration_m_s2   (m, 2) of the tag, north and east
    centre_m                         (2,) mean of all position samples
    carried                          displacement (m, 2) of a point further ahead and to starboard by x, y [m]
    """

    t_s: np.ndarray
    clock_s: np.ndarray
    psi_rad: np.ndarray
    r_rad_s: np.ndarray
    place_m: np.ndarray
    velocity_m_s: np.ndarray
    acceleration_m_s2: np.ndarray
    centre_m: np.ndarray
    carried: Callable[[float, float], np.ndarray]


def parameter_slices(effects: Sequence[Effect]) -> dict[str, slice]:
    """By effect id, the slice of its parameters in the stacked vector (P,) of all `effects`."""
    columns, start = {}, 0
    for e in effects:
        columns[e.id] = slice(start, start + len(e.parameters))
        start += len(e.parameters)
    return columns
