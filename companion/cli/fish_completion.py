"""Completion for fish: one line for each command, option and value, with their help."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from companion.cli.options.parser import Parser

SCRIPT = """# Completion of aritra {version} for fish: {use}
function __aritra_at
  set -l path ""
  for word in (commandline -opc)[2..]
    contains -- "$path $word" {paths}; and set path "$path $word"
  end
  test "$path" = "$argv[1]"
end
complete -c aritra -e
{lines}"""


def fish_script(found: Sequence[tuple[str, Parser]], version: str, use: str) -> str:
    """The script. `found`: every parser with the words that lead to it, as in " log plot"."""
    paths = " ".join(_quoted(path) for path, _ in found if path)
    lines = "\n".join(line for path, parser in found for line in _lines(path, parser))
    return SCRIPT.format(version=version, use=use, paths=paths, lines=lines)


def _lines(path: str, parser: Parser) -> Iterator[str]:
    at = f"complete -c aritra -n {_quoted(f'__aritra_at {_quoted(path)}')}"
    yield f"{at} -l help -s h -d 'show the help'"
    for name, one in parser.commands.items():
        yield f"{at} -f -a {name} -d {_quoted(_first(one.description))}"
    for action in parser.arguments:
        names = "".join(f" -{'l' if n.startswith('--') else 's'} {n.lstrip('-')}" for n in action.option_strings)
        values = " ".join(map(str, action.choices or ()))
        if names:
            takes = f" -x -a {_quoted(values)}" if values else " -r -F" if action.nargs is None else ""
            yield f"{at}{names}{takes} -d {_quoted(_first(action.help))}"
        elif values and not parser.commands:
            yield f"{at} -f -a {_quoted(values)}"


def _first(text: str | None) -> str:
    """The first sentence of a help text, in one line."""
    return " ".join((text or "").replace("%%", "%").split()).partition(". ")[0]


def _quoted(text: str) -> str:
    return "'" + text.replace("\\", "\\\\").replace("'", "\\'") + "'"
