"""How well a model foretells the held-out log, measured by this package's own hand.

From the true state at every tenth second the model runs ten seconds open loop under the logged commands and battery,
without gusts, waves or ambient force. Its readings (fix, heading, yaw rate, specific force) are compared with the
noise-free readings of the true boat:

    E = sqrt(mean over channels of mean square of (error / SIGMA))
    gain relative to the truth = (E_refit - E_extended) / (E_refit - E_true)

E_true: the true world under the same rule; what random forces leave. The relative gain is not formed where the truth
itself gains less than 5 % over the refitted base. A model is a vessel file plus named causes.

No fit knows the small imperfections exactly, so that even the right causes do not reach E_true:

    gain relative to the true structure refitted = (E_refit - E_extended) / (E_refit - E_structure)

E_structure: the program's own fit of the true causes (`--believe`), which it is told after its findings are closed.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tests.hidden.draw import Case
from tests.hidden.effects.catalogue import apply_named
from tests.hidden.names import canonical
from tests.hidden.plant.sail import replay
from tests.hidden.plant.sensors import fix_clean, imu_clean, stamp_delay
from tests.hidden.plant.vessel import read_vessel
from tests.hidden.plant.world import STEP_S, STEPS_HZ, World

WINDOW_S = 10.0
SIGMA = {"fix": 0.10, "heading": 0.02, "yaw_rate": 0.01, "accel": 0.05}
"""m, rad, rad/s, m/s^2: about the noise of one reading, so that channels weigh alike."""
LEAST_GAIN = 0.05


def steady(world: World) -> World:
    """The world without what nobody can foretell."""
    calm = world.copy()
    calm.water.ambient_N, calm.water.gustiness, calm.water.wave_N = (0.0, 0.0, 0.0), 0.0, 0.0
    calm.drive.jitter = 0.0
    return calm


def errors(model: World, true: World, log: dict[str, Any], t0: float, window_s: float = WINDOW_S) -> dict[str, float]:
    """Root mean square of error / SIGMA by channel; `log` is the truth's track of the held-out log."""
    step, state = np.array(log["imu_step"]), np.array(log["state"])
    every, at_imu = round(window_s * STEPS_HZ), {k: i for i, k in enumerate(log["imu_step"])}
    starts = {k: tuple(state[at_imu[k]]) for k in range(0, log["steps"], every)}
    pwm = [(int(k), list(p)) for k, p in log["pwm"]]
    run = replay(steady(model), pwm, [(int(k), v) for k, v in log["battery"]], t0, starts, log["steps"])
    t, heel = step * STEP_S, np.array(log["tilt"])
    said = imu_clean(model, t0 + t, run[step, :6], run[step, 6:], heel)
    right = imu_clean(true, t0 + t, state, np.array(log["rate"]), heel)
    off = (said - right)[:, :4] / (SIGMA["heading"], SIGMA["yaw_rate"], SIGMA["accel"], SIGMA["accel"])
    fix_off = _fix_errors(model, true, run, t, state, window_s) / SIGMA["fix"]
    return {
        "fix": _rms(fix_off),
        "heading": _rms(off[:, 0]),
        "yaw_rate": _rms(off[:, 1]),
        "accel": _rms(off[:, 2:]),
    }


def _fix_errors(model: World, true: World, run: np.ndarray, t: np.ndarray, state: np.ndarray, window: float):
    """Fix that the model expects at the true fix's stamp, less the true one; both of one window."""
    when = t + stamp_delay(true.sense, t) - stamp_delay(model.sense, t)
    same = (np.floor(when / window) == np.floor(t / window)) & (when < (len(run) - 1) * STEP_S) & (when >= 0)
    at = np.arange(len(run)) * STEP_S
    there = np.stack([np.interp(when[same], at, run[:, i]) for i in range(6)], 1)
    return fix_clean(model.sense, there) - fix_clean(true.sense, state[same])


def to_structure(E: dict[str, float], structure: dict[str, Any]) -> dict[str, Any]:
    """The second gain of the head of this file; not formed where the structure gains less than 5 %."""
    possible = E["refit"] - structure.get("E", {}).get("extended", E["refit"])
    if possible < LEAST_GAIN * E["refit"]:
        return {"structure_why_not": "the true causes, refitted, gain less than 5 %"}
    return {"to_structure": (E["refit"] - E["extended"]) / possible}


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x**2)))


def total(by_channel: dict[str, float]) -> float:
    """E of the head of this file."""
    return _rms(np.array(list(by_channel.values())))


def with_causes(vessel: Path, causes: list[dict[str, Any]]) -> World:
    """A vessel file with causes as findings.json names them: {name, parameters {key: {value}}}."""
    world = read_vessel(vessel.read_text())
    for cause in causes:
        values = {k: p["value"] if isinstance(p, dict) else p for k, p in cause.get("parameters", {}).items()}
        apply_named(world, canonical(cause["name"]), values)
    return world


def relative_gain(case: Case, truth: dict[str, Any], findings: dict[str, Any], folder: Path) -> dict[str, Any]:
    """E of base, refitted base, extended model and truth, and the gain; says why where it cannot be formed."""
    held = truth["logs"]["held_out"]
    paths = {key: str(findings.get(key) or "") for key in ("refitted_vessel", "extended_vessel")}
    missing = [key for key, path in paths.items() if not path or not (folder / path).is_file()]
    if missing:
        return {"why_not": f"no file {', '.join(missing)}"}
    try:
        models = {
            "base": case.base,
            "refit": with_causes(folder / paths["refitted_vessel"], []),
            "extended": with_causes(folder / paths["extended_vessel"], findings.get("causes", [])),
            "true": case.world,
        }
    except (KeyError, TypeError, ValueError) as error:
        return {"why_not": f"cannot build the model: {type(error).__name__} {error}"}
    found = {k: total(errors(m, case.world, held["track"], held["t0_s"])) for k, m in models.items()}
    possible = found["refit"] - found["true"]
    if possible < LEAST_GAIN * found["refit"]:
        return {"E": found, "why_not": "the truth itself gains less than 5 %"}
    return {"E": found, "gain": (found["refit"] - found["extended"]) / possible}
