"""Machine code made in a short-lived child process, so that the companion does not keep the compiler's memory.

The child reads a module's text on standard input and writes the SHA-256 of the object code and the code. Its time is
bounded; where it fails, hangs or answers damaged data, `ChildFailed` is raised, and the caller compiles by itself.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence

from companion.jit.checksummed import ChecksumError, checked, with_checksum
from companion.python_child import python

LIMIT_S = 30.0
"""Time of the child, at most: twenty times that on a desktop; assumed enough for a small board at start."""
COMMAND = tuple(python("-c", "from companion.jit.worker import main; main()"))


class ChildFailed(Exception):
    """The child made no code; the text says why."""


def compiled_in_child(text: str, command: Sequence[str] = COMMAND, limit_s: float = LIMIT_S) -> bytes:
    """Object code of a module's text for this processor. Raises ChildFailed after `limit_s` at the latest."""
    try:
        done = subprocess.run(command, input=text.encode(), capture_output=True, timeout=limit_s, check=False)
    except subprocess.TimeoutExpired:
        raise ChildFailed(f"no answer within {limit_s:g} s") from None
    except OSError as error:
        raise ChildFailed(str(error)) from None
    if done.returncode:
        errors = done.stderr.decode(errors="replace").strip().splitlines()
        raise ChildFailed(f"exit code {done.returncode}{': ' + errors[-1] if errors else ''}")
    try:
        return checked(done.stdout)
    except ChecksumError:
        raise ChildFailed(f"answered {len(done.stdout)} bytes that are no object code") from None


def main() -> None:
    """The child: text in, checksum and code out."""
    from companion.jit.machine import object_code  # noqa: PLC0415 - the parent has no use for it here

    code = object_code(sys.stdin.buffer.read().decode())
    sys.stdout.buffer.write(with_checksum(code))
