"""Random command lines, drawn from the real parsers: commands, options, values that fit or do not, typos.

Files are those of `command_files`; what is written goes to names that are new, or that are taken.
"""

from __future__ import annotations

import argparse
import random
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from companion.cli.options import files, outputs
from companion.cli.options.parser import Parser

There = Mapping[str, Sequence[Path]]
Command = tuple[tuple[str, ...], Parser]
NUMBERS = ("0", "1", "2", "5", "0.1", "0.5", "10", "88", "8470")
NO_NUMBERS = ("-1", "nan", "inf", "-inf", "1e400", "-1e-9", "1e9", "0x10", "", "three", "1_0", "９", "9" * 5000,
              "1,5", "99999", "-0.0", "+1", "1 2")  # fmt: skip
WORDS = ("gate", "aritra", "a,b", "3", "0", "-", "--", "a=b", "=", "../x", "~", "\x1b[31m", "ü" * 40, "x" * 5000,
         "$(id)", "tcp/127.0.0.1:0", "tcp/127.0.0.1:x", "udpin:127.0.0.1:14551", "serial:/dev/null:115200",
         "pigeon:roof", "127.0.0.1:9002", "FS_ACTION=2", "/tmp", "%s", "{}", "[bold]", "localhost", "solvers",
         "x" * 300 + "/a.png",          "[/]", "ID")  # fmt: skip
_KINDS = {files.run_file: "run", files.vessel_file: "vessel", files.site_file: "site", files.mission_file: "mission",
          files.excitation_file: "excitation", files.campaign_file: "campaign", files.any_log: "log",
          files.aritra_log: "log", files.truth_log: "truth", files.log_beside: "log",
          outputs.output: "new", outputs.picture: "new"}  # fmt: skip


def commands(parser: Parser, before: tuple[str, ...] = ()) -> Iterator[Command]:
    """Every command that has no subcommands, with its parser."""
    for name, one in parser.commands.items():
        yield from commands(one, (*before, name))
    if not parser.commands:
        yield before, parser


def command_line(dice: random.Random, all_of: Sequence[Command], there: There) -> list[str]:
    """One command line. `there`: paths by kind; "new" ones do not exist, "odd" ones are of no kind that is wanted."""
    names, parser = dice.choice(all_of)
    words, places = list(names), list[list[str]]()
    good = dice.choice((1.0, 1.0, 0.9, 0.7))
    for action in parser.arguments:
        needed = action.required or not action.option_strings
        if dice.random() < (0.97 if needed else 0.15):
            option = [dice.choice(action.option_strings)] if action.option_strings else []
            places.append(option + _values(dice, action, there, good))
    dice.shuffle(places)
    words += [word for place in places for word in place]
    for _ in range(dice.choice((0, 0, 0, 0, 1, 2))):
        _spoil(dice, words)
    return words


def _values(dice: random.Random, action: argparse.Action, there: There, good: float) -> list[str]:
    if action.nargs == 0 or (action.nargs == "?" and dice.random() < 0.5):
        return []
    many = action.nargs if isinstance(action.nargs, int) else 1
    return [_value(dice, action, there, good) for _ in range(many if dice.random() < 0.98 else many + 1)]


def _value(dice: random.Random, action: argparse.Action, there: There, good: float) -> str:
    fits = dice.random() < good
    if action.choices:
        return str(dice.choice([*action.choices])) if fits else dice.choice(WORDS)
    if action.type in _KINDS:
        if not fits and dice.random() < 0.2:
            return dice.choice(WORDS)
        return str(dice.choice(there[_KINDS[action.type] if fits else dice.choice([*there])]))
    if action.type or action.nargs:
        return dice.choice(NUMBERS) if fits else dice.choice((*NO_NUMBERS, *WORDS))
    return dice.choice(WORDS)


def _spoil(dice: random.Random, words: list[str]) -> None:
    """Leave out, double, swap, misspell or put in a word."""
    at = dice.randrange(len(words))
    word, how = words[at], dice.randrange(6)
    if how == 0:
        del words[at : at + 1 if len(words) > 1 else at]
    elif how == 1:
        words.insert(at, word)
    elif how == 2:
        other = dice.randrange(len(words))
        words[at], words[other] = words[other], word
    elif how == 3:
        words.insert(at, dice.choice((*WORDS, *NO_NUMBERS, "--help", "-h", "--version", "-o", "--out", "--no")))
    elif word:
        i = dice.randrange(len(word))
        words[at] = word[:i] + dice.choice(("", word[i] * 2, "x", "-")) + word[i + 1 :]
