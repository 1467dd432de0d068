"""`aritra completion bash|zsh|fish`: commands, options and values of this version, as a script for the shell.

The script holds all words, so that a TAB starts no Python and the start of a command costs nothing.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator

from companion.cli.fish_completion import fish_script
from companion.cli.options.parser import Parser

USE = {
    "bash": "source <(aritra completion bash)  # for every shell: put this line into ~/.bashrc",
    "zsh": "source <(aritra completion zsh)  # for every shell: put this line into ~/.zshrc, after compinit",
    "fish": "aritra completion fish > ~/.config/fish/completions/aritra.fish",
}
ZSH = """autoload -Uz compinit bashcompinit
(( $+functions[compdef] )) || compinit
bashcompinit
"""
"""zsh's own way to take completions of bash."""
SCRIPT = """# Completion of aritra {version} for {shell}: {use}
{before}_aritra() {{
  local word=${{COMP_WORDS[COMP_CWORD]}} last=${{COMP_WORDS[COMP_CWORD-1]}} at= few= i
  for ((i = 1; i < COMP_CWORD; i++)); do
    case "$at ${{COMP_WORDS[i]}}" in
{paths}) at="$at ${{COMP_WORDS[i]}}" ;;
    esac
  done
  case "$at:$last" in
{values}
  esac
  if [[ -z $few ]]; then
    case "$at:$word" in
{words}
    esac
  fi
  COMPREPLY=($(compgen -W "$few" -- "$word"))
}}
complete -o default -F _aritra aritra"""


def add_parser(commands) -> None:
    """Add `completion` to the command line."""
    p = commands.add_parser(
        "completion",
        help="completion of commands and options with TAB, for bash, zsh and fish",
        description="Prints a script for the shell, with how to use it. Exit code 0: done; 2: bad input.",
        example="aritra completion bash > ~/.local/share/bash-completion/completions/aritra",
    )
    p.add_argument("shell", choices=tuple(USE), help="the shell")
    p.set_defaults(function=completion)


def completion(args: argparse.Namespace) -> int:
    """Print the script; the exit code."""
    from importlib.metadata import version

    from companion.__main__ import parser

    found, use = list(_parsers(parser(), "")), USE[args.shell]
    if args.shell == "fish":
        print(fish_script(found, version("aritra"), use))
        return 0
    paths = "|".join(f'"{path}"' for path, _ in found if path)
    values = [line for path, one in found for line in _values(path, one)]
    words = [line for path, one in found for line in _words(path, one)]
    before = ZSH if args.shell == "zsh" else ""
    text = SCRIPT.format(
        version=version("aritra"), shell=args.shell, use=use, before=before, paths=f"      {paths}",
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
                yield f'{names}) few="{" ".join(map(str, action.choices))}" ;;'
            elif action.nargs is None:
                yield f"{names}) return ;;"


def _words(path: str, parser: Parser) -> Iterator[str]:
    """What may stand at a place: options where it begins with a dash; else commands, or one of a few values."""
    options = [name for action in parser.arguments for name in action.option_strings]
    yield f'"{path}:-"*) few="{" ".join(["--help", *options])}" ;;'
    few = [str(name) for a in parser.arguments if not a.option_strings for name in a.choices or ()]
    if others := " ".join([*parser.commands, *few]):
        yield f'"{path}:"*) few="{others}" ;;'
