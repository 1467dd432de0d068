"""An entry of the catalogue: one way in which boat, water or sensors may differ from what the vessel file says.

An effect is a table row plus one line of physics, written as hooks. A hook takes the effect's parameters `p` by name
(zero: as in the vessel file), the `Scene` or `TagKinematics`, and the value so far; it returns the new value:

    hull     (p, c)             coefficients by name, as `sim.fitting.engine.parameters.HULL`
    pwm      (p, pwm_us)        pulse widths (c, n) as they reach the ESCs
    maps     (p, vessel)        the vessel file's force maps and propulsion table: dead time, lag, rate limit
    thrust   (p, scene, f)      thruster forces (W, k, n) [N]
    water    (p, scene)         velocity of the water over ground, north and east, (W, k, 2) [m/s]
    force    (p, scene)         body force (W, k, 3) [N, N, N m]
    imu      (p, scene, y)      psi, r, a_x, a_y as the sensors say, (W, k, 4)
    tag      (p, sight, place)  position samples, (m, 2) [m]

Hooks work on whole logs at once (numpy arrays), so an entry is as quick as the built-in ones whoever writes it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from companion.core.geometry.frames import unrotate

Values = Mapping[str, float]
Hook = Callable[..., Any]
TOLERANCE = 0.35  # of the smallest size worth a name; assumed: of three such imperfections one is larger
ABSENT = 1e-3  # of the smallest size, or of the prior of where and when: as good as not there
READINGS = ("psi", "r", "ax", "ay", "place")
STAGES = ("hull", "pwm", "maps", "thrust", "water", "force", "imu", "tag")


@dataclass(frozen=True)
class EffectParameter:
    """One number of an effect.

    `prior`: sigma when the effect is believed in; `smallest`: size below which it is not worth a name; `step`: how
    far its secant reaches; `lower`, `upper`: what is physically possible. `mean`: round which it is believed; with a
    narrow prior this is an effect that is there as a whole or not at all.
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
    """One entry. `id`: as in findings; `equation`, `signature`: for people.

    `same_as`: effects that no log can tell from it. `vector`: the first two parameters are components and their size
    is the norm. A parameter whose smallest size is infinite says where or when, not how much. `of`: the entry that this
    one is a variant of (another onset, another place): they answer to one name. `origin`: what to add to a parameter
    to say it in full. `far`: so unlike the base that its tolerance band says nothing: tried only as a whole. `scales`:
    the readings (one of `READINGS`) that its one parameter p multiplies by 1 + p. `starts`: entries of the same
    parameters between it and its neighbours, which differ in `origin` alone: a fit begins at the best of them.
    `contains`: the name of a simpler entry that is a special case of this one.
    """

    id: str
    family: str
    equation: str
    signature: str
    parameters: tuple[EffectParameter, ...]
    hooks: Mapping[str, Hook]
    vector: bool = False
    same_as: tuple[str, ...] = ()
    of: str = ""
    origin: Mapping[str, float] = field(default_factory=dict)
    far: bool = False
    scales: str = ""
    starts: Callable[[], Sequence[Effect]] | None = None
    contains: str = ""

    def __post_init__(self) -> None:
        if unknown := set(self.hooks) - set(STAGES):
            raise ValueError(f"effect {self.id}: unknown hook {sorted(unknown)[0]!r}; there are {', '.join(STAGES)}")
        if self.scales and self.scales not in READINGS:
            raise ValueError(f"effect {self.id}: unknown reading {self.scales!r}; there are {', '.join(READINGS)}")

    @property
    def name(self) -> str:
        """What it is called in findings."""
        return self.of or self.id

    @property
    def everyday(self) -> bool:
        """Free in every fit, within its tolerance band at least."""
        return not (self.far or self.origin)

    @property
    def whole(self) -> bool:
        """There as a whole or not at all."""
        return any(p.mean for p in self.parameters)

    def size(self, values: np.ndarray) -> float:
        """How large, in units of the smallest size worth a name."""
        shares = np.asarray(values) / np.array([p.smallest for p in self.parameters])
        return float(np.linalg.norm(shares)) if self.vector else float(np.abs(shares).max())

    def believed(self) -> tuple[np.ndarray, np.ndarray]:
        """Sigma and mean of each parameter while the effect is believed in, (k,)."""
        return np.array([p.prior for p in self.parameters]), np.array([p.mean for p in self.parameters])

    def by_name(self, values: Iterable[Any]) -> dict[str, Any]:
        """Values (k, ..) by the names of the parameters, origin added."""
        return {p.name: v + self.origin.get(p.name, 0.0) for p, v in zip(self.parameters, values, strict=True)}

    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and greatest value of each parameter, (k,)."""
        return np.array([p.lower for p in self.parameters]), np.array([p.upper for p in self.parameters])

    def tolerance(self) -> np.ndarray:
        """Sigma of each parameter while the effect is not believed in, (k,). Of many places only one is true."""
        if self.family == "base":
            return np.array([p.prior for p in self.parameters])
        share = TOLERANCE if self.everyday else ABSENT
        return np.array([share * p.smallest if np.isfinite(p.smallest) else ABSENT * p.prior for p in self.parameters])


@dataclass(frozen=True)
class Scene:
    """All instants of all windows, (W, k): what hooks may ask of the boat's motion.

    `t_s` of the log and `clock_s` that all logs share, shape (W, k); `x` (W, k, 6) = [x y psi u v r]; `nu_dot`
    (W, k, 3); `log` (W,): index of the log; `centre_m`: middle of all positions; `middle_s`: of the shared clock;
    `water` (W, k, 2): north and east velocity of the water, the file's and what effects have brought (None: nil) [m/s].
    """

    t_s: np.ndarray
    clock_s: np.ndarray
    x: np.ndarray
    nu_dot: np.ndarray
    log: np.ndarray
    centre_m: np.ndarray
    middle_s: float
    water: np.ndarray | None = None

    def part(self, steps: int) -> Scene:
        """The first `steps` instants of each window."""
        t, clock, x, nu_dot = (a[:, :steps] for a in (self.t_s, self.clock_s, self.x, self.nu_dot))
        water = None if self.water is None else self.water[:, :steps]
        return Scene(t, clock, x, nu_dot, self.log, self.centre_m, self.middle_s, water)

    @property
    def north_m(self) -> np.ndarray:
        """Of the body origin."""
        return self.x[..., 0]

    @property
    def east_m(self) -> np.ndarray:
        """Of the body origin."""
        return self.x[..., 1]

    @property
    def psi_rad(self) -> np.ndarray:
        """Heading, unwrapped."""
        return self.x[..., 2]

    @property
    def u_m_s(self) -> np.ndarray:
        """Surge over ground."""
        return self.x[..., 3]

    @property
    def v_m_s(self) -> np.ndarray:
        """Sway over ground."""
        return self.x[..., 4]

    @property
    def r_rad_s(self) -> np.ndarray:
        """Yaw rate."""
        return self.x[..., 5]

    @cached_property
    def nu_r(self) -> np.ndarray:
        """Surge, sway and yaw rate through the water, (W, k, 3): u v r less R^T `water`."""
        if self.water is None:
            return self.x[..., 3:]
        u_c, v_c = unrotate(self.psi_rad, self.water[..., 0], self.water[..., 1])
        through = self.x[..., 3:] - np.stack([u_c, v_c, 0 * u_c], axis=-1)
        through.flags.writeable = False  # it is handed out again
        return through


@dataclass(frozen=True)
class TagKinematics:
    """The tag at each position sample, (m,) or (m, 2): when, where the model has it, how it moves (NED).

    `t_s` since the first position of the log, from which a clock drifts; `clock_s` that all logs share.
    """

    t_s: np.ndarray
    clock_s: np.ndarray
    psi_rad: np.ndarray
    r_rad_s: np.ndarray
    place_m: np.ndarray
    velocity_m_s: np.ndarray
    acceleration_m_s2: np.ndarray
    centre_m: np.ndarray


def parameter_slices(chosen: Sequence[Effect]) -> dict[str, slice]:
    """Where each effect's parameters are."""
    found, at = {}, 0
    for e in chosen:
        found[e.id] = slice(at, at + len(e.parameters))
        at += len(e.parameters)
    return found
