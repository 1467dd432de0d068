"""Reading configuration: TOML text -> frozen, typed values; an unknown key is refused with its path.

The structs themselves live beside the idea they configure (`vessel_file`, `site`, ...); this module only
knows how to read one, how to say what is wrong, and how to name what was read (its hash).
"""

from __future__ import annotations

import hashlib
import math
import re
import tomllib
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, ClassVar, TypeVar

import msgspec

from companion.core.configuration.file_kinds import EXAMPLES, kind_of_tables
from companion.core.configuration.ranges import problems

T = TypeVar("T", bound=msgspec.Struct)
TYPES = {"float": "a number", "int": "a whole number", "str": "text", "bool": "true or false", "array": "a list",
         "object": "a table"}  # fmt: skip
"""What msgspec calls the types of a value, in TOML's words."""
TEXT = "utf-8-sig"
"""Encoding of files that people write: UTF-8, with or without the byte order mark of editors of Windows."""
Positive = Annotated[float, msgspec.Meta(gt=0)]
NonNegative = Annotated[float, msgspec.Meta(ge=0)]


class ConfigError(ValueError):
    """What is wrong, with file and key: `boats/aritra.toml: hull.mass_kgs: unknown key`."""


class Table(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of every configuration table: frozen, and a key it does not know is an error.

    `FILE`: what a whole file of it is called (`file_kinds`), to say so where another is given.
    """

    FILE: ClassVar[str | None] = None


class SourcedTable(Table, frozen=True, kw_only=True):
    """A table of physical numbers. `source` says where they come from, or that they are assumed."""

    source: str

    def __post_init__(self) -> None:
        if not self.source.strip():
            raise ValueError('needs a source: say where the numbers come from, or "assumed"')


def parse_toml(text: str, kind: type[T], *, name: str) -> T:
    """TOML text -> `kind`. `name` is the file's name for messages.

    Raises ConfigError naming file, key path and what was expected.
    """
    data = toml_of_text(text, name=name)
    refuse_other_kind(data, getattr(kind, "FILE", None), name=name)
    for path in _not_finite(data, ""):
        raise ConfigError(f"{name}: {path}: expected a finite number")
    for problem in problems(data, kind):
        raise ConfigError(f"{name}: {problem}")
    try:
        return msgspec.convert(data, kind)
    except msgspec.ValidationError as error:
        place, what = found_wrong(error)
        raise ConfigError(f"{name}: {place or '(top level)'}: {what}") from None


def toml_of_text(text: str, *, name: str) -> dict[str, Any]:
    """TOML document of a text. Raises ConfigError, also for what tomllib does not bear."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{name}: not valid TOML: {error}") from None
    except ValueError:  # Python reads no number of so many digits
        raise ConfigError(f"{name}: a number in it has thousands of digits") from None
    except RecursionError:
        raise ConfigError(f"{name}: tables or lists in it are nested too deep") from None


def refuse_other_kind(data: Mapping[str, object], wanted: str | None, *, name: str) -> None:
    """Raise ConfigError where a TOML document is certainly another kind of file than `wanted`."""
    found = kind_of_tables(data)
    if wanted and found not in (None, wanted):
        raise ConfigError(f"{name}: is {found}; expected {wanted}, for example {EXAMPLES[wanted]}")


def _not_finite(node: object, path: str) -> Iterator[str]:
    """Paths of the numbers that TOML allows but no quantity can be: nan, inf."""
    if isinstance(node, float) and not math.isfinite(node):
        yield path.removeprefix(".")
    elif isinstance(node, dict):
        for key, value in node.items():
            yield from _not_finite(value, f"{path}.{key}")
    elif isinstance(node, list):
        for i, value in enumerate(node):
            yield from _not_finite(value, f"{path}[{i}]")


def found_wrong(error: msgspec.ValidationError) -> tuple[str, str]:
    """(path, what is wrong with it) of a message of msgspec's, in TOML's words.

    >>> found_wrong(msgspec.ValidationError("Expected `float | null`, got `str` - at `$.hull.mass_kg`"))
    ('hull.mass_kg', 'expected a number, found text')
    >>> found_wrong(msgspec.ValidationError("Object contains unknown field `x` - at `$.hull`"))
    ('hull.x', 'unknown key')
    """
    what, _, where = str(error).partition(" - at ")
    path = where.strip("`").removeprefix("$").removeprefix(".")
    for phrase, says in (("unknown field `", "unknown key"), ("missing required field `", "missing key")):
        if phrase in what:
            key = what.split(phrase, 1)[1].split("`", 1)[0]
            return f"{path}.{key}" if path else key, says
    what = what.replace(", got ", ", found ").replace("of length >= ", "of at least ")
    return path, re.sub(r"`([^`]+)`", _type_in_words, what[:1].lower() + what[1:])


def _type_in_words(match: re.Match[str]) -> str:
    """`float | null` -> a number. Other words as they are: a choice of values, say."""
    kinds = [kind for kind in match[1].split(" | ") if kind != "null"]
    return " or ".join(dict.fromkeys(TYPES[kind] for kind in kinds)) if set(kinds) <= TYPES.keys() else match[0]


def digest(text: str) -> str:
    """Name of a configuration: the first 12 hex digits of the SHA-256 of its text."""
    return hashlib.sha256(text.encode()).hexdigest()[:12]
