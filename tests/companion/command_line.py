"""The command line as tests call it: within this process, to its exit code."""

from __future__ import annotations

from companion.__main__ import main


def exit_code(*words: object) -> int:
    """Run `aritra WORDS`; its exit code, also where the parser ends it."""
    try:
        return main([str(word) for word in words])
    except SystemExit as end:
        assert isinstance(end.code, int)
        return end.code
