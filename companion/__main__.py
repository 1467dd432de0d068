"""`aritra`: the command line. Parses, calls, prints; exit codes: 0 done, 1 failed, 2 bad input, 130 interrupted."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterable, Sequence
from importlib import import_module
from importlib.metadata import version

from companion.cli.interrupts import ended_as_by_ctrl_c
from companion.cli.options.parser import BAD_INPUT, Parser
from companion.core.configuration.tables import ConfigError

INTERRUPTED = 130
PIPE_CLOSED = 141
"""As shells report a program that SIGPIPE ended: 128 + 13."""
COMMANDS = {
    "demo": "simulator.demo", "check": "boat.check", "provision": "boat.provision", "run": "boat.run",
    "teleop": "boat.teleop", "shore": "shore.console", "stop": "shore.stop", "sim": "simulator.sim",
    "replay": "boat.replay", "log": "log", "vessel": "vessel", "identify": "identify", "diagnose": "diagnose",
    "campaign": "campaign", "excite": "excite", "commission": "commission", "watch": "watch", "bench": "bench",
    "completion": "completion",
}  # fmt: skip
"""By name: its module in `companion.cli`, which is loaded for that command only: some bring slow libraries."""


def parser(names: Iterable[str] = COMMANDS) -> Parser:
    """The command line with these commands; without arguments the whole of it."""
    top = Parser(
        prog="aritra",
        description="Companion computer of a small surface vessel: estimation, guidance, NMPC; and its simulator.",
        epilog="No boat at hand? `aritra demo` drives a mission in the simulator.",
        example="aritra demo",
    )
    top.add_argument("--version", action="version", version=f"aritra {version('aritra')}")
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name in names:
        import_module(f"companion.cli.{COMMANDS[name]}").add_parser(commands)
    return top


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # what the terminal's language does not know is shown as "?"
    words = sys.argv[1:] if argv is None else argv
    asked = COMMANDS.keys() & words[:1]
    args = parser(asked or COMMANDS).parse_args(words)
    try:
        with ended_as_by_ctrl_c():
            code = args.function(args)
            sys.stdout.flush()  # here, where it can be said what came of it
            return code
    except ConfigError as error:
        print(f"aritra {args.command}: {error}", file=sys.stderr)
        return BAD_INPUT
    except BrokenPipeError:
        if not _reader_is_gone():
            raise
        return PIPE_CLOSED
    except KeyboardInterrupt:
        return INTERRUPTED


def _reader_is_gone() -> bool:
    """Whether who reads our output has read enough, as `head` does. What is left to print goes nowhere then."""
    try:
        print(flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return True
    return False


if __name__ == "__main__":
    sys.exit(main())
