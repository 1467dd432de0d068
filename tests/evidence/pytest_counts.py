"""What a run of pytest said at its end."""

from __future__ import annotations

import re
from collections import Counter


def counts(said: str) -> Counter[str]:
    """How many tests passed, failed, were skipped or had an error, over all runs in a text."""
    found: Counter[str] = Counter()
    for number, word in re.findall(r"\b(\d+) (passed|failed|skipped|error)", said):
        found[word] += int(number)
    return found


def failures(said: str) -> list[str]:
    """Names of the tests that failed or had an error."""
    return re.findall(r"^(?:FAILED|ERROR) (\S+)", said, flags=re.M)
