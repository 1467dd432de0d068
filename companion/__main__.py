"""`aritra`: the command line. Parses, calls, prints; exit codes: 0 done, 1 failed, 2 bad input, 130 interrupted."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib.metadata import version

from companion import log_cli
from companion.commands import check, demo, diagnose, excite, identify, provision, replay, run, shore, sim, teleop
from companion.core.config import ConfigError

BAD_INPUT = 2
INTERRUPTED = 130


def parser() -> argparse.ArgumentParser:
    """The whole command line."""
    top = argparse.ArgumentParser(
        prog="aritra",
        description="Companion computer of a small surface vessel: estimation, guidance, NMPC; and its simulator.",
        epilog="No boat at hand? `aritra demo` drives a mission in the simulator.",
    )
    top.add_argument("--version", action="version", version=f"aritra {version('aritra')}")
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for module in (demo, check, provision, run, teleop, shore, sim, replay, log_cli, identify, diagnose, excite):
        module.add_parser(commands)
    return top


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    args = parser().parse_args(argv)
    try:
        return args.function(args)
    except ConfigError as error:
        print(f"aritra {args.command}: {error}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        return INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
