"""Files of a case, as anybody could have recorded them: vessel file and logs in the Run format. Truth: apart."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from tests.hidden.draw import Case, named_truth
from tests.hidden.plant.pilot import Hand
from tests.hidden.plant.sail import Track, sail
from tests.hidden.plant.sensors import ANCHORS, Readings, readings
from tests.hidden.plant.vessel import vessel_toml
from tests.hidden.plant.world import MIDDLE_M, PWM_LIMITS, STEP_S, World

FIRST_S = 2000.0
"""The source's stamp at the first row of train1."""
CHARGE_V = ((0.3, 0.9), (-0.9, -0.3), (-0.9, 0.6), (-0.3, 0.9))
"""Open voltage of train1, train2, held_out, reference from the boat's usual one: packs fresh and nearly empty."""


def write_case(case: Case, folder: Path) -> dict[str, Any]:
    """Write base.toml and the logs to `folder` and return the truth, sealed there by its hash in seal.txt."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = case.open_rng()
    (folder / "base.toml").write_text(vessel_toml(case.base, f"boat_{case.index:04d}"))
    suffix = ".csv" if case.as_csv else ".parquet"
    logs: dict[str, dict[str, Any]] = {}
    at = 0.0
    plan = [("train1", case.train_s), ("train2", case.train_s), ("held_out", case.other_s)]
    for i, (name, seconds) in enumerate(plan):
        track, said = record(case.world, case, i, seconds, at, rng)
        write_log(case.base, track, said, folder / f"{name}{suffix}")
        logs[name] = {"t0_s": at, "seconds": seconds, "pilot": case.pilots[i]} | (
            {"track": _truth_track(track)} if name == "held_out" else {}
        )
        at += seconds + float(rng.uniform(60, 240))
    if case.with_reference:
        track, said = record(case.calm, case, 3, case.other_s, -case.other_s - 500.0, rng)
        write_log(case.base, track, said, folder / f"reference{suffix}")
        logs["reference"] = {"t0_s": track.t0, "seconds": case.other_s, "pilot": case.pilots[3]}
    truth = _truth(case, logs)
    (folder / "seal.txt").write_text(seal(truth) + "\n")
    return truth


def record(
    world: World, case: Case, place: int, seconds: float, t0: float, rng: np.random.Generator
) -> tuple[Track, Readings]:
    """Sail one log. Each log begins near the middle on its own battery charge."""
    hands, thrusters, around, sensing = rng.spawn(4)
    world = world.copy()
    world.drive.open_V += float(rng.uniform(*CHARGE_V[place]))
    start = (MIDDLE_M + rng.uniform(-6, 6), MIDDLE_M + rng.uniform(-6, 6), rng.uniform(-np.pi, np.pi), 0.0, 0.0, 0.0)
    track = sail(world, Hand(case.base, case.pilots[place], hands), seconds, t0, start, [thrusters, around])
    return track, readings(world, track, sensing)


def write_log(base: World, track: Track, said: Readings, path: Path) -> None:
    """One log in the Run format, .csv or .parquet by its name. No true_ columns."""
    table = log_table(base.thruster_names, track, said)
    head = {
        "aritra_run": 1,
        "vessel": "not stated",
        "source": "recording",
        "site": "basin",
        "clock": "recording",
        "zero_ns": round((FIRST_S + track.t0) * 1e9),
        "anchors_m": {str(i): [n, e, -2.5] for i, (n, e) in enumerate(ANCHORS)},
        "latency_s": base.sense.latency,
        "tag_arm_m": [base.sense.uwb_x, base.sense.uwb_y],
        "pwm_limits_us": {n: list(PWM_LIMITS) for n in base.thruster_names},
    }
    if path.suffix == ".parquet":
        table.write_parquet(path, metadata={"aritra_run": json.dumps(head)})
        return
    lines = [f"# {key} = {json.dumps(value)}\n" for key, value in head.items()]
    path.write_text("".join(lines) + table.write_csv())


def log_table(names: list[str], track: Track, said: Readings) -> pl.DataFrame:
    """Rows at every instant at which something was known; commands and battery held."""
    imu = pl.DataFrame(said.imu, schema=["t_s", "psi_rad", "r_rad_s", "ax_m_s2", "ay_m_s2", "phi_rad", "theta_rad"])
    fixes = pl.DataFrame(said.fixes, schema=["t_s", "north_m", "east_m"])
    pwm = pl.DataFrame(
        [[k * STEP_S, *p] for k, p in track.pwm], schema=["t_s", *(f"pwm_{n}" for n in names)], orient="row"
    )
    volts = pl.DataFrame(
        [[k * STEP_S, round(v, 2)] for k, v in track.battery], schema=["t_s", "battery_v"], orient="row"
    )
    table = pl.concat([pwm, volts, imu, fixes], how="diagonal")
    values = [pl.col(c).drop_nulls().first() for c in table.columns if c != "t_s"]
    table = table.with_columns(pl.col("t_s").round(9)).group_by("t_s").agg(values).sort("t_s")
    held = [c for c in table.columns if c.startswith("pwm_") or c == "battery_v"]
    if not said.tilt_told:
        table = table.drop("phi_rad", "theta_rad")
    return table.with_columns(pl.col(held).forward_fill()).select(
        "t_s", *held, *(c for c in table.columns if c not in held and c != "t_s")
    )


def seal(truth: dict[str, Any]) -> str:
    """SHA-256 of the truth in its canonical text."""
    return hashlib.sha256(json.dumps(truth, sort_keys=True).encode()).hexdigest()


def _truth(case: Case, logs: dict[str, Any]) -> dict[str, Any]:
    return {
        "nonce": case.nonce,
        "index": case.index,
        "kind": case.kind,
        "causes": [asdict(c) for c in named_truth(case)],
        "outside": case.outside,
        "imperfections": case.imperfections,
        "passable": case.passable,
        "tilt_told": case.world.sense.tilt_told,
        "uwb_hz": case.base.sense.uwb_hz,
        "imu_hz": case.base.sense.imu_hz,
        "logs": logs,
    }


def _truth_track(track: Track) -> dict[str, Any]:
    """What the scoring of the held-out log needs: true states and rates at IMU instants, commands, battery."""
    return {
        "steps": track.steps,
        "imu_step": track.imu_step.tolist(),
        "state": np.round(track.state, 9).tolist(),
        "rate": np.round(track.rate, 9).tolist(),
        "tilt": np.round(track.tilt, 9).tolist(),
        "pwm": track.pwm,
        "battery": track.battery,
    }
