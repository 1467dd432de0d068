"""The model that a diagnosis fits against the vessel file that it writes, for every effect of the catalogue.

Integrators of windows and of the boat differ by construction. So accelerations and readings are compared at the same
random states (under the log's own commands), and trajectories by the same Runge-Kutta from there under constant
forces. A fouled thruster is compared a minute after its onset: a file has it as a gain. A scale of UWB goes about the
middle of the positions in a fit and about the site's origin in a file: the same but for a shift of all places, which
is taken out. Only a clock knows how far a current has turned: filter and NMPC are compared at the beginning, the
simulators for all of the time. What pushes by chance is drawn by the world alone: its parameters there are compared
with those that were found.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace

from companion.core.configuration.sensors import Gnss, Sensors
from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.load_vessel import load_vessel
from companion.core.model.vessel_text import vessel_toml
from sim.fitting.diagnose.catalogue import stochastic
from sim.fitting.diagnose.catalogue.effect import Effect
from sim.fitting.diagnose.vessel_edits.edits import CauseValues, NotInVesselFileError
from sim.fitting.diagnose.vessel_edits.extend import with_causes
from sim.fitting.diagnose.vessel_edits.public_form import family
from sim.studies.boats.draw import in_still_air
from sim.world.environment import Weather, with_terms_of
from sim.world.sensors import hidden_anchor
from sim.world.teleop_log import corner_anchors, teleop_run
from tests.evidence.line import Line, at_most, exactly
from tests.evidence.one_truth.draws import draw, families
from tests.evidence.one_truth.fitted import Causes, Engine
from tests.evidence.one_truth.written import Models
from tests.support.vessel_fixtures import boat

SEEDS, MANY = 3, 12
FEW_PAIRS, PAIRS = 20, 200
NOT_TOGETHER = (
    {"current", "turning_current"},  # one of them is the other
    {"uwb_latency", "uwb_lever_arm"},  # a delay moves the tag along its own path: to half a millimetre
    {"clock_drift", "uwb_lever_arm"},
    {"clock_drift", "uwb_latency"},
    {"uwb_scale", "tether"},  # places are off by the shift between middle and origin times the scale
    {"uwb_scale", "shallow_zone"},
    {"payload", "cg_shift"},  # of the base's mass in the fit, of the loaded boat's in the file: some per cent
)
LOG_S = 31.0  # an onset is looked for every minute from half a minute on
STEPS, STEP_S = 10, 0.1
GOAL = 1e-9
AFTER_ONSET_S = 60.0
UWB = in_still_air(boat("aritra"))
TAG = UWB.sensors.tag
GNSS = Gnss(
    x_m=TAG.x_m, y_m=TAG.y_m, z_m=TAG.z_m, rate_Hz=5.0, position_sigma_m=0.07, latency_s=TAG.latency_s, source="assumed"
)


@dataclass(frozen=True)
class Difference:
    """Relative differences of one cause: accelerations, trajectories by program, readings."""

    acceleration: float
    trajectory: dict[str, float]
    readings: float

    @property
    def worst(self) -> float:
        return max(self.acceleration, self.readings, *self.trajectory.values())


def relative(found: np.ndarray, expected: np.ndarray) -> float:
    """Largest difference over the largest size, of the last axis's component where that is worst."""
    size = np.abs(expected).reshape(-1, expected.shape[-1]).max(axis=0)
    off = np.abs(found - expected).reshape(-1, expected.shape[-1]).max(axis=0)
    return float((off / np.where(size > 0, size, 1.0)).max())


def compared(engine: Engine, *causes: tuple[Effect, np.ndarray]) -> Difference:
    """Causes: written, loaded again, and held against the fit's own physics.

    NotInVesselFileError where a file has no key for one.
    """
    new, left = with_causes(engine.vessel, [engine.cause(*one) for one in causes])
    if left:
        raise NotInVesselFileError("; ".join(left.values()))
    written = Models(load_vessel(vessel_toml(new), name="extended.toml"))
    started = [values[1] + e.origin["onset_s"] + AFTER_ONSET_S for e, values in causes if "onset_s" in e.origin]
    start_s = max(started, default=0.0)
    x, f = engine.x, engine.forces_of(new)
    rows, pushed = x.reshape(-1, 6), f.reshape(-1, f.shape[-1])
    nu_dot = engine.nu_dot(causes, x, start_s)
    acceleration = relative(written.nu_dot(rows, pushed, 0.0), nu_dot.reshape(-1, 3))
    trajectory = {}
    turning = any(family(e.name) == "turning_current" for e, _ in causes)
    moved = {turns: _trajectory(engine, causes, start_s, turns) for turns in {turning, False}}
    for name, found in written.trajectories(rows, pushed, STEPS, STEP_S).items():
        expected = moved[turning and name in ("simulator", "trajectories")]
        trajectory[name] = max(
            relative(found[..., part] - base, expected[..., part] - base)
            for part, base in ((slice(0, 3), rows[:, None, :3]), (slice(3, 6), 0.0))
        )
    return Difference(acceleration, trajectory, _readings(engine, written, causes, nu_dot, f))


def _trajectory(engine: Engine, causes: Causes, start_s: float, turns: bool) -> np.ndarray:
    """States (m, STEPS + 1, 6) of the fitted model; the clock goes on where it `turns`."""
    x = [engine.x]
    for k in range(STEPS):
        x.append(engine.step(causes, x[-1], start_s + turns * k * STEP_S, STEP_S))
    return np.stack([each.reshape(-1, 6) for each in x], axis=1)


def _readings(engine: Engine, written: Models, causes: Causes, nu_dot: np.ndarray, f: np.ndarray) -> float:
    """Worst of heading, gyro, accelerometers and positions in simulator and filter."""
    K = engine.physics.windows.size[1]
    rows, a = engine.x[:, :K].reshape(-1, 6), nu_dot[:, :K].reshape(-1, 3)
    fitted = engine.imu(causes, nu_dot).reshape(-1, 4)
    taken = written.corrected(fitted)
    expected = written.expected(rows, f[:, :K].reshape(-1, f.shape[-1]))
    tag = engine.tag(causes, nu_dot)
    return max(
        relative(written.imu(rows, a), fitted),
        relative(taken[:, 2:], expected),
        relative(taken[:, :2], rows[:, [2, 5]]),
        relative(written.tag(engine, _about_origin(engine, written), nu_dot), tag),
    )


def _about_origin(engine: Engine, written: Models) -> np.ndarray:
    """States that a file's scale takes where the fit's takes those of the engine: it goes about the site's origin."""
    uwb, x = written.vessel.sensors.uwb, engine.x.copy()
    if uwb is not None:
        x[..., :2] -= uwb.scale / (1 + uwb.scale) * engine.physics.centre_m
    return x


def engines(seed: int) -> Iterator[Engine]:
    """A boat with UWB and the same with GNSS, each on a log of its own."""
    for k, vessel in enumerate((UWB, replace(UWB, sensors=Sensors(imu=UWB.sensors.imu, gnss=GNSS)))):
        rng = np.random.default_rng([seed, k])
        run = teleop_run(UWB, 100 + seed, LOG_S, uwb_hz=5.0, sigma_m=0.07)
        yield Engine(vessel, run, rng)


def differences(seed: int) -> Iterator[tuple[str, Difference | str]]:
    """By family, the difference of one draw or why a file has no key for it; of the GNSS boat what only that has."""
    seen: set[str] = set()
    for engine in engines(seed):
        for name, entries in families(engine.catalogue).items():
            if name in seen:
                continue
            seen.add(name)
            effect, values = draw(entries, np.random.default_rng([seed, len(seen)]))
            try:
                yield name, compared(engine, (effect, values))
            except NotInVesselFileError as error:
                yield name, str(error)


def effects(full: bool) -> Iterator[Line]:
    """An effect is one equation: the fitted model against the file that is written, for every effect"""
    worst: dict[str, list[Difference]] = {}
    missing: dict[str, str] = {}
    seeds = MANY if full else SEEDS
    for seed in range(seeds):
        for name, found in differences(seed):
            if isinstance(found, str):
                missing[name] = found
            else:
                worst.setdefault(name, []).append(found)
    for name, each in worst.items():
        by = {k: max(d.trajectory[k] for d in each) for k in each[0].trajectory}
        note = f"accelerations {max(d.acceleration for d in each):.1g}, readings {max(d.readings for d in each):.1g}, "
        note += ", ".join(f"{k} {v:.1g}" for k, v in by.items())
        yield at_most(name, max(d.worst for d in each), GOAL, "", note)
    for name, off in by_chance(seeds):
        if off is None:
            missing[name] = "by chance"
        else:
            yield at_most(f"{name}: its parameters as the world draws it", off, GOAL)
    yield exactly("effects that no file has a key for", len(missing), 0, "", "; ".join(missing))


def pairs(full: bool) -> Iterator[Line]:
    """Two effects at once: drawn pairs, the fitted model against the file that is written"""
    engine = next(engines(0))
    entries, rng = families(engine.catalogue), np.random.default_rng(0)
    worst: list[tuple[float, str]] = []
    while len(worst) < (PAIRS if full else FEW_PAIRS):
        two = [str(name) for name in rng.choice(list(entries), 2, replace=False)]
        if any({*two} <= each for each in NOT_TOGETHER):
            continue
        found = compared(engine, *(draw(entries[name], rng) for name in two))
        worst.append((found.worst, " + ".join(two)))
    worst.sort(reverse=True)
    note = ", ".join(f"{name} {off:.1g}" for off, name in worst[:3])
    yield at_most(f"worst of {len(worst)} pairs", worst[0][0], GOAL, "", note)


def by_chance(seeds: int) -> Iterator[tuple[str, float | None]]:
    """By stochastic effect, the largest relative difference of its parameters as found and as drawn by the file."""
    for effect in stochastic.effects():
        worst: float | None = 0.0
        for seed in range(seeds):
            rng = np.random.default_rng([seed, len(effect.name)])
            own = {p.name: float(rng.uniform(0.5, 2.0) * min(p.prior, 180.0)) for p in effect.parameters}
            own |= {"anchor": float(rng.integers(4))} if "anchor" in own else {}
            new, left = with_causes(UWB, [CauseValues(effect, own, own, "drawn")])
            if left or worst is None:
                worst = None
                continue
            found = drawn_in_world(load_vessel(vessel_toml(new), name="extended.toml"))
            off = [
                abs((found[k] - v + 180) % 360 - 180 if k.startswith("beta") else found[k] - v) for k, v in own.items()
            ]
            worst = max(worst, *(d / max(abs(v), 1.0) for d, v in zip(off, own.values(), strict=True)))
        yield effect.name, worst


def drawn_in_world(vessel: VesselFile) -> dict[str, float]:
    """Parameters by which the simulated world draws gusts, waves, and fixes without line of sight of a vessel file."""
    weather, uwb = with_terms_of(Weather(), vessel), vessel.sensors.tag
    of_air = {k: getattr(weather, k) or 0.0 for k in ("V_w_m_s", "beta_w_deg", "gustiness", "gust_time_s")}
    hidden = hidden_anchor(uwb, corner_anchors())
    of_uwb = {"share": uwb.nlos_share, "extra_m": uwb.nlos_extra_m, "anchor": float(hidden.id) if hidden else np.nan}
    return of_air | dict(weather.waves or {}) | of_uwb
