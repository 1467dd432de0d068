"""`watch` of `aritra commission` as a command line of its own, with this module as the program."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from companion.cli.commission_watch import add_watch_parser
from companion.cli.options.parser import Parser


def watch_parser() -> Parser:
    """A command line whose only subcommand is `watch`."""
    top = Parser(prog="aritra commission")
    add_watch_parser(top.add_subparsers(dest="kind", required=True, metavar="WHAT"))
    return top


def run(words: Sequence[str]) -> int:
    """Parse and run; the exit code, also where the parser ends it."""
    try:
        args = watch_parser().parse_args(list(words))
        return args.function(args)
    except SystemExit as end:
        assert isinstance(end.code, int)
        return end.code


if __name__ == "__main__":
    sys.exit(run(sys.argv[1:]))
