"""`aritra completion bash`: commands, options and values of this version, as a script for the shell.

The script holds all words, so that a TAB starts no Python and the start of a command costs nothing.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator

from companion.cli.options.parser import Parser

USE = "source <(aritra completion bash)  # for every shell: put this line into ~/.bashrc"
SCRIPT = """# Completion of aritra {version} for bash: {use}
_aritra() {{
  local word=${{COMP_WORDS[COMP_CWORD]}} last=${{COMP_WORDS[COMP_CWORD-1]}} path= words= i
  for ((i = 1; i < COMP_CWORD; i++)); do
    case "$path ${{COMP_WORDS[i]}}" in
{paths}) path="$path ${{COMP_WORDS[i]}}" ;;
    esac
  done
  case "$path:$last" in
{values}
  esac
  if [[ -z $words ]]; then
    case "$path:$word" in
{words}
    esac
  fi
  COMPREPLY=($(compgen -W "$words" -- "$word"))
}}
complete -o default -F _aritra aritra"""


def add_parser(commands) -> None:
    """Add `completion` to the command line."""
    p = commands.add_parser(
        "completion",
        help="completion of commands and options with TAB, for bash",
        description=f"Prints a script for the shell. {USE}. Exit code 0: done; 2: bad input.",
        example="aritra completion bash > ~/.local/share/bash-completion/completions/aritra",
    )
    p.add_argument("shell", choices=("bash",), help="the shell")
    p.set_defaults(function=completion)


def completion(args: argparse.Namespace) -> int:
    """Print the script; the exit code."""
    from importlib.metadata import version

    from companion.__main__ import parser

    found = list(_parsers(parser(), ""))
    paths = "|".join(f'"{path}"' for path, _ in found if path)
    values = [line for path, one in found for line in _values(path, one)]
    words = [line for path, one in found for line in _words(path, one)]
    text = SCRIPT.format(
        version=version("aritra"), use=USE, paths=f"      {paths}",
        values="\n".join(f"    {line}" for line in values), words="\n".join(f"      {line}" for line in words),
    )  # fmt: skip
    sys.stdout.write(text + "\n")
    return 0


def _parsers(parser: Parser, path: str) -> Iterator[tuple[str, Parser]]:
    """Every parser with the words that lead to it: "", " log", " log plot"."""
    yield path, parser
    for name, one in parser.commands.items():
        yield from _parsers(one, f"{path} {name}")


def _values(path: str, parser: Parser) -> Iterator[str]:
    """Values of an option that takes one of a few; of any other that takes a value bash completes file names."""
    for action in parser.arguments:
        if action.option_strings and action.nargs in (None, 1, "?"):
            names = "|".join(f'"{path}:{name}"' for name in action.option_strings)
            if action.choices:
                yield f'{names}) words="{" ".join(map(str, action.choices))}" ;;'
            elif action.nargs is None:
                yield f"{names}) return ;;"


def _words(path: str, parser: Parser) -> Iterator[str]:
    """What may stand at a place: options where it begins with a dash; else commands, or one of a few values."""
    options = [name for action in parser.arguments for name in action.option_strings]
    yield f'"{path}:-"*) words="{" ".join(["--help", *options])}" ;;'
    few = [str(name) for a in parser.arguments if not a.option_strings for name in a.choices or ()]
    if others := " ".join([*parser.commands, *few]):
        yield f'"{path}:"*) words="{others}" ;;'
