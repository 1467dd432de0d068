"""`aritra vessel new`: five questions, and a first vessel file to identify from."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from companion.boat.load_run import EXAMPLES
from companion.cli.options.outputs import add_out, new_file
from companion.cli.options.values import number
from companion.core.configuration.tables import ConfigError
from companion.core.model.first_vessel import LAYOUTS, Answers, first_vessel
from companion.core.model.load_vessel import load_vessel
from companion.core.model.vessel_text import vessel_toml

DONE, BAD_INPUT = 0, 2
POSITIONS = ("uwb", "gnss")
EXAMPLE = "aritra vessel new --size 1.2 0.93 --mass 17 --layout differential --position gnss --out boat.toml"

length_m = number(0.1, 30.0, "a length [m]")
beam_m = number(0.02, 20.0, "a beam [m]")


def size(words: Sequence[str]) -> tuple[float, float]:
    """Length and beam [m]."""
    if len(words) != 2:
        raise argparse.ArgumentTypeError(f"{' '.join(words)!r}: expected two numbers, length and beam [m]")
    return length_m(words[0]), beam_m(words[1])


def mass(text: str) -> float | None:
    """A mass [kg], or None for "guess"."""
    return None if text == "guess" else number(0.1, 1e5, "a mass [kg], or `guess`")(text)


def thruster(text: str) -> float | None:
    """The most force of one thruster [N], or None for "t200"."""
    return None if text == "t200" else number(0.1, 50_000.0, "`t200`, or the most force of one thruster [N]")(text)


def one_of(names: Sequence[str]) -> Callable[[str], str]:
    """One of a few names."""

    def read(text: str) -> str:
        if text not in names:
            raise argparse.ArgumentTypeError(f"{text!r}: expected {', '.join(names)}")
        return text

    return read


@dataclass(frozen=True)
class Question:
    """What is asked, how an answer is read, and the answer that Enter gives."""

    key: str
    text: str
    read: Callable[[Any], Any]
    usual: str = ""


QUESTIONS = (
    Question("size", "Length and beam over all, in m (two numbers)", lambda text: size(text.split())),
    Question("mass", "Mass ready to drive, in kg, or `guess`", mass, "guess"),
    Question("layout", "Thrusters: differential (two astern), x (four at 45 degrees), bow (two astern, one across the "
             "bow)", one_of(LAYOUTS)),
    Question("thruster", "Thruster: `t200`, or the most force of one, in N", thruster, "t200"),
    Question("position", "Positions from: uwb or gnss", one_of(POSITIONS), "uwb"),
)  # fmt: skip


def add_parser(commands) -> None:
    """Add `vessel` and its subcommand to the command line."""
    about = (
        "Writes a vessel file from five answers, given as options or asked for where this is a terminal. What nobody "
        "can know from them comes from published formulas or is assumed, and says so in its `source`. It is a start "
        "for `aritra identify` and for the simulator, not a measured boat. Exit code 0: done; 2: bad input."
    )
    p = commands.add_parser("vessel", help="a first vessel file for your boat", description=about, example=EXAMPLE)
    kinds = p.add_subparsers(dest="kind", required=True, metavar="WHAT")
    n = kinds.add_parser("new", help="write a vessel file from five answers", description=about, example=EXAMPLE)
    n.add_argument(
        "--size", nargs=2, metavar=("LENGTH", "BEAM"), help="over all [m]; of a catamaran, across both hulls"
    )
    n.add_argument("--mass", metavar="KG", help="ready to drive; `guess`: from the size (default)")
    n.add_argument(
        "--layout", choices=LAYOUTS, help="thrusters: two astern, four at 45 degrees, two astern and a bow's"
    )
    n.add_argument("--thruster", metavar="T", help="`t200` (default), or the most force of one thruster [N]")
    n.add_argument("--position", choices=POSITIONS, help="sensor of positions (default: uwb)")
    n.add_argument("--name", help="the boat's name in logs (default: the file's)")
    add_out(n, "FILE", "vessel file (TOML) to write", required=True)
    n.set_defaults(function=new)


def new(args: argparse.Namespace, ask: Callable[[str], str] | None = None) -> int:
    """Ask what was not given, write the file, say what is next; the exit code. `ask`: for tests."""
    new_file(args.out)
    asking = ask or (input if sys.stdin.isatty() else None)
    try:
        said = [_answer(question, getattr(args, question.key), asking) for question in QUESTIONS]
    except EOFError:
        print("\naritra vessel: the answers ended before the questions; nothing was written", file=sys.stderr)
        return BAD_INPUT
    (length, beam), *others = said
    example = EXAMPLES / "boats" / "aritra.toml"
    t200 = load_vessel(example.read_text(encoding="utf-8"), name=example.name).force_maps["t200"]
    vessel = first_vessel(Answers(length, beam, *others), args.name or args.out.stem, t200)
    head = "A first vessel file by `aritra vessel new`: nobody has measured this boat. What is assumed says so."
    try:
        args.out.write_text(vessel_toml(vessel, head), encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{args.out}: {error.strerror}") from None
    _print_next(args.out, guessed=others[0] is None, example="aritra" if vessel.sensors.uwb else "lake")
    return DONE


def _answer(question: Question, given: Any, ask: Callable[[str], str] | None) -> Any:
    """The option's value, else what was asked, else the usual answer. Raises ConfigError."""
    if given is not None:
        try:
            return question.read(" ".join(given) if isinstance(given, list) else given)
        except argparse.ArgumentTypeError as error:
            raise ConfigError(f"--{question.key}: {error}") from None
    if ask is None:
        if not question.usual:
            raise ConfigError(f"--{question.key}: missing, and there is no terminal to ask at; example: {EXAMPLE}")
        return question.read(question.usual)
    while True:
        text = ask(f"{question.text}{f' [{question.usual}]' if question.usual else ''}: ").strip() or question.usual
        try:
            return question.read(text)
        except argparse.ArgumentTypeError as error:
            print(error)


def _print_next(out: Path, *, guessed: bool, example: str) -> None:
    print(f"wrote {out}")
    print(f"measure next:{' the mass,' * guessed} places of thrusters and sensors, which way each thruster pushes")
    print(f"then drive ten minutes by hand and: aritra identify LOG --vessel {shlex.quote(str(out))} --out DIR")
    print(f"to try it: cp -rn deploy/. my, in my/{example}.toml vessel = {json.dumps(str(out.resolve()))},")
    print(f"then aritra demo --config my/{example}.toml")
