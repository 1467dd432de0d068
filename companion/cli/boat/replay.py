"""`aritra replay LOG`: does the core still do what it did?"""

from __future__ import annotations

import argparse
import sys
from collections import deque

from companion.cli.options.files import aritra_log
from companion.core.pilot.pilot import Pilot
from companion.logs.configuration import setup_in
from companion.logs.log_file import LogError, LogFile
from companion.logs.replay import replay as repeat


def add_parser(commands) -> None:
    """Add `replay` to the command line."""
    p = commands.add_parser(
        "replay",
        help="repeat a log's inputs and compare what the core makes of them",
        description="Feeds the logged inputs to the core and reports the first difference. "
        "Exit code 0: none; 1: one; 2: the log cannot be read, or lacks messages before its first difference.",
        example="aritra replay out/demo/run.mcap",
    )
    p.add_argument("log", type=aritra_log, metavar="LOG", help="log of `aritra run` (NAME.mcap)")
    p.set_defaults(function=replay)


def replay(args: argparse.Namespace) -> int:
    """Repeat one log; the exit code."""
    try:
        log = LogFile(args.log)
        messages = log.messages()
        report = repeat(Pilot(setup_in(log).pilot), messages)
        read = log.read
        deque(messages, maxlen=0)  # the rest: only then is all damage known, and which numbers are missing
        if not report.steps:
            missing = "without /step_mark nobody knows which inputs were one call, so it cannot be repeated"
            raise LogError(f"{log.path}: holds no step of the core: {missing}")
    except LogError as error:
        print(f"aritra replay: {error}", file=sys.stderr)
        return 2
    for damage in log.damage:
        print(f"damaged: {damage}", file=sys.stderr)
    print(f"{report.steps} steps, {report.inputs} inputs, {report.outputs} outputs repeated")
    if report.difference is None:
        print("no difference")
        return 0
    d = report.difference
    print(f"first difference in step {d.step}, {d.t_ns} ns:\n  logged   {d.logged}\n  replayed {d.replayed}")
    if log.lacks_after is not None and log.lacks_after < read:
        lacking = "lacks messages before this difference, which therefore says nothing of the core"
        print(f"aritra replay: {log.path}: {lacking}; `aritra log info` shows what is missing", file=sys.stderr)
        return 2
    return 1
