"""Random command lines within this process: all parsing, loading and checking runs, the work itself is cut off.

A line passes where it ends in an exit code that docs/README know, or reaches its work. What is wrong is kept by kind.
"""

from __future__ import annotations

import contextlib
import io
import os
import random
import re
import shutil
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from unittest.mock import patch

from companion.__main__ import parser
from companion.boat.load_run import EXAMPLES
from companion.core.messages import GroundTruth
from tests.companion.command_line import exit_code
from tests.companion.logs.page.page_logs import page_log
from tests.companion.logs.readers.run_logs import record, simulated
from tests.support.fuzzing.command_lines import command_line, commands
from tests.support.fuzzing.fuzz import kind_of

CODES = (0, 1, 2, 130)
WORK = (
    "companion.cli.simulator.demo.drive", "companion.cli.simulator.sim._serve", "companion.cli.boat.run._drive",
    "companion.cli.boat.check._look", "companion.cli.boat.provisioning._work", "companion.cli.campaign._runner",
    "companion.cli.commission._carried_out", "sim.commission.watch.job.watch",
    "aiohttp.web.AppRunner", "companion.cli.shore.console._foxglove", "companion.shore.stop_boats.stop_boats",
    "sim.bench.run.run",
    "sim.fitting.identify.job.identify", "sim.fitting.diagnose.job.diagnose", "sim.fitting.excite.design.candidates",
    "sim.fitting.excite.nominal.fly_nominal", "sim.fitting.excite.fly.fly",
    "sim.fitting.excite.information.recorded_knowledge", "companion.logs.export.plot.plot",
    "companion.logs.export.figure.figure", "companion.logs.page.view.samples", "webbrowser.open",
)  # fmt: skip
"""Where each command begins what takes long, drives, draws or listens."""
WORDLESS = ("needs a terminal", "the following arguments are required")
"""Refusals that have no option or file to name."""


class WorkBeginsError(BaseException):
    """The command line was accepted. No Exception: nobody may catch it."""


@dataclass
class Lines:
    """Lines by how they ended, and first examples of what no line may do, by kind."""

    ended: Counter[str] = field(default_factory=Counter)
    wrong: dict[str, list[str]] = field(default_factory=dict)


def fuzz_command_lines(count: int, seed: int, folder: Path) -> Lines:
    """Run `count` lines drawn from `seed` in `folder`, which is empty."""
    there, dice, out = command_files(folder), random.Random(f"command lines {seed}"), Lines()
    every = list(commands(parser()))
    with contextlib.chdir(folder), _work_cut_off():
        for _ in range(count):
            words = command_line(dice, every, there)
            _run(words, out)
            for path in there["new"]:
                shutil.rmtree(path, ignore_errors=True) if path.is_dir() else path.unlink(missing_ok=True)
    return out


def _run(words: list[str], out: Lines) -> None:
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
            code = exit_code(*words)
    except WorkBeginsError:
        out.ended["work begins"] += 1
        return
    except BaseException as error:
        out.wrong.setdefault(kind_of(error), words)
        return
    out.ended[f"exit code {code}"] += 1
    if code not in CODES:
        out.wrong.setdefault(f"exit code {code!r}", words)
    elif code == 2 and (problem := _unclear(said.getvalue(), words)):
        out.wrong.setdefault(f"{problem}: {said.getvalue()[:300]}", words)


def _unclear(said: str, words: list[str]) -> str:
    """What a refusal lacks: one sentence that names the option, the file or the word that is wrong."""
    first = said.partition("\n")[0]
    if not re.match(r"aritra[a-z ]*: ", first):
        return "no sentence"
    if "Traceback" in said:
        return "a traceback"
    named = re.search(r" -+[a-z]", first) or re.search(r"\b[A-Z]{3,}\b", first)
    told = any((word and word in first) or repr(word) in first for word in [*words[1:], *map(_as_path, words[1:])])
    known = any(text in first for text in WORDLESS) or "unknown command" in first
    return "" if named or told or known else "nothing is named"


def _as_path(word: str) -> str:
    """As a program writes a path back: `a//b` is a/b."""
    return str(Path(word)) if "/" in word else word


@contextlib.contextmanager
def _work_cut_off() -> Iterator[None]:
    def begins(*_: object, **__: object) -> None:
        raise WorkBeginsError

    with contextlib.ExitStack() as held:
        for path in WORK:
            module, _, name = path.rpartition(".")
            held.enter_context(patch.object(import_module(module), name, begins))
        yield


def command_files(folder: Path) -> Mapping[str, list[Path]]:
    """Make files of every kind in `folder`; paths by kind."""
    ours = folder / "deploy"
    shutil.copytree(EXAMPLES, ours, ignore=shutil.ignore_patterns("__pycache__", "*.py"))
    log = page_log(folder)
    truth = record(folder / "truth.mcap", [m for m in simulated() if isinstance(m, GroundTruth)])
    odd = {
        "empty": b"", "noise.bin": random.Random(0).randbytes(999), "broken.toml": b"format = [",
        "key": bytes(range(32)), "cut.mcap": log.read_bytes()[:-60_000], "picture.png": b"\x89PNG\r\n\x1a\n",
        "short.csv": b"t_s,psi_rad\n0,1\n",
        "table.parquet": b"PAR1" + bytes(40), "unknown.xyz": b"words", "latin.toml": "name = 'ü'".encode("latin-1"),
        "x.tlog": bytes(8) + b"\xfd" + bytes(40), "page.html": b"<!doctype html>", "list.json": b"[1]",
        "one.py": b"1/0",
        "next.toml": b"format = 1\nname = 'a'\nsegmentz = []\n", "deep.toml": b"a = " + b"[" * 200 + b"]" * 200,
    }  # fmt: skip
    for name, content in odd.items():
        (folder / name).write_bytes(content)
    os.mkfifo(folder / "pipe")
    (folder / "gone").symlink_to(folder / "nowhere")
    folders = [folder / "taken", folder]
    (folder / "taken").mkdir()
    (folder / "taken" / "run.mcap").write_bytes(b"mine")
    names = ("new", "new.csv", "new.png", "new.pdf", "new.html", "new.mcap", "new.toml", "new.geojson", "new.parquet")
    return {
        "run": [ours / "aritra.toml"], "vessel": sorted((ours / "boats").iterdir()),
        "site": [ours / "sites/basin.toml"], "mission": sorted((ours / "missions").iterdir()),
        "excitation": [ours / "excitations/library.toml"],
        "campaign": sorted((ours / "campaigns").iterdir()), "log": [log], "truth": [truth],
        "odd": [*(folder / name for name in odd), folder / "pipe", folder / "gone", *folders, folder / "no/such/file"],
        "new": [folder / name for name in names],
    }  # fmt: skip
