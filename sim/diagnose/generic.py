"""What might be left over, by what it depends on: groups of smooth functions that stand for no effect in particular.

    position         cos(i pi n) cos(j pi e) over the range of places, 0 < i + j <= 4: force, heading; <= 3: moving
                     water, damping, place
    heading          sin, cos of k psi, k <= 3: force, heading; k <= 5: damping; k <= 2: specific force, place
    speed            products of u, v, r and their moduli: force, inertial sensors; rates: force; ways: place
    thruster         its force times powers of itself, after changes of it, times the force of another; of one, of all
    load, voltage    all forces times the total load now, or over 20 s and 60 s; times voltage
    time             cos(k pi t), k <= 6, of all logs; and sin, cos at the periods of the latent force

A function moves a whole window as the entries of its node do that stand for the same: a force is a latent
acceleration that is known but for its size, an error of heading, rate or specific force an offset or a bias, a shift of
the tag the position as the tag alone sees it. So all of them come from the normal equations that a fit has anyway.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from sim.diagnose.catalogue.parts import ahead_starboard, hull_damping, north_east
from sim.diagnose.effect import Effect, Parameter, Values
from sim.diagnose.linear import Point
from sim.diagnose.physics import Physics
from sim.diagnose.residue import pulses
from sim.identify.structured.chain import Chain
from sim.identify.structured.noise import BIAS_AX, BIAS_AY, BIAS_R, LATENT, OFFSET, STATE, L

ORDER, TURNS, SLOW = 4, 3, 6
BENDS = 5  # turns that drag is followed over: it may be larger on a narrow range of headings
SIZES = {
    "force": 0.01,  # m/s^2, rad/s^2; all assumed: where an effect begins to matter, as the catalogue's smallest sizes
    "share": 0.05,  # of thrust, of damping
    "map": 0.15,  # of the largest thrust: a speed controller's trim of 2 us alone shifts it by up to a hundredth
    "water": 0.02,  # m/s
    "heading": np.radians(1.0),  # rad
    "place": 0.03,  # m
    "rate": 0.002,  # rad/s
    "accel": 0.02,  # m/s^2
}
QUIET = 0.002  # of the largest thrust: smaller changes from sample to sample turn no direction round
HZ = (0.005, 0.45)  # where periods are sought: slower is "slow", faster than the nodes can follow
PEAKS = 2
Functions = Mapping[str, np.ndarray]
"""Values of functions in all windows, (W,)."""


@dataclass(frozen=True)
class Group:
    """Functions that are tried together. `words`: what they depend on, as in `depends_on`, the most telling first.

    `effect`: one parameter each, without hooks; `nodes` (W, L, p): what one unit of each does to the nodes.
    """

    words: tuple[str, ...]
    effect: Effect
    nodes: np.ndarray


def _group(name: str, words: tuple[str, ...], kind: str, names: list[str], nodes: np.ndarray) -> Group:
    size = SIZES[kind]
    parameters = tuple(Parameter(n, "", size, size, size) for n in names)
    return Group(words, Effect(f"generic:{name}", "generic", name, "", parameters, {}), nodes)


def widened(point: Point, groups: tuple[Group, ...]) -> Point:
    """`point` with the columns of `groups` behind those that it has."""
    nodes = np.concatenate([g.nodes for g in groups], axis=2)
    chain, ties = point.chain, point.ties
    pushed = chain.A @ nodes
    rows = nodes.reshape(-1, nodes.shape[2])
    cross = chain.B.reshape(len(rows), -1).T @ rows
    D = np.block([[chain.D, cross], [cross.T, rows.T @ pushed.reshape(rows.shape)]])
    d = np.concatenate([chain.d, rows.T @ chain.g.ravel()])
    G = ties.F[:, STATE, LATENT] @ nodes[ties.at, LATENT]
    return replace(
        point,
        chain=Chain(chain.A, chain.next, np.concatenate([chain.B, pushed], axis=2), D, chain.g, d),
        ties=replace(ties, G=np.concatenate([ties.G, G], axis=2)),
    )


class Generic:
    """The groups of a fitted `point`: means over each window of what functions depend on."""

    def __init__(self, physics: Physics, point: Point):
        self.physics, self.point = physics, point
        self.names = [t.name for t in physics.vessel.thrusters]
        state, self._h = point.state, physics.windows.h_s
        self.W = len(self._h)
        self.x = self._mean(state.x)
        self.psi = self.x[:, 2]
        self.rate = self._mean(state.nu_dot) - point.z[:, LATENT]
        self.clock = self._mean(physics.clock_s[..., None])[:, 0]
        self.f = state.forces.f[:, :-1]
        self._turn = state.M_inv.T
        scene = physics.scene(state)
        self.damping = -self._mean(hull_damping(physics.vessel, scene)) @ self._turn
        self.velocity = np.stack(north_east(self.psi, self.x[:, 3], self.x[:, 4]), axis=1)

    def groups(self) -> tuple[Group, ...]:
        """All of them; those for which nothing was logged are left out."""
        made = (self._position(), self._heading(), self._speed(), self._thruster(), self._load(), self._time(),
                self._periods())  # fmt: skip
        return tuple(group for some in made for group in some)

    def _mean(self, values: np.ndarray) -> np.ndarray:
        """Over each window, (W, K or K + 1, c) -> (W, c); steps that only fill a window up count nothing."""
        return np.einsum("wk,wkc->wc", self._h, values[:, : self._h.shape[1]]) / self._h.sum(axis=1)[:, None]

    def _known(self, name: str, words: tuple[str, ...], kind: str, entries: list, functions: Functions) -> Group:
        """Each function on each of `entries`: of the node (index), or accelerations (W, 3)."""
        columns, names = [], []
        for key, value in functions.items():
            for i, entry in enumerate(entries):
                node = np.zeros((self.W, L))
                if isinstance(entry, int):
                    node[:, entry] = value
                else:
                    node[:, LATENT] = value[:, None] * entry
                columns.append(node)
                names.append(f"{key} {i}")
        return _group(name, words, kind, names, np.stack(columns, axis=2))

    def _axes(self, letters: str) -> list[np.ndarray]:
        """Unit accelerations (W, 3): X, Y, K of the boat, N, E of the world."""
        out = {}
        for i, letter in enumerate("XYK"):
            out[letter] = np.tile(np.eye(3)[i], (self.W, 1))
        for letter, ne in (("N", (1.0, 0.0)), ("E", (0.0, 1.0))):
            out[letter] = np.column_stack([*ahead_starboard(self.psi, *ne), np.zeros(self.W)])
        return [out[letter] for letter in letters]

    def _water(self) -> list[np.ndarray]:
        """Accelerations of a current of 1 m/s to the north, to the east."""

        def water(p: Values, scene) -> np.ndarray:
            return np.broadcast_to(np.array([p["north"], p["east"]]), (*scene.t_s.shape, 2))

        parameters = tuple(Parameter(n, "m/s", 1.0, np.inf, SIZES["water"]) for n in ("north", "east"))
        flow = Effect("generic:flow", "generic", "", "", parameters, {"water": water})
        out = self.physics.accelerations([flow], {}, self.point.state, [flow]).nodes
        return [self._mean(out[..., i]) for i in range(2)]

    def _position(self) -> Iterator[Group]:
        places = self.physics.windows.fixes.place_m
        low, high = np.quantile(places, (0.02, 0.98), axis=0)
        n, e = np.pi * np.clip((self.x[:, :2] - low) / np.maximum(high - low, 1e-3), 0, 1).T
        fields = {f"{i}{j}": np.cos(i * n) * np.cos(j * e)
                  for i in range(ORDER + 1) for j in range(ORDER + 1 - i) if i + j}  # fmt: skip
        word = ("position",)
        far = {"00": np.ones(self.W)}  # what pulls from far away hardly changes: with a constant it is still one field
        yield self._known("force over position", word, "force", self._axes("NE"), far | fields)
        yield self._known("heading error over position", word, "heading", [OFFSET], fields)
        broad = {key: value for key, value in fields.items() if sum(map(int, key)) < ORDER}
        yield self._known("water over position", word, "water", self._water(), broad)
        yield self._known("damping over position", word, "share", [self.damping], broad)
        yield self._known("place error over position", word, "place", [0, 1], broad)

    def _heading(self) -> Iterator[Group]:
        bends = {f"{k}{w.__name__}": w(k * self.psi) for k in range(1, BENDS + 1) for w in (np.cos, np.sin)}
        waves, two = (dict(list(bends.items())[: 2 * k]) for k in (TURNS, 2))
        word = ("heading",)
        yield self._known("force over heading", word, "force", self._axes("XYK"), waves)
        drag = [self.damping * axis for axis in np.eye(3)]
        yield self._known("damping over heading", word, "share", drag, bends)
        yield self._known("heading error over heading", word, "heading", [OFFSET], waves)
        yield self._known("specific force over heading", word, "accel", [BIAS_AX, BIAS_AY], two)
        yield self._known("place error over heading", word, "place", [0, 1], two)

    def _speed(self) -> Iterator[Group]:
        speeds = dict(zip("uvr", self.x[:, 3:].T, strict=True))
        speeds |= {k.upper(): np.abs(v) for k, v in speeds.items()}
        names = ("u", "v", "r", "U", "V", "R", "uU", "vV", "rR", "uv", "ur", "vr", "Uv", "Ur", "uuu", "vvv", "rrr")
        products = {n: np.prod([speeds[c] for c in n], axis=0) for n in names}
        few, word = {n: products[n] for n in ("u", "v", "r", "ur", "rR")}, ("speed",)
        yield self._known("force over speed", word, "force", self._axes("XYK"), products)
        rates = {n: self.rate[:, i] for i, n in enumerate(("u_dot", "v_dot", "r_dot"))}
        yield self._known("force over rate of speed", word, "share", self._axes("XYK"), rates)
        for what, kind, entries in (("heading", "heading", [OFFSET]), ("yaw rate", "rate", [BIAS_R]),
                                    ("specific force", "accel", [BIAS_AX, BIAS_AY])):  # fmt: skip
            yield self._known(f"{what} error over speed", word, kind, entries, few)
        yield _group("place error over speed", word, "place", ["along", "across", "along 2", "across 2", "x r", "y r"],
                     self._ways())  # fmt: skip

    def _ways(self) -> np.ndarray:
        """Along and across the way, in proportion to speed and to its square; with yaw rate, ahead and abeam."""
        along, speed = self.velocity, np.hypot(*self.velocity.T)[:, None]
        across, r = np.column_stack([-along[:, 1], along[:, 0]]), self.x[:, 5]
        turning = [np.column_stack(north_east(self.psi, *one)) for one in ((r, 0 * r), (0 * r, r))]
        nodes = np.zeros((self.W, L, 6))
        nodes[:, :2] = np.stack([along, across, along * speed, across * speed, *turning], axis=2)
        return nodes

    def _thrusts(
        self, name: str, words: tuple[str, ...], factors: Mapping[str, np.ndarray], kind: str = "share"
    ) -> Group:
        """`factors`: changes of the thruster forces, (W, K, n)."""
        nodes = np.zeros((self.W, L, len(factors)))
        for i, factor in enumerate(factors.values()):
            nodes[:, LATENT, i] = self._mean(factor) @ self.physics.B.T @ self._turn
        return _group(name, words, kind, list(factors), nodes)

    def _thruster(self) -> Iterator[Group]:
        n, largest = len(self.names), max(float(np.abs(self.f).max()), 1e-9)
        share = self.f / largest
        root = np.sqrt(np.abs(share))
        still = {"1": share, "2": share * np.abs(share), "3": share**3, "root": np.sign(share) * root,
                 "modulus": np.abs(share)}  # fmt: skip
        direction = self._direction(QUIET * largest)
        step = np.diff(self.f, axis=1, append=self.f[:, -1:]) / np.maximum(self._h, 1e-6)[..., None] / largest
        after = {"direction": direction * (np.abs(share) > 0), "direction root": direction * root, "rate": step}
        for i, name in enumerate([*self.names, "all"]):
            mine = np.eye(n)[i] if i < n else np.ones(n)
            words = (f"thruster:{name}",) if i < n else ("thruster",)
            for what, functions, kind in (("thrust", still, "map"), ("thrust after changes", after, "share")):
                scaled = {k: largest * mine * v for k, v in functions.items()}
                yield self._thrusts(f"{what}, {name}", words, scaled, kind)
        yield self._thrusts("thrust of one by another", ("thruster", "load"), {
            f"{i} by {j}": self.f * np.eye(n)[i] * np.abs(share[..., [j]])
            for i in range(n) for j in range(n) if i != j})  # fmt: skip

    def _direction(self, least: float) -> np.ndarray:
        """Sign of each force's last change, log by log, (W, K, n)."""
        out = np.zeros_like(self.f)
        for log in np.unique(self.physics.windows.run):
            mine = self.physics.windows.run == log
            steps = np.diff(self.f[mine], axis=1, append=self.f[mine][:, -1:]).reshape(-1, self.f.shape[2])
            at = np.where(np.abs(steps) > least, np.arange(len(steps))[:, None], 0)
            last = np.maximum.accumulate(at, axis=0)
            out[mine] = np.sign(np.take_along_axis(steps, last, axis=0)).reshape(out[mine].shape)
        return out

    def _load(self) -> Iterator[Group]:
        total = np.abs(self.f).sum(axis=2)
        load = total / max(float(total.max()), 1e-9)
        yield self._thrusts("thrust over load", ("load",), {str(k): self.f * load[..., None] ** k for k in (1, 2, 3)})
        past = {f"{s:g} s": self.f * self._remembered(load, s)[:, None, None] for s in (20.0, 60.0)}
        yield self._thrusts("thrust over past load", ("load",), past)
        volts = pulses(self.physics)[1]
        if np.isfinite(volts).all() and np.ptp(volts) > 0:
            off = ((volts - volts.mean()) / np.ptp(volts))[:, None, None]
            yield self._thrusts("thrust over voltage", ("voltage",), {str(k): self.f * off**k for k in (1, 2)})

    def _remembered(self, load: np.ndarray, memory_s: float) -> np.ndarray:
        """Mean load of windows through a first-order lag, log by log, (W,)."""
        mean, out = self._mean(load[..., None])[:, 0], np.empty(self.W)
        for w in range(self.W):
            if self.physics.windows.first[w]:
                out[w] = mean[w]
            else:
                kept = np.exp(-(self.clock[w] - self.clock[w - 1]) / memory_s)
                out[w] = mean[w] + (out[w - 1] - mean[w]) * kept
        return out

    def _time(self) -> Iterator[Group]:
        low, high = self.clock.min(), self.clock.max()
        phase = np.pi * (self.clock - low) / max(high - low, 1.0)
        slow, word = {str(k): np.cos(k * phase) for k in range(1, SLOW + 1)}, ("time",)
        yield self._known("force over time", word, "force", self._axes("NEK"), slow)
        n = len(self.names)
        for i, name in enumerate([*self.names, "all"]):
            mine = np.eye(n)[i] if i < n else np.ones(n)
            words = ("time", f"thruster:{name}") if i < n else word
            wave = {k: self.f * mine * v[:, None, None] for k, v in slow.items()}
            yield self._thrusts(f"thrust over time, {name}", words, wave)
        for what, kind, entry in (("heading", "heading", OFFSET), ("yaw rate", "rate", BIAS_R),
                                  ("a_x", "accel", BIAS_AX), ("a_y", "accel", BIAS_AY)):  # fmt: skip
            yield self._known(f"{what} error over time", word, kind, [entry], slow)
        late = np.zeros((self.W, L, SLOW))
        late[:, :2] = self.velocity[:, :, None] * np.stack(list(slow.values()), axis=1)[:, None]
        yield _group("delay of places over time", word, "place", list(slow), late)

    def _periods(self) -> Iterator[Group]:
        latent = self.point.z[:, LATENT]
        north, east = north_east(self.psi, latent[:, 0], latent[:, 1])
        driven = self._mean(self.f) @ self.physics.B.T @ self._turn
        shares = (driven * latent) @ (1 / np.maximum(latent.std(axis=0), 1e-9) ** 2)
        found = self._peaks({"thrust": shares, "N": north, "E": east, "K": latent[:, 2]})

        def waves(hz: float) -> dict[str, np.ndarray]:
            return {f"{w.__name__} {hz:.4f} Hz": w(2 * np.pi * hz * self.clock) for w in (np.cos, np.sin)}

        thrust = {k: v for hz in found.pop("thrust") for k, v in waves(hz).items()}
        yield self._thrusts("thrust, periodic", ("time",), {k: self.f * v[:, None, None] for k, v in thrust.items()})
        for axis, peaks in found.items():
            functions = {k: v for hz in peaks for k, v in waves(hz).items()}
            yield self._known(f"force, periodic, {axis}", ("time",), "force", self._axes(axis), functions)

    def _peaks(self, signals: dict[str, np.ndarray]) -> dict[str, list[float]]:
        """Frequencies [Hz] at which each is largest."""
        span = max(float(np.ptp(self.clock)), 1.0)
        grid = np.arange(*HZ, 0.25 / span)
        spectra = np.abs(np.exp(-2j * np.pi * grid[:, None] * self.clock) @ np.stack(list(signals.values()), axis=1))
        found: dict[str, list[float]] = {name: [] for name in signals}
        for out, power in zip(found.values(), spectra.T, strict=True):
            for _ in range(PEAKS):
                best = int(power.argmax())
                out.append(float(grid[best]))
                power[np.abs(grid - grid[best]) < 2.0 / span] = 0.0
        return found
