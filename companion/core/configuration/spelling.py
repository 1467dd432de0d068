"""What a word that is not known may have meant."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

LIKE = 0.6
"""How alike two words must be, as a share (difflib's own default)."""
SHORTEST = 4
"""A beginning must be so long to stand for a longer word; assumed."""


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """`; did you mean WORD?`, or nothing where no known word is like it.

    >>> did_you_mean("mass_kgs", ["mass_kg", "beam_m"]), did_you_mean("sail", ["mass_kg"])
    ('; did you mean mass_kg?', '')
    """
    names = list(known)
    longer = [name for name in names if len(word) >= SHORTEST and name.startswith(word)]
    close = longer[:1] or get_close_matches(word, names, n=1, cutoff=LIKE)
    return f"; did you mean {close[0]}?" if close else ""
