"""Boats that nobody here drew: first vessel files from five answers, and diagnosis of a plant of foreign structure."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from msgspec.structs import replace

from companion.__main__ import main
from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.load_vessel import load_vessel
from companion.logs.readers.table import write_run
from sim.trajectory import simulate
from sim.world.teleop_log import teleop_run
from tests.evidence.diagnose.hidden_cases import VERDICT, nonce, scored
from tests.evidence.line import Line, at_least, at_most, exactly
from tests.support.vessel_fixtures import boat

ANSWERS = (
    "--size 1.2 0.93 --mass 17 --layout differential --position gnss",
    "--size 1.47 0.75 --layout x",
    "--size 1.0 0.3 --layout bow --thruster 20",
    "--size 4.5 1.8 --layout x --thruster 300",
)
SEED, SECONDS = 7, 120.0
CASES, FEW = 300, 8


def vessel_new(full: bool) -> Iterator[Line]:
    """First vessel files from answers alone: load, simulate, and what identify makes of a log of another boat"""
    loaded = stable = accepted = 0
    with tempfile.TemporaryDirectory() as folder:
        for i, words in enumerate(ANSWERS):
            at = Path(folder) / f"{i}"
            at.mkdir()
            loaded += main(["vessel", "new", "--out", f"{at}/boat.toml", *words.split()]) == 0
            vessel = load_vessel((at / "boat.toml").read_text(), name="boat.toml")
            stable += _stable(vessel)
            true = boat("aritra") if i == 1 else replace(vessel, sensors=boat("aritra").sensors)
            write_run(teleop_run(true, SEED, SECONDS, uwb_hz=5.0, sigma_m=0.07), at / "drive.csv")
            files = ["--vessel", f"{at}/boat.toml", "--out", f"{at}/out"]
            accepted += main(["identify", f"{at}/drive.csv", *files, "--no-taylor"]) < 2
    yield exactly("vessel new: files that load", loaded, len(ANSWERS))
    yield exactly("  that stay finite under full thrust, at rest 2 min later", stable, len(ANSWERS))
    yield exactly(
        "  that identify accepts", accepted, len(ANSWERS), "", f"{SECONDS:.0f} s by hand; the second of aritra.toml"
    )


def _stable(vessel: VesselFile) -> bool:
    pulses = np.repeat(np.random.default_rng(SEED).choice([1100, 1900], (30, len(vessel.thrusters))), 200, axis=0)
    driven = simulate(vessel, np.zeros(6), pulses, 0.01).x
    left = simulate(vessel, driven[-1], np.full((12000, len(vessel.thrusters)), 1500), 0.01).nu
    return bool(np.isfinite(driven).all() and np.abs(left[-1]).max() < 0.1)


def foreign_plants(full: bool) -> Iterator[Line]:
    """Hidden-effect cases on boats that no vessel file can describe (tests/hidden/README.md)"""
    results = scored(nonce() + "-foreign", CASES if full else FEW, "--plant", "foreign", command=VERDICT)
    of = lambda kind: [r for r in results if r["kind"] == kind]  # noqa: E731
    yield _share("foreign plant: one medium cause, exact set", of("medium"), lambda r: r["exact"], at_least, 92)
    yield _share("  wrong or false extra name", of("medium"), lambda r: bool(r["wrong"]), at_most, 3)
    for told, words in ((True, "with"), (False, "without")):
        none = [r for r in of("none") if r["tilt"] is told]
        yield _share(
            f"  nothing hidden, {words} roll and pitch: any name", none, lambda r: bool(r["named"]), at_most, 3
        )
    covered = [p["covered"] for r in results for p in r["parameters"] if p.get("covered") is not None]
    yield at_least(
        "  95 % intervals that cover", 100 * float(np.mean(covered or [np.nan])), 90.0, "%", f"of {len(covered)}"
    )


def _share(
    what: str,
    results: list[dict[str, Any]],
    test: Callable[[dict[str, Any]], bool],
    judge: Callable[..., Line],
    goal: int,
) -> Line:
    hits = sum(bool(test(r)) for r in results)
    return judge(what, 100 * hits / max(len(results), 1), goal, "%", f"{hits} of {len(results)}")


PARTS = (vessel_new, foreign_plants)
"""Parts of `scripts/evidence real-logs`."""
