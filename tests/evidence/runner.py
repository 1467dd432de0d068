"""Recompute every figure of a "Must show" list: prints figure, goal, and holds or falls short.

    scripts/evidence NAME [--full] [--only WORD]

A NAME is a folder beside this file whose `parts.py` has `PARTS`: functions of `full` that yield lines. Exit code: 0 all
lines hold; 1 a line falls short or a part yields no line; 2 no such part. Reads no stored result.
"""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from tests.evidence.line import Line

Part = Callable[[bool], Iterator[Line]]
NAMES = {path.parent.name.replace("_", "-"): path.parent.name for path in Path(__file__).parent.glob("*/parts.py")}
"""Name on the command line -> folder."""


def parts_of(name: str) -> tuple[Part, ...]:
    """All parts of one list of evidence."""
    return importlib.import_module(f"tests.evidence.{NAMES[name]}.parts").PARTS


def run(parts: Sequence[Part], full: bool) -> int:
    """Print every line of `parts`; the number of lines that fall short, a part without any line being one of them."""
    short = 0
    for part in parts:
        print(f"\n{(part.__doc__ or part.__name__).strip()}", flush=True)
        count = 0
        for line in part(full):
            count += 1
            short += not line.holds
            print(line, flush=True)
        if count == 0:
            short += 1
            print(f"  ERROR: part {part.__name__} yields no line", flush=True)
    return short


def main(words: Sequence[str] | None = None) -> int:
    """Run the parts that the command line asks for; the exit code."""
    parser = argparse.ArgumentParser(prog="scripts/evidence", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("name", choices=sorted(NAMES))
    parser.add_argument("--full", action="store_true", help="also the lines that take over ten minutes")
    parser.add_argument("--only", default="", metavar="WORD", help="only the parts whose name contains WORD")
    args = parser.parse_args(words)
    parts = parts_of(args.name)
    chosen = [part for part in parts if args.only in part.__name__]
    if not chosen:
        known = ", ".join(part.__name__ for part in parts)
        parser.error(f"no part of {args.name} has {args.only!r} in its name; there are: {known or 'none'}")
    short = run(chosen, args.full)
    print(f"\n{short} lines fall short" if short else "\nall lines hold")
    return 1 if short else 0
