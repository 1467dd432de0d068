"""Evidence for diagnosis: cases drawn from a nonce by tests/hidden, scored on files that the command line wrote.

The nonce is the commit: the cases are drawn after the last change of the code. Without --full: a few of each part.
"""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.pool import ThreadPool
from pathlib import Path
from typing import Any

import numpy as np

from companion.python_child import aritra, python
from tests.evidence.line import Line, at_least, at_most, information
from tests.hidden.score import families_of

ROOT = Path(__file__).resolve().parents[3]
CASES, FEW = 300, 20
CLEAN, FEW_CLEAN = 100, 5
REMOVED, FEW_REMOVED = 40, 6
AT_ONCE = 2  # a case has a process of its own
COMMAND = shlex.join(aritra("diagnose"))
VERDICT = f"{COMMAND} --no-report"  # where the time it takes is not the question
SAME = ("current", "turning_current"), ("wind", "gusty_wind"), ("thruster_gain", "thruster_fouling")
TOGETHER = {name: pair for pair in SAME for name in pair}
"""Entries of which one says all that the other does: taken out together."""
DEPENDS = {
    "heading": ("current", "wind", "gusty_wind", "heading_offset", "hard_iron", "uwb_lever_arm"),
    "position": ("tether", "shallow_zone", "uwb_scale", "nlos"),
    "time": ("turning_current", "waves", "clock_drift", "thruster_fouling", "lag", "dead_time", "gusty_wind"),
    "thruster": (
        "thruster_gain", "swapped_pair", "thruster_fouling", "common_loss", "astern_asymmetry", "dead_band", "lag",
        "dead_time", "rate_limit", "advance_loss", "wash", "voltage_exponent",
    ),
    "load": (
        "common_loss", "astern_asymmetry", "voltage_exponent", "dead_band", "lag", "dead_time", "rate_limit", "wash",
    ),
    "voltage": ("voltage_exponent",),
    "speed": (
        "hull_fouling", "payload", "added_mass", "yaw_inertia", "cg_shift", "cross_flow", "yaw_sway_coupling",
        "munk_moment", "advance_loss", "common_loss", "gyro_scale", "imu_misalignment", "imu_lever_arm", "uwb_latency",
        "uwb_lever_arm",
    ),
}  # fmt: skip
"""First words of `depends_on` that are right. Constant offsets (accelerometer, gyro) depend on nothing."""


def cases(full: bool) -> Iterator[Line]:
    """Hidden-effect cases of every kind"""
    results = scored(nonce(), CASES if full else FEW)
    of = lambda kind: [r for r in results if r["kind"] == kind]  # noqa: E731
    exact = lambda r: r["exact"]  # noqa: E731
    medium, small = of("medium"), of("small")
    yield _share("one medium cause, exact set", medium, exact, 95)
    families = {r["truth"][0].partition(":")[0] for r in medium}
    worst = min(families, key=lambda f: _part([r for r in medium if r["truth"][0].startswith(f)], exact), default="")
    yield _share(f"  least found: {worst}", [r for r in medium if r["truth"][0].startswith(worst)], exact, 80)
    yield _share("small cause named", small, exact, 85)
    yield _share("  wrong name", small, lambda r: bool(r["wrong"]), 2, at_most)
    yield _share("two medium causes, exact set", of("two"), exact, 90)
    yield _share("three medium causes, exact set", of("three"), exact, 75)
    yield from _clean(of("none"))
    yield _share("outside: not falsely confirmed", of("outside"), lambda r: not r.get("falsely_confirmed"), 95)
    yield _share("  right dependency first", of("outside"), lambda r: bool(r.get("dependency_right")), 85)
    yield _share("other form: family named", of("variant"), lambda r: bool(r["hits"]), 85)
    hit = [r for r in of("variant") if r["hits"]]
    yield information("  and flagged", sum(bool(r.get("flagged")) for r in hit), "", f"of {len(hit)}")
    gains, truths = ([r["gain"][k] for r in results if k in r.get("gain", {})] for k in ("to_structure", "gain"))
    yield at_least("gain relative to the true structure refitted, median", float(np.median(gains)), 0.98)
    yield at_least("  tenth percentile", float(np.percentile(gains, 10)), 0.90)
    yield information("  relative to the truth itself, median", float(np.median(truths)), "", f"of {len(truths)}")
    parameters = [p for r in results for p in r["parameters"]]
    errors = [100 * p["relative_error"] for p in parameters if "relative_error" in p]
    yield at_most("parameter error, median", float(np.median(errors)), 3.0, "%")
    covered = [p["covered"] for p in parameters if p.get("covered") is not None]
    yield at_least("95 % intervals that cover", 100 * float(np.mean(covered)), 90.0, "%")
    yield _share("one medium cause, UWB 1 Hz 10 cm", [r for r in medium if r["uwb_hz"] == 1], exact, 85)
    yield _share("one medium cause, UWB 5 Hz 7 cm", [r for r in medium if r["uwb_hz"] == 5], exact, 95)
    walls = [r["wall_s"] for r in results]
    yield at_most("time per case, two at once, median", float(np.median(walls)), 30.0, "s")
    yield at_most("  worst", max(walls), 120.0, "s")
    yield information("  processor time, median", float(np.median([r["cpu_s"] for r in results])), "s")
    yield at_most("memory, worst", max(r.get("memory_mb", 0.0) for r in results), 1000.0, "MB")


def nothing(full: bool) -> Iterator[Line]:
    """Cases in which nothing is hidden"""
    yield from _clean(scored(nonce() + "-nothing", CLEAN if full else FEW_CLEAN, "--kind", "none", command=VERDICT))


def removed(full: bool) -> Iterator[Line]:
    """Cases whose own entry is taken out of the catalogue"""
    families = [f for f in families_of("medium") if any(f in names for names in DEPENDS.values())]
    wanted, right, wrong, told = REMOVED if full else FEW_REMOVED, 0, 0, []
    chosen = [families[(i * (1 if full else 7)) % len(families)] for i in range(wanted)]

    def judged(i: int) -> dict[str, Any]:
        out = [word for name in TOGETHER.get(chosen[i], (chosen[i],)) for word in ("--without", name)]
        words = ("--kind", "medium", "--family", chosen[i], "--first", str(i))
        return scored(nonce() + "-removed", 1, *words, command=shlex.join([*shlex.split(VERDICT), *out]))[0]

    with ThreadPool(AT_ONCE) as pool:
        for i, r in enumerate(pool.imap(judged, range(wanted))):
            family = chosen[i]
            first = (r.get("depends_on") or [""])[0].partition(":")[0]
            ok = r["verdict"] in ("unknown", "partial") and family in DEPENDS.get(first, ())
            right += ok
            wrong += r["verdict"] == "named"
            if not ok:
                told.append(f"{family}: {r['verdict']} {','.join(r['named'])} {first}")
            print(f"  {i + 1}/{wanted} {family}: {r['verdict']} {', '.join(r['named'])} {first}", flush=True)
    yield at_least("unknown, right dependency first", 100 * right / wanted, 85.0, "%", "; ".join(told))
    yield at_most("confident wrong name", 100 * wrong / wanted, 5.0, "%")


def _clean(results: Sequence[dict[str, Any]]) -> Iterator[Line]:
    yield _share("nothing hidden: any name", results, lambda r: bool(r["named"]), 2, at_most)
    yield _share("  false unknown", results, lambda r: r["outcome"] == "false_unknown", 3, at_most)


def _part(results: Sequence[dict[str, Any]], test: Callable[[dict[str, Any]], bool]) -> float:
    return 100 * sum(bool(test(r)) for r in results) / len(results) if results else float("nan")


def _share(
    what: str,
    results: Sequence[dict[str, Any]],
    test: Callable[[dict[str, Any]], bool],
    goal: float,
    judge: Callable[..., Line] = at_least,
) -> Line:
    hits = sum(bool(test(r)) for r in results)
    if not results:
        return information(what, float("nan"), "%", "no such case drawn")
    return judge(what, _part(results, test), float(goal), "%", f"{hits} of {len(results)}")


def nonce() -> str:
    told = subprocess.run(["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=True)
    return told.stdout.strip()[:12]


def scored(nonce: str, count: int, *words: str, command: str = COMMAND) -> list[dict[str, Any]]:
    print(f"  nonce {nonce}, {count} cases {' '.join(words)}", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        call = python("-m", "tests.hidden.score", "--nonce", nonce, "--cases", count, "--out", folder)
        call += [*words, "--command", command]
        call += ["--keep"] if count == 1 else []
        env = os.environ | {"PYTHONPATH": str(ROOT)}
        subprocess.run(call, cwd=ROOT, env=env, check=True, stdout=sys.stderr if count > 1 else subprocess.DEVNULL)
        results = json.loads((Path(folder) / "results.json").read_text())["results"]
        for path in Path(folder).glob("cases/*/result/findings.json"):
            results[0]["depends_on"] = json.loads(path.read_text())["depends_on"]
        return results


PARTS = (cases, nothing, removed)
