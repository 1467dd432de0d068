"""The parser of every command: one sentence for what is wrong, "did you mean", an example at the end of the help."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from typing import Any, NoReturn

from companion.core.configuration.spelling import did_you_mean

BAD_INPUT = 2


class Parser(argparse.ArgumentParser):
    """An ArgumentParser that takes no abbreviations: one letter more or less must not be another option.

    `example`: a command line that works, for the end of the help; parsers of subcommands take it, too.
    """

    def __init__(self, *words: Any, example: str = "", **more: Any) -> None:
        super().__init__(*words, allow_abbrev=False, **more)
        self.example = example
        self._negative_number_matcher = re.compile(r"-(\d|\.\d|inf|nan)")  # argparse's own takes -1e-5 for an option

    @property
    def arguments(self) -> list[argparse.Action]:
        """All but the help and the subcommands."""
        left_out = argparse._HelpAction | argparse._SubParsersAction
        return [action for action in self._actions if not isinstance(action, left_out)]

    @property
    def commands(self) -> dict[str, Parser]:
        """Parsers of the subcommands by name."""
        found = (action for action in self._actions if isinstance(action, argparse._SubParsersAction))
        return {name: one for action in found for name, one in action.choices.items()}

    def format_help(self) -> str:
        """The help, with the example in a line of its own."""
        return super().format_help() + (f"\nexample:\n  {self.example}\n" if self.example else "")

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As usual, but what is unknown is an error of this very command."""
        words = [str(word) for word in args or ()]
        for word in self._own(words):
            name = word.partition("=")[0]
            if name not in self._option_string_actions:
                self.error(f"{name}: unknown option{did_you_mean(name, self._option_string_actions)}")
        found, rest = super().parse_known_args(args, namespace)
        if rest:
            self.error(f"{rest[0] or repr(rest[0])}: not expected here")
        return found, rest

    def error(self, message: str) -> NoReturn:
        """One sentence, and where to find help; exit code 2."""
        sentence = message.removeprefix("argument ")
        if unknown := re.search(r"invalid choice: (.*?) \(choose from (.*)\)$", sentence):
            shown = unknown[1] if unknown[1][:1] in ("'", '"') else repr(unknown[1])
            name, choices = shown.strip("'\""), re.findall(r"[\w.-]+", unknown[2])
            listed = f"; choose from {', '.join(choices)}"
            what = "command" + (did_you_mean(name, choices) or listed) if self._subparsers else "value" + listed
            before = "" if self._subparsers else sentence[: unknown.start()]
            sentence = f"{before}{shown}: unknown {what}"
        self.exit(BAD_INPUT, f"{self.prog}: {sentence}\nusage: {self.prog} --help\n")

    def _own(self, words: Sequence[str]) -> list[str]:
        """Long options among words that are this parser's: up to a subcommand, or up to `--`."""
        own = []
        for word in words:
            if word == "--" or (self._subparsers and not word.startswith("-")):
                break
            own += [word] if word.startswith("--") else []
        return own
