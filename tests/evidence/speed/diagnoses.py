"""Evidence for the speed of a diagnosis: hidden cases as `evidence diagnose` draws them, one at a time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tests.evidence.diagnose.hidden_cases import VERDICT, nonce, scored
from tests.evidence.line import Line, at_most, information

CASES, FEW = 40, 8


def diagnoses(full: bool) -> Iterator[Line]:
    """Diagnosis of hidden cases of all kinds, one at a time, without the report (40 with --full, some 25 minutes)"""
    results = scored(f"{nonce()}-speed", CASES if full else FEW, "--jobs", "1", command=VERDICT)
    wall, cpu = ([r[k] for r in results] for k in ("wall_s", "cpu_s"))
    note = f"{len(wall)} cases, {min(wall):.1f} to {max(wall):.1f} s"
    yield at_most("diagnosis of a case, wall clock, median", float(np.median(wall)), 10.0, "s", note)
    yield information("  processor time, median", float(np.median(cpu)), "s")


PARTS = (diagnoses,)
