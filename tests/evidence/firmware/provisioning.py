"""Evidence: `provision`, `check` and `run` say and do the same of every wiring, on every autopilot that is at hand.

Real processes in real time. A boat with the factory's parameters is given a wiring, checked, and asked to drive without
the interlock (`run --start --unchecked`), so that `check` is judged by what the boat then does: whether it has passed
two waypoints, and left its start by a metre by the simulator's truth.
"""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from tests.evidence.line import Line, exactly
from tests.support.autopilots.firmware_rig import ARDUPILOT, binaries
from tests.support.boat_processes import boat_processes, child

WIRINGS = {"gate": True, "scaled": True, "omni": False, "unsafe_plain": False}
"""Wiring -> whether Aritra drives it."""
DRIVEN_M, PASSED = 1.0, "waypoint 2/"
DRIVE_S = 120.0
"""Time for two waypoints: 35 s in quiet; arming may take 20 s after the start of the firmware."""
RESTART_S = 8.0
"""An autopilot that was told to restart is away for so long, at most; then `check` waits for it."""


class WiringRun(NamedTuple):
    """Exit codes of `provision` and `check` (0: ready), whether a waypoint was passed, distance [m], and what was said
    of failures and refusals.
    """

    provisioned: int
    checked: int
    passed: bool
    driven_m: float
    said: str

    @property
    def drives(self) -> bool:
        """It has passed two waypoints, and has really moved."""
        return self.passed and self.driven_m > DRIVEN_M


def run_wiring(binary: Path | None, wiring: str) -> WiringRun:
    """Provision, check, drive."""
    plain = wiring == "unsafe_plain"  # no command puts that on a boat
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with boat_processes(folder, binary, ARDUPILOT / f"{wiring}.param" if plain else None) as boat:
            done = boat.command("provision", "--wiring", wiring, "--yes", "--reboot")
            time.sleep(RESTART_S)
            checked = boat.command("check", "--json")
            words = boat.words("run", "--start", "--unchecked", "--log", str(folder / "run.mcap"))
            with child(words, folder / "run.txt") as said:
                _wait_for_way(said, DRIVE_S)
                text = said.read_text(encoding="utf-8")
        words = [
            f"{row['name']} = {row['found']}" for row in json.loads(checked.stdout)["rows"] if row["level"] == "refuse"
        ]
        words += [line for line in text.splitlines() if "refuses to arm" in line][-1:]
        if done.returncode == 1:
            words += (done.stdout + done.stderr).splitlines()[-1:]
        return WiringRun(done.returncode, checked.returncode, PASSED in text, boat.driven_m(), "; ".join(words))


def _wait_for_way(said: Path, seconds: float) -> None:
    """Until two waypoints have been passed, which a boat at rest never does, or no longer than that."""
    end = time.monotonic() + seconds
    while PASSED not in said.read_text(encoding="utf-8") and time.monotonic() < end:
        time.sleep(0.5)


def provisioning(full: bool) -> Iterator[Line]:
    """Wirings: (provision, check, drives) over four wirings on every autopilot at hand; the firmwares with --full"""
    kinds = [("simulated", None), *((path.parent.name, path) for path in (binaries() if full else []))]
    for kind, binary in kinds:
        for wiring, drives in WIRINGS.items():
            r = run_wiring(binary, wiring)
            verdict = "ready" if r.checked == 0 else "DO NOT START"
            note = f"provision {r.provisioned}, check {verdict}, driven {r.driven_m:.2f} m" + (
                f"; {r.said}" if r.said else ""
            )
            yield exactly(f"{kind}, {wiring}: check is ready", r.checked == 0, drives, note=note)
            yield exactly(f"{kind}, {wiring}: the boat drives", r.drives, drives)
            yield exactly(
                f"{kind}, {wiring}: provision's exit code", r.provisioned, 2 if wiring == "unsafe_plain" else 0
            )
