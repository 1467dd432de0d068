"""A commissioning that is killed at random moments and started again, as its user would: the command, kill -9."""

from __future__ import annotations

import hashlib
import random
import subprocess
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import msgspec

from companion.boat.load_run import EXAMPLES, load_setup
from companion.core.model.load_vessel import load_vessel
from companion.core.model.vessel_text import vessel_toml
from companion.python_child import aritra
from sim.commission.job import NEW, OLD
from sim.commission.journal import INTERRUPTED, RECORD, FlightRecord, stage_of
from sim.commission.stages import PROVEN, SIGNS
from tests.evidence.commission.draw import drawn
from tests.evidence.commission.one_boat import MINUTES
from tests.evidence.line import Line, at_most, exactly

BOAT, KILLS = 7, 10
ALIVE_S = (3.0, 20.0)
"""A program lives so long, evenly: from its imports, and the fit of all logs so far, to the flight after it."""
LIMIT_S = 1800.0


def killed(full: bool) -> Iterator[Line]:
    """Killed at ten random moments and started again (--full: two boats; about 8 minutes each)"""
    for seed in range(BOAT, BOAT + (2 if full else 1)):
        yield from _killed(seed)


def _killed(seed: int) -> Iterator[Line]:
    boat, rng = drawn(seed, load_setup(EXAMPLES / "aritra.toml").pilot.vessel), random.Random(seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file, vessel in (("first.toml", boat.first), ("true.toml", boat.true)):
            (folder / file).write_text(vessel_toml(vessel), encoding="utf-8")
        out, kept, spoilt, kills, code = folder / "out", dict[Path, str](), 0, 0, None
        while code is None and kills <= KILLS:
            child = _start(folder)
            try:
                code = child.wait(rng.uniform(*ALIVE_S) if kills < KILLS else LIMIT_S)
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()
                kills += 1
            now = _finished(out)
            spoilt += sum(now.get(path) != digest for path, digest in kept.items())
            kept = now
        records = {
            path: msgspec.json.decode((path / RECORD).read_bytes(), type=FlightRecord) for path in _recorded(out)
        }
        flights = [path for path in out.iterdir() if path.is_dir()]
        done = Counter(stage_of(path) for path, record in records.items() if record.done)
        interrupted = sum(record.ending == INTERRUPTED for record in records.values())
        minutes = sum(record.seconds for record in records.values()) / 60
        commissioned = out / "commissioned.toml"
        loads = commissioned.exists() and bool(load_vessel(commissioned.read_text(encoding="utf-8"), name="it"))
    note = f"{len(flights)} flights, {interrupted} interrupted, {minutes:.1f} minutes"
    yield exactly(f"boat {seed}: kills while it was at work", kills, KILLS, note=note)
    yield exactly("  ended with exit code 0: commissioned", code == 0, True)
    yield exactly("  files of finished flights that were changed or lost", spoilt, 0)
    yield exactly("  flights without a record", len(flights) - len(records), 0)
    yield at_most("  times that the proof was flown whole", done[PROVEN.name], 1)
    yield at_most("  times that a mission was driven whole, each", max(done[OLD], done[NEW]), 1)
    yield at_most("  flights of signs that came to their end", done[SIGNS.name], 4)
    yield at_most("  minutes flown in all", minutes, MINUTES, "min")
    yield exactly("  the vessel file loads", loads, True)


def _start(folder: Path) -> subprocess.Popen[bytes]:
    words = ["commission", "--vessel", "first.toml", "--simulate", "true.toml", "--out", "out"]
    return subprocess.Popen(aritra(*words), cwd=folder, stdout=subprocess.DEVNULL)


def _recorded(out: Path) -> list[Path]:
    """Folders of all flights that have a record."""
    return sorted(path.parent for path in out.glob(f"*/{RECORD}"))


def _finished(out: Path) -> dict[Path, str]:
    """Digest of each file of all flights that have a record."""
    files = (path for folder in _recorded(out) for path in folder.iterdir())
    return {path: hashlib.sha256(path.read_bytes()).hexdigest() for path in files}
