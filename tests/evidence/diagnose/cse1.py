"""Evidence on C/S Enterprise I: what a diagnosis says that a crude model of a real ship lacks. See docs/cse1.md."""

from __future__ import annotations

import json
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

from companion.core.model.load_vessel import load_vessel
from companion.core.model.vessel_text import vessel_toml
from companion.python_child import aritra
from sim.fitting.identify.result import fit_structured
from sim.fitting.identify.vessel_out import identified_vessel
from sim.studies.cse1.study import DATE, RUNS, crude, recording
from tests.evidence.line import Line, at_most, information

ROOT = Path(__file__).resolve().parents[3]
DATA = ROOT.parent / "shared" / "data" / "cse1"
FILE = ROOT / "deploy" / "boats" / "cse1.toml"
BASE = ROOT / "out" / "cse1_crude.toml"
LIMIT_S = 900


def _base() -> Path:
    """The study's crude model as fitted on random_run1: straight units, no trim, curve or damping by speed."""
    vessel = load_vessel(FILE.read_text(), name=FILE.name)
    found = fit_structured([recording(DATA, RUNS[0])], vessel, crude(vessel))
    BASE.parent.mkdir(exist_ok=True)
    BASE.write_text(vessel_toml(identified_vessel(vessel, found, date=DATE), "Crude model of random_run1.\n"))
    return BASE


def _diagnosed(fitted: tuple[str, ...], held_out: str) -> Iterator[Line]:
    """By the command line. Judged is only that what it names makes no held-out prediction worse."""
    if not DATA.is_dir():
        yield information("left out: ../shared/data/cse1 beside the checkout is not here", float("nan"))
        return
    with tempfile.TemporaryDirectory() as folder:
        logs = [str(DATA / f"{name}.csv.gz") for name in fitted]
        words = [*logs, "--vessel", str(_base()), "--held-out", str(DATA / f"{held_out}.csv.gz"), "--out", folder]
        command = aritra("diagnose", *words, "--no-report")
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=LIMIT_S, check=False)
        if done.returncode not in (0, 1):
            raise RuntimeError(done.stderr)
        found = json.loads((Path(folder) / "findings.json").read_text())
    print(f"  verdict: {found['verdict']}", *found["summary"], sep="\n  ", flush=True)
    for cause in found["causes"]:
        yield information(f"{cause['name']}: evidence", cause["evidence_nats"], "nats")
    for check in found["adequacy"]["checks"]:
        if not check["passed"]:
            yield information(f"left over: {check['name']}", check["value"], note=f"limit {check['limit']:g}")
    for e in found["held_out"]:
        low, high = (100 * g for g in e["ci"]["gain"])
        note = (
            f"as given {e['base']:.3g}, refitted {e['refit']:.3g}, with causes {e['extended']:.3g} {e['unit']}; "
            f"gain {100 * e['gain']:.0f} %, 95 % {low:.0f} to {high:.0f}"
        )
        what = f"{e['channel']} at {e['horizon_s']} s: with causes over refitted"
        yield at_most(what, e["extended"] / e["refit"], 1.0, note=note)
    yield information("time", found["runtime_s"], "s")


def cse1_run1(full: bool) -> Iterator[Line]:
    """C/S Enterprise I, crude model of random_run1: what the same run says is missing, judged on random_run3"""
    yield from _diagnosed(RUNS[:1], RUNS[1])


def cse1_both(full: bool) -> Iterator[Line]:
    """C/S Enterprise I, the same model: what random_run1 and random_run3 say is missing, judged on dptest"""
    yield from _diagnosed(RUNS[:2], RUNS[2])


def cse1_station(full: bool) -> Iterator[Line]:
    """C/S Enterprise I, the same model: what dptest, another day, says is missing, judged on random_run3"""
    yield from _diagnosed(RUNS[2:], RUNS[1])


PARTS = (cse1_run1, cse1_both, cse1_station)
