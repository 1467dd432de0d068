"""Evidence for the speed of whole trajectories: the public call against what a user would write, interleaved.

Seconds are those that the processor gave this one thread: other programs on the machine count as little as they can.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from functools import cache

import casadi as ca
import numpy as np

from companion.boat.load_run import EXAMPLES
from companion.core.model.load_vessel import load_vessel
from sim.bench.controller.rounds import interleaved
from sim.bench.simulation import NumpyBoat, commands, runners
from sim.fitting.validate.models import VesselSimulator
from sim.fitting.validate.protocol import Commands
from sim.trajectory import Surroundings, simulate, simulate_forces
from sim.trajectory.arguments import delayed, task
from sim.trajectory.step import step_function
from sim.world.environment import Moment
from sim.world.plant import Plant
from tests.evidence.line import Line, at_least, at_most, exactly, information

STEP_S, GOAL = 0.01, 50_000.0
SEED = 1
LONG_S, MANY, SHORT_S = 600.0, 64, 60.0
CALM = Surroundings(0.0, 0.0, 0.0, 0.0)
"""As the simulated world has it: water and air that stand still, but brake a boat that moves."""
STILL = Moment(0.0, 0.0, 0.0, 0.0, np.zeros(3), 0.0, 0.0)


@cache
def _vessel():
    path = EXAMPLES / "boats" / "aritra.toml"
    return load_vessel(path.read_text(), name=path.name)


def _pulses(seconds: float, seed: int = SEED) -> np.ndarray:
    """Pulse widths drawn anew every 0.5 s, dead band included."""
    drawn = np.random.default_rng(seed).integers(1250, 1751, (round(seconds * 2), 4))
    return np.repeat(drawn, round(0.5 / STEP_S), axis=0)


def _timed(runs: Mapping[str, tuple[float, Callable[[], object]]], rounds: int) -> dict[str, float]:
    """Simulated seconds per second, median of interleaved rounds; `runs`: simulated seconds of a run, and the run."""

    def seconds(run: Callable[[], object]) -> Callable[[], float]:
        def measured() -> float:
            began = time.thread_time()
            run()
            return time.thread_time() - began

        return measured

    for _, run in runs.values():
        run()
    found = interleaved({name: seconds(run) for name, (_, run) in runs.items()}, rounds)
    return {name: simulated / found[name].median(50) for name, (simulated, _) in runs.items()}


def _plant(pwm: np.ndarray) -> np.ndarray:
    """The simulated world's boat, step by step."""
    plant = Plant(_vessel(), np.zeros(6), step_ns=10_000_000, voltage_v=15.6)
    states = np.empty((len(pwm), 10))
    for k, row in enumerate(pwm):
        plant.command(k * 10_000_000, tuple(map(float, row)))
        states[k] = plant.step(STILL).x
    return states


def _mapaccum(pwm: np.ndarray) -> Callable[[], object]:
    """The same step as `simulate`'s, thrusters included, by CasADi's own loop."""
    work = task(_vessel(), np.zeros(6), delayed(_vessel(), pwm, None, STEP_S), "pwm", STEP_S, voltage_v=15.6)
    step = step_function(_vessel(), work.kind)
    x, q, u = ca.SX.sym("x", 10), ca.SX.sym("q", work.constants.shape[1]), ca.SX.sym("u", 4)
    whole = ca.Function("step", [x, u, q], step(x, q, u)).mapaccum("whole", len(pwm), 1)
    given = np.repeat(work.constants.T, len(pwm), axis=1)
    return lambda: whole(work.start[0], work.series[0][0].T, given)


def pulse_widths(full: bool) -> Iterator[Line]:
    """Pulse widths in, motion out: dead time, battery, force map with dead band, lag, hull; 100 Hz Runge-Kutta"""
    vessel, rounds = _vessel(), 25 if full else 9
    one, few = _pulses(LONG_S), _pulses(20.0)
    many = np.stack([_pulses(SHORT_S, seed) for seed in range(MANY)])
    start, starts = np.zeros(6), np.zeros((MANY, 6))
    names = ("one trajectory", f"{MANY} at once")

    def first(**given: object) -> object:
        return simulate(vessel, start, one, STEP_S, voltage_v=15.6, **given)

    def all_of_them(**given: object) -> object:
        return simulate(vessel, starts, many, STEP_S, voltage_v=15.6, **given)

    runs = {
        "Plant, step by step": (20.0, lambda: _plant(few)),
        "CasADi's mapaccum": (20.0, _mapaccum(few)),
        names[0]: (LONG_S, first),
        names[1]: (MANY * SHORT_S, all_of_them),
        f"{names[0]}, air and water": (LONG_S, lambda: first(around=CALM)),
        f"{names[1]}, air and water": (MANY * SHORT_S, lambda: all_of_them(around=CALM)),
        "one trajectory, interpreted": (20.0, lambda: simulate(vessel, start, few, STEP_S, machine_code=False)),
    }  # fmt: skip
    speed = _timed(runs, rounds)
    for name, value in speed.items():
        what = f"simulate, {name}" if name.startswith(names) else name
        judged = name in (*names, f"{names[1]}, air and water")
        yield at_least(what, value, GOAL, "s/s") if judged else information(what, value, "s/s")
    for name in names:
        yield information(f"simulate, {name}: times CasADi's mapaccum", speed[name] / speed["CasADi's mapaccum"])
        yield information(f"simulate, {name}: times the plant", speed[name] / speed["Plant, step by step"])
    together = simulate(vessel, starts[:5], many[:5], STEP_S).x
    alone = np.stack([simulate(vessel, start, pwm, STEP_S).x for pwm in many[:5]])
    yield exactly("one alone or among others: states that differ", float((together != alone).sum()), 0)
    off = np.abs(simulate(vessel, start, few, STEP_S, voltage_v=15.6, around=CALM).x[1:] - _plant(few)).max()
    yield at_most("20 s: largest difference from the plant", off, 1e-9, "", "m, rad, m/s, rad/s, N")


def forces(full: bool) -> Iterator[Line]:
    """Commanded forces in, motion out: lag and hull, as `aritra bench` compares it"""
    vessel, steps = _vessel(), 2000
    given = commands(4, steps)
    x0, many = np.zeros(10), np.stack([given] * MANY)
    others = runners(vessel, steps)
    runs = {name: (steps * STEP_S, lambda run=run: run(x0, given)) for name, run in others.items()}
    runs["simulate_forces, one trajectory"] = (
        300.0, lambda: simulate_forces(vessel, x0, np.tile(given, (15, 1)), STEP_S))  # fmt: skip
    runs[f"simulate_forces, {MANY} at once"] = (
        MANY * steps * STEP_S, lambda: simulate_forces(vessel, np.zeros((MANY, 10)), many, STEP_S))  # fmt: skip
    speed = _timed(runs, 25 if full else 9)
    for name, value in speed.items():
        ours = name.startswith("simulate_forces")
        yield at_least(name, value, GOAL, "s/s") if ours else information(name, value, "s/s")
    for name in list(speed)[-2:]:
        for other in ("numpy, step by step", "CasADi mapaccum, whole"):
            yield information(f"{name}: times {other}", speed[name] / speed[other])
    off = np.abs(simulate_forces(vessel, x0, given, STEP_S).x[1:] - NumpyBoat(vessel).run(x0, given)).max()
    yield at_most("20 s: largest difference from numpy", off, 1e-9, "", "m, rad, m/s, rad/s, N")


def open_loop(full: bool) -> Iterator[Line]:
    """Open-loop validation as `aritra identify` does it: 100 windows of 60 s at 20 Hz"""
    vessel, rng, windows, steps = _vessel(), np.random.default_rng(SEED), 100, 1200
    x0 = np.hstack([np.zeros((windows, 3)), rng.uniform(-0.5, 0.5, (windows, 3))])
    pwm = np.repeat(rng.uniform(1300, 1700, (windows, steps // 20, 4)), 20, axis=1)
    told = Commands(pwm, np.full((windows, steps), 15.0), np.full((windows, 40, 4), 1500.0))
    simulator = VesselSimulator("model", vessel)
    speed = _timed({"open loop": (windows * 60.0, lambda: simulator.simulate(x0, told))}, 9)
    yield information("100 windows of 60 s", windows * 60.0 / speed["open loop"], "s", "machine code kept")


PARTS = (pulse_widths, forces, open_loop)
