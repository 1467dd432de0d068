"""Evidence for the command line: random lines in this process, the work of each command cut off; wrong uses, as run."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from tests.evidence.friendly.wrong_uses import WRONG_USES, make_files
from tests.evidence.line import Line, at_least, exactly, information
from tests.support.fuzzing.command_runs import fuzz_command_lines

LINES, SEED = 2000, 2
PATIENCE_S = 120.0


def command_lines(full: bool) -> Iterator[Line]:
    """Command line: 2,000 drawn from the real parsers, with wrong values, files of other kinds and typos (seed 2)"""
    with tempfile.TemporaryDirectory() as folder:
        out = fuzz_command_lines(LINES, SEED, Path(folder))
    for ended, count in sorted(out.ended.items()):
        yield information(f"lines that ended so: {ended}", count)
    yield at_least("lines that were run", sum(out.ended.values()), LINES)
    note = "; ".join(out.wrong)
    yield exactly("tracebacks, other exit codes, refusals that name nothing", len(out.wrong), 0, note=note)


def wrong_uses(full: bool) -> Iterator[Line]:
    """What people get wrong, each line as a program of its own: exit code 2, and an answer that helps"""
    with tempfile.TemporaryDirectory() as name:
        make_files(Path(name))
        bad = [
            f"{line}: {why}" for line, holds in WRONG_USES if (why := _unhelpful(line, holds.split("|"), Path(name)))
        ]
    yield at_least("wrong uses", len(WRONG_USES), 65)
    yield exactly("without exit code 2, or without file, key and what to do", len(bad), 0, note="; ".join(bad))


def _unhelpful(line: str, holds: list[str], folder: Path) -> str:
    """What the answer to a line lacks."""
    words = line.format(d=folder, boat=folder / "deploy/boats/aritra.toml").split()
    command = [sys.executable, "-P", "-m", "companion", *words]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    if done.returncode != 2:
        return f"exit code {done.returncode}"
    return ", ".join(f"no {text!r}" for text in holds if text not in done.stderr)


PARTS = (command_lines, wrong_uses)
