"""Evidence for the command line: random lines in this process, the work of each command cut off."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

from tests.evidence.line import Line, at_least, exactly, information
from tests.support.fuzzing.command_runs import fuzz_command_lines

LINES, SEED = 2000, 2


def command_lines(full: bool) -> Iterator[Line]:
    """Command line: 2,000 drawn from the real parsers, with wrong values, files of other kinds and typos (seed 2)"""
    with tempfile.TemporaryDirectory() as folder:
        out = fuzz_command_lines(LINES, SEED, Path(folder))
    for ended, count in sorted(out.ended.items()):
        yield information(f"lines that ended so: {ended}", count)
    yield at_least("lines that were run", sum(out.ended.values()), LINES)
    note = "; ".join(out.wrong)
    yield exactly("tracebacks, other exit codes, refusals that name nothing", len(out.wrong), 0, note=note)


PARTS = (command_lines,)
