"""Draw cases, let the command line diagnose their files, open the truth, score.

    python -m tests.hidden.score --nonce N --cases K --out DIR

The program sees one folder of files. Truth stays in this process until its findings are read, and must then fit the
hash that was written beside the files. Exit code: 0 done (however well), 2 bad arguments.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from tests.hidden.draw import Case, draw
from tests.hidden.effects.catalogue import CATALOGUE
from tests.hidden.effects.outside import OUTSIDE
from tests.hidden.gain import relative_gain, to_structure
from tests.hidden.names import FAMILIES, KINDS
from tests.hidden.report import confusion_csv, goals, markdown
from tests.hidden.scoring import MalformedError, judge
from tests.hidden.write import seal, write_case

ABOUT = "Draw cases, let the command line diagnose their files, score."


@dataclass(frozen=True)
class Options:
    """What all cases of one scoring share."""

    nonce: str
    out: Path
    command: tuple[str, ...]
    timeout_s: float
    kind: str | None
    family: str | None
    uwb_hz: int | None
    keep: bool
    train_s: float | None
    threads: str | None
    foreign: bool


def run_case(options: Options, index: int) -> dict[str, Any]:
    """One case from drawing to points."""
    case = draw(
        options.nonce,
        index,
        kind=options.kind,
        family=options.family,
        uwb_hz=options.uwb_hz,
        train_s=options.train_s,
        foreign=options.foreign,
    )
    folder = options.out / "cases" / f"case_{index:04d}"
    shutil.rmtree(folder, ignore_errors=True)
    truth = write_case(case, folder)
    told, cost = _diagnose(options, case, folder)
    findings, why = _findings(folder / "result", cost)
    if seal(truth) != (folder / "seal.txt").read_text().strip():
        raise RuntimeError(f"{folder}: the truth does not fit its seal")
    sealed = options.out / "sealed"
    sealed.mkdir(parents=True, exist_ok=True)
    (sealed / f"case_{index:04d}.json").write_text(json.dumps(truth, sort_keys=True))
    result = scored(case, truth, findings, folder / "result", why)
    if "gain" in result:
        result["gain"] |= _against_structure(options, case, truth, result, folder)
    if not options.keep:
        for path in folder.glob("*.*"):
            if path.suffix in (".csv", ".parquet"):
                path.unlink()
    return result | cost | {"index": index, "case": case.kind, "command": told}


def scored(case: Case, truth: dict, findings: dict | None, folder: Path, why: str) -> dict[str, Any]:
    """Points and gain of one case."""
    try:
        result = judge(truth, findings)
    except MalformedError as error:
        result, why, findings = judge(truth, None), f"malformed: {error}", None
    if findings is not None and truth["causes"] and case.world.afloat is None:
        result["gain"] = relative_gain(case, truth, findings, folder)
        result["held_out"] = findings.get("held_out")
    return result | ({"why": why} if why else {})


def _against_structure(
    options: Options, case: Case, truth: dict[str, Any], result: dict[str, Any], folder: Path
) -> dict[str, Any]:
    """Gain relative to that of the true causes, refitted by the program itself. The same causes: the same fit.

    The program is told the true causes only here, after its own findings are closed.
    """
    if "gain" not in result["gain"]:
        return {}
    if result["exact"] and truth["kind"] != "variant":
        return {"to_structure": 1.0}
    known = [word for cause in truth["causes"] for word in ("--believe", cause["id"])]
    _, cost = _diagnose(options, case, folder, "structure", known)
    findings, why = _findings(folder / "structure", cost)
    if findings is None:
        return {"structure_why_not": why}
    found = relative_gain(case, truth, findings, folder / "structure")
    return {"E_structure": found.get("E", {}).get("extended")} | to_structure(result["gain"]["E"], found)


def _diagnose(
    options: Options, case: Case, folder: Path, out: str = "result", more: Sequence[str] = ()
) -> tuple[str, dict[str, Any]]:
    """Run the program on the files; its wall and processor time [s], memory [MB], exit code."""
    suffix = ".csv" if case.as_csv else ".parquet"
    words = [*options.command, f"train1{suffix}", f"train2{suffix}", "--vessel", "base.toml"]
    if case.with_reference:
        words += ["--reference", f"reference{suffix}"]
    words += ["--held-out", f"held_out{suffix}", "--out", out, *more]
    root = Path(__file__).resolve().parents[2]
    env = os.environ | {"PYTHONPATH": os.pathsep.join([str(root), os.environ.get("PYTHONPATH", "")]).strip(os.pathsep)}
    if options.threads:
        env |= {"OMP_NUM_THREADS": options.threads, "OPENBLAS_NUM_THREADS": options.threads}
    begun = time.monotonic()
    with (folder / f"output_{out}.txt").open("w") as output:
        process = subprocess.Popen(words, cwd=folder, env=env, stdout=output, stderr=subprocess.STDOUT)
        status, usage = _wait(process, options.timeout_s)
    cost = {
        "wall_s": time.monotonic() - begun,
        "cpu_s": usage.ru_utime + usage.ru_stime,
        "memory_mb": usage.ru_maxrss / 1024,
        "exit": status,
    }
    return shlex.join(words), cost


def _wait(process: subprocess.Popen, timeout_s: float) -> tuple[int | str, resource.struct_rusage]:
    """Exit code, or "timeout" after which it is killed; what it used."""
    until = time.monotonic() + timeout_s
    late = False
    while True:
        pid, status, usage = os.wait4(process.pid, os.WNOHANG)
        if pid:
            process.returncode = os.waitstatus_to_exitcode(status)
            return "timeout" if late else process.returncode, usage
        if not late and time.monotonic() > until:
            process.kill()
            late = True
        time.sleep(0.05)


def _findings(folder: Path, cost: dict[str, Any]) -> tuple[dict | None, str]:
    path = folder / "findings.json"
    if cost["exit"] == "timeout":
        return None, "timeout"
    try:
        findings = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        return None, f"exit {cost['exit']}, no findings.json: {type(error).__name__}"
    return (findings, "") if isinstance(findings, dict) else (None, "findings.json is not an object")


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = _parser()
    args = parser.parse_args(arguments)
    if args.family and args.family not in families_of(args.kind):
        parser.error(f"--family {args.family}: --kind must be one that draws it")
    options = Options(
        nonce=args.nonce,
        out=args.out.resolve(),
        command=tuple(shlex.split(args.command)),
        timeout_s=args.timeout,
        kind=args.kind,
        family=args.family,
        uwb_hz=args.uwb,
        keep=args.keep,
        train_s=args.seconds,
        threads="1" if args.jobs > 1 else None,
        foreign=args.plant == "foreign",
    )
    options.out.mkdir(parents=True, exist_ok=True)
    try:
        results = _kept(options.out, _head(args)) if args.resume else []
    except ValueError as error:
        parser.error(f"--resume: {error}")
    done, begun = {r["index"] for r in results}, time.monotonic()
    numbers = [i for i in range(args.first, args.first + args.cases) if i not in done]
    for r in _results(options, numbers, args.jobs):
        results.append(r)
        true = ", ".join(r["truth"]) or r["outside"] or "nothing"
        said = ", ".join(r["named"]) or r["verdict"]
        place = f"{len(results)}/{args.cases} case {r['index']}"
        print(f"{place}: {r['outcome']}: {true} -> {said}, {r['wall_s']:.0f} s", flush=True)
        _save(options.out, results, args, time.monotonic() - begun)
    _save(options.out, results, args, time.monotonic() - begun)
    for quantity, goal, reached in goals(results):
        print(f"{quantity:44} {goal:18} {reached}")
    return 0


def _results(options: Options, numbers: Sequence[int], jobs: int) -> Iterator[dict[str, Any]]:
    """Results as they come. Workers are spawned: a fork of a process in which polars has threads can hang."""
    if jobs == 1:
        yield from (run_case(options, i) for i in numbers)
        return
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        for job in as_completed([pool.submit(run_case, options, i) for i in numbers]):
            yield job.result()


def _head(args: argparse.Namespace) -> dict[str, Any]:
    """What cases are drawn from."""
    return {"nonce": args.nonce, "kind": args.kind or "as drawn", "UWB": args.uwb or "as drawn", "plant": args.plant}


def _kept(out: Path, head: dict[str, Any]) -> list[dict[str, Any]]:
    """Results of an earlier call. Raises ValueError where they are of other cases."""
    path = out / "results.json"
    if not path.exists():
        return []
    kept = json.loads(path.read_text())
    other = [f"{k} {kept['head'][k]}, not {v}" for k, v in head.items() if kept["head"][k] != v]
    if other:
        raise ValueError(f"{path} is of other cases: {'; '.join(other)}")
    return kept["results"]


def _save(out: Path, results: list[dict[str, Any]], args: argparse.Namespace, took_s: float) -> None:
    results.sort(key=lambda r: r["index"])
    span = f"{results[0]['index']} to {results[-1]['index']}" if results else "none"
    took = f"{took_s / 60:.1f} min" + (" since it was resumed" if args.resume else "")
    head = _head(args) | {"cases": f"{len(results)}, {span}", "at once": args.jobs, "took": took}
    (out / "results.json").write_text(json.dumps({"head": head, "results": results}, indent=1))
    (out / "confusion.csv").write_text(confusion_csv(results))
    (out / "summary.md").write_text(markdown(results, head))


def families_of(kind: str | None) -> tuple[str, ...]:
    """What a single case of this kind may hold."""
    if kind == "outside":
        return tuple(o.name for o in OUTSIDE)
    tests = {"medium": lambda e: True, "small": lambda e: not e.fixed, "variant": lambda e: bool(e.variants)}
    return tuple(f for f, e in CATALOGUE.items() if kind in tests and tests[kind](e))


def _parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(prog="python -m tests.hidden.score", description=ABOUT)
    p.add_argument("--nonce", required=True, help="any text; the same text draws the same cases")
    p.add_argument("--cases", type=int, required=True, help="how many")
    p.add_argument("--first", type=int, default=0, help="number of the first case")
    p.add_argument("--resume", action="store_true", help="keep the results that --out holds, do what is missing")
    p.add_argument("--out", type=Path, default=Path("out/hidden"), help="folder for results")
    p.add_argument("--kind", choices=KINDS, help="only this kind")
    p.add_argument("--family", choices=(*FAMILIES, *(o.name for o in OUTSIDE)), help="only this effect (with --kind)")
    p.add_argument("--uwb", type=int, choices=(1, 5, 10), help="UWB rate in Hz; drawn if not given")
    p.add_argument("--plant", choices=("own", "foreign"), default="own", help="structure of the true boat")
    p.add_argument("--seconds", type=float, help="length of the training logs; about 300 if not given")
    p.add_argument("--jobs", type=int, default=2, help="cases at once")
    p.add_argument("--timeout", type=float, default=300.0, help="seconds after which a case has failed")
    p.add_argument("--command", default=f"{shlex.quote(sys.executable)} -P -m companion diagnose", help="what to judge")
    p.add_argument("--keep", action="store_true", help="keep the logs of every case")
    return p


if __name__ == "__main__":
    sys.exit(main())
