"""Catalogue: thrusters, ESCs, battery."""

from __future__ import annotations

import numpy as np

from tests.hidden.effects.effect import Effect, Params, also, one, sets
from tests.hidden.plant.world import STEP_S, Fouling, World


def _index(world: World, p: Params) -> int:
    return world.thruster_names.index(p["thruster"])


def _gain(rng: np.random.Generator, size: float, base: World) -> Params:
    """Loss three times in four; a size above 0.24 is now and then a dead or a reversed thruster."""
    name = str(rng.choice(base.thruster_names))
    if size > 0.15 and rng.uniform() < 0.15:
        return {"thruster": name, "gain": float(rng.choice([0.0, -1.0]))}
    return {"thruster": name, "gain": 1 + (size if rng.uniform() < 0.25 else -size)}


def _set_gain(world: World, p: Params) -> None:
    world.drive.thrusters[_index(world, p)].gain *= p["gain"]


def _bent_gain(world: World, p: Params) -> None:
    """The whole loss at full command only, a third of it near none."""
    thruster = world.drive.thrusters[_index(world, p)]
    thruster.gain_small = thruster.gain * (1 + (p["gain"] - 1) / 3)
    thruster.gain *= 1 + 1.4 * (p["gain"] - 1)


def _pair(rng: np.random.Generator, size: float, base: World) -> Params:
    a, b = sorted(rng.choice(len(base.thruster_names), 2, replace=False))
    return {"thrusters": [base.thruster_names[a], base.thruster_names[b]]}


def _swap(world: World, p: Params) -> None:
    a, b = (world.thruster_names.index(n) for n in p["thrusters"])
    wire = world.drive.wire
    wire[a], wire[b] = wire[b], wire[a]


def _fouled(rng: np.random.Generator, size: float, base: World) -> Params:
    onset = float(rng.uniform(80, 220))
    return {"thruster": str(rng.choice(base.thruster_names)), "gain": 1 - size, "t_on_s": onset}


def _foul(world: World, p: Params) -> None:
    world.drive.fouling = Fouling(_index(world, p), p["gain"], p["t_on_s"])


def _foul_slowly(world: World, p: Params) -> None:
    world.drive.fouling = Fouling(_index(world, p), p["gain"], p["t_on_s"], ramp=60.0)


def _foul_on_and_off(world: World, p: Params) -> None:
    world.drive.fouling = Fouling(_index(world, p), p["gain"], p["t_on_s"], beat=35.0)


def _common(world: World, p: Params) -> None:
    world.drive.common *= p["gain"]


def _astern(world: World, p: Params) -> None:
    world.drive.astern_gain *= p["gain"]


def _astern_bent(world: World, p: Params) -> None:
    world.drive.astern_gain, world.drive.astern_bend = 1 - 0.4 * (1 - p["gain"]), 2.0 * (1 - p["gain"])


def _voltage(world: World, p: Params) -> None:
    world.drive.voltage_exponent += p["exponent"]


def _dead_band(world: World, p: Params) -> None:
    world.drive.dead_band_us += p["dead_band_us"]


def _soft(world: World, p: Params) -> None:
    world.drive.soft_us = 15.0


def _lag(world: World, p: Params) -> None:
    world.drive.lag += p["lag_s"]


def _second_order(world: World, p: Params) -> None:
    world.drive.lag_2 = p["lag_s"]


def whole_steps(seconds: float) -> float:
    """Dead times are whole steps of the integrator."""
    return round(seconds / STEP_S) * STEP_S


def _delay(rng: np.random.Generator, size: float, base: World) -> Params:
    return {"dead_time_s": whole_steps(size)}


def _dead_time(world: World, p: Params) -> None:
    world.drive.dead_time += p["dead_time_s"]


def _jitter(world: World, p: Params) -> None:
    world.drive.jitter = 0.5


def _limit(rng: np.random.Generator, size: float, base: World) -> Params:
    return {"rate_limit_N_s": 1 / size}


def _slew(world: World, p: Params) -> None:
    """The ESC ramps the command: 400 us stand for 40 N."""
    world.drive.rate_pwm = 10.0 * p["rate_limit_N_s"]


def _advance_square(world: World, p: Params) -> None:
    world.drive.advance_square = 1.6 * p["loss_s_m"]


def _wash_root(world: World, p: Params) -> None:
    world.drive.wash_root = 0.7 * p["loss"]


EFFECTS = (
    Effect("thruster_gain", ("gain",), 0.05, _gain, _set_gain, {"bent": _bent_gain}, neutral=1.0),
    Effect("swapped_pair", (), 1.0, _pair, _swap, fixed=True),
    Effect("thruster_fouling", ("gain",), 0.08, _fouled, _foul,
           {"ramp": _foul_slowly, "on_off": _foul_on_and_off}, neutral=1.0),
    Effect("common_loss", ("gain",), 0.05, one("gain", neutral=1.0, down=1.0), _common, neutral=1.0),
    Effect("astern_asymmetry", ("gain",), 0.06, one("gain", neutral=1.0, down=0.75), _astern,
           {"bent": _astern_bent}, neutral=1.0),
    Effect("voltage_exponent", ("exponent",), 0.3, one("exponent", down=0.2), _voltage),
    Effect("dead_band", ("dead_band_us",), 4.0, one("dead_band_us", down=0.3), _dead_band,
           {"soft": also(_dead_band, _soft)}),
    Effect("lag", ("lag_s",), 0.03, one("lag_s", positive=True), _lag, {"second_order": _second_order}),
    Effect("dead_time", ("dead_time_s",), 0.04, _delay, _dead_time, {"jitter": also(_dead_time, _jitter)}),
    Effect("rate_limit", ("rate_limit_N_s",), 1 / 150, _limit, sets("drive", rate="rate_limit_N_s"),
           {"slew": _slew}, inverse=True),
    Effect("advance_loss", ("loss_s_m",), 0.05, one("loss_s_m", positive=True), sets("drive", advance="loss_s_m"),
           {"square": _advance_square}),
    Effect("wash", ("loss",), 0.10, one("loss", positive=True), sets("drive", wash="loss"), {"root": _wash_root}),
)  # fmt: skip
