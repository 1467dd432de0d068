"""Evidence for aarch64: the boat's installation in a Debian under emulation, beside this machine (`scripts/arm64`)."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np

from tests.evidence.line import Line, at_least, at_most, exactly, information
from tests.evidence.pytest_counts import counts, failures

ROOT = Path(__file__).resolve().parents[3]
DEBIAN = ROOT / "out/arm64"
PYTHON = "/boat/opt/aritra/bin/python"
ANSWERS = "tests.evidence.friendly.machine_answers"
TESTS = ("tests/companion/core", "tests/drivers")
LEAST_PASSED = 3600
"""Of about 3,700 tests of core and drivers: fewer are not all of them."""
CLOSE = 1e-9
"""Largest difference of forces [N] and states [m, rad, m/s, rad/s] that counts as none."""
Answer = dict[str, np.ndarray]


def arm64(full: bool) -> Iterator[Line]:
    """aarch64, emulated: installed by deploy/install.sh, core's and drivers' tests, a mission, plans (--full)"""
    if not full:
        yield information("over an hour: with --full, as `make arm64`", 0)
        return
    subprocess.run(["scripts/arm64", "prepare", str(DEBIAN)], cwd=ROOT, check=True)
    yield from _tests()
    here, there = ROOT / "out/arm64-answers/here", DEBIAN / "answers"
    for folder in (here, there):
        folder.mkdir(parents=True, exist_ok=True)
    _run(sys.executable, "-P", "-m", ANSWERS, "drive", str(here))
    _emulated(PYTHON, "-P", "-m", ANSWERS, "drive", "/answers")
    yield from _missions(here / "mission.json", there / "mission.json")
    (there / "requests.json").write_bytes((here / "requests.json").read_bytes())
    _run(sys.executable, "-P", "-m", ANSWERS, "plan", str(here))
    _emulated(PYTHON, "-P", "-m", ANSWERS, "plan", "/answers")
    yield from _plans(_read(here / "plans.npz"), _read(there / "plans.npz"))


def _tests() -> Iterator[Line]:
    """Everyday tests of core and drivers, within."""
    words = ["-P", "-m", "pytest", "-q", "-n", "2", "--dist", "loadfile", "-p", "no:cacheprovider"]
    said = _emulated(PYTHON, *words, "-m", "not long", *TESTS, check=False).stdout
    found, failed = counts(said), failures(said)
    yield at_least("tests of core and drivers that passed", found["passed"], LEAST_PASSED)
    yield exactly("tests that failed", found["failed"] + found["error"], 0, note="; ".join(failed))
    yield information("tests skipped (measured data is not within)", found["skipped"])


def _missions(here: Path, there: Path) -> Iterator[Line]:
    """The same mission by both."""
    ours, theirs = (msgspec.json.decode(path.read_bytes()) for path in (here, there))
    yield exactly("it is another machine: aarch64", theirs["machine"] == "aarch64" != ours["machine"], True)
    yield exactly("mission there: waypoints passed", theirs["passed"], theirs["points"])
    yield information(
        "cross-track error there", theirs["cross_track_rms_m"], "m", f"here {ours['cross_track_rms_m']:g}"
    )
    same = len(ours["t_s"]) == len(theirs["t_s"])
    apart = np.abs(np.subtract(ours["truth"], theirs["truth"])).max() if same else np.inf
    yield information("largest difference of the driven paths and speeds", apart, "", f"{len(ours['t_s'])} moments")


def _plans(ours: Answer, theirs: Answer) -> Iterator[Line]:
    """Plans to the same requests, and trajectories under the same pulses: there beside here, and both ways there."""
    for name in ("plans", "motion"):
        compiled, interpreted = (theirs[f"{name}_{way}"] for way in ("compiled", "interpreted"))
        count = f"{len(compiled)} of {compiled[0].size} numbers"
        yield at_most(f"{name} there, compiled beside interpreted", _apart(compiled, interpreted), CLOSE, "", count)
        yield at_most(f"{name}, compiled: there beside here", _apart(compiled, ours[f"{name}_compiled"]), CLOSE)
        yield at_most(
            f"{name}, interpreted: there beside here", _apart(interpreted, ours[f"{name}_interpreted"]), CLOSE
        )


def _apart(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.abs(a - b).max())


def _read(path: Path) -> Answer:
    with np.load(path) as file:
        return dict(file)


def _run(*words: str, check: bool = True) -> subprocess.CompletedProcess[str]:
    return subprocess.run(words, cwd=ROOT, check=check, stdout=subprocess.PIPE, text=True)


def _emulated(*words: str, check: bool = True) -> subprocess.CompletedProcess[str]:
    return _run("scripts/arm64", "run", str(DEBIAN), "env", "--chdir=/src", *words, check=check)


PARTS = (arm64,)
