"""Evidence for the first minute: what is downloaded and unpacked, and how long it takes until the boat moves.

Needs the network: pip fetches every package of three lock files, and installs those of one into a clean clone.
"""

from __future__ import annotations

import subprocess
import sys
import tarfile
import tempfile
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from companion.core.messages import OverrideLease
from companion.logs.log_file import LogFile
from tests.evidence.house.trees import ROOT, git
from tests.evidence.line import Line, at_most, exactly, information

LOCKS = {"boat": "requirements.lock", "demo": "requirements-demo.lock", "everything": "requirements-dev.lock"}
BEFORE = (125, 727e6, 2459e6)
"""(packages, bytes downloaded, bytes unpacked) of the one lock file that there was for everybody until
commit 233bd10, for x86-64 and Python 3.11; measured as below."""
MOST_OF_BEFORE, MOST_OF_BOAT, MOST_PACKAGES = 0.6, 1.1e9, 35
NEUTRAL_US = 1500


class Bill(NamedTuple):
    """What a lock file costs: packages, bytes that are downloaded, bytes of the files in them."""

    packages: int
    downloaded: int
    unpacked: int


def bill(lock: Path) -> Bill:
    """Fetch all packages of a lock file for this machine."""
    with tempfile.TemporaryDirectory() as folder:
        pip = [sys.executable, "-m", "pip", "download", "-qq", "--no-deps", "--require-hashes"]
        subprocess.run([*pip, "-r", str(lock), "-d", folder], check=True)
        files = list(Path(folder).iterdir())
        return Bill(len(files), sum(file.stat().st_size for file in files), sum(map(_unpacked, files)))


def _unpacked(file: Path) -> int:
    if file.suffix == ".whl":
        with zipfile.ZipFile(file) as wheel:
            return sum(part.file_size for part in wheel.infolist())
    with tarfile.open(file) as source:
        return sum(part.size for part in source)


def install_sizes(full: bool) -> Iterator[Line]:
    """What each lock file brings, as the registry's own packages have it"""
    bills = {name: bill(ROOT / lock) for name, lock in LOCKS.items()}
    for name, cost in {"one lock for everybody, before": Bill(*map(int, BEFORE)), **bills}.items():
        note = f"{cost.downloaded / 1e6:.0f} MB to download, {cost.unpacked / 1e6:.0f} MB unpacked"
        yield information(f"{name}: packages", cost.packages, "", note)
    yield at_most("demo: bytes downloaded, share of before", bills["demo"].downloaded / BEFORE[1], MOST_OF_BEFORE)
    yield at_most("demo: bytes unpacked, share of before", bills["demo"].unpacked / BEFORE[2], MOST_OF_BEFORE)
    yield at_most("boat: unpacked", bills["boat"].unpacked / 1e9, MOST_OF_BOAT / 1e9, "GB")
    yield at_most("boat: packages", bills["boat"].packages, MOST_PACKAGES)


def install_to_moving_boat(full: bool) -> Iterator[Line]:
    """`git clone`, `make demo`: seconds until thrusters push, as the log has it; on this machine and network"""
    with tempfile.TemporaryDirectory(prefix="aritra-first-minute-") as folder:
        clone, began = Path(folder) / "aritra", time.time()
        git("clone", "--quiet", str(ROOT), str(clone))
        subprocess.run(["scripts/install", "demo"], cwd=clone, check=True, stdout=subprocess.DEVNULL)
        yield information("from the clone to an installed program", time.time() - began, "s")
        done = subprocess.run(["make", "demo"], cwd=clone, check=False, stdout=subprocess.DEVNULL)
        log = LogFile(clone / "out/demo/run.mcap")
        pushes = (lease.t_ns for lease in log.messages(OverrideLease) if any(us != NEUTRAL_US for us in lease.pwm_us))
        moves = (next(pushes) + log.wall_offset_ns) * 1e-9
        yield information("from the clone to thrusters that push", moves - began, "s")
        yield exactly("the demo's exit code", done.returncode, 0)


PARTS = (install_sizes, install_to_moving_boat)
