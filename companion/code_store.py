"""Machine code kept in a folder between runs: one file for each key, written whole or not at all.

The folder is `$ARITRA_CACHE`, else systemd's `$CACHE_DIRECTORY`, else `$XDG_CACHE_HOME/aritra` or `~/.cache/aritra`.
Where it cannot be written nothing is kept, and the code is made anew at each start (a second or two). A file holds the
code behind its SHA-256: one that was cut short or changed is not run but replaced.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

DIGEST = hashlib.sha256().digest_size
KEPT = 40
"""Files kept; the oldest go first. One boat needs one; assumed enough for a desk with many."""


def cache_folder(environment: Mapping[str, str]) -> Path:
    """Where to keep it, by the environment's variables."""
    if named := environment.get("ARITRA_CACHE"):
        return Path(named)
    if given := environment.get("CACHE_DIRECTORY"):
        return Path(given.split(":")[0])
    home = environment.get("XDG_CACHE_HOME") or str(Path(environment.get("HOME", tempfile.gettempdir())) / ".cache")
    return Path(home) / "aritra"


class CodeStore:
    """A `compiled.Store` in a folder."""

    def __init__(self, folder: Path):
        self._folder = folder

    @classmethod
    def of(cls, environment: Mapping[str, str] = os.environ) -> CodeStore:
        """The store that the environment names."""
        return cls(cache_folder(environment))

    def get(self, key: str) -> bytes | None:
        """The code, or None where there is none or it is damaged."""
        try:
            data = self._path(key).read_bytes()
        except OSError:
            return None
        code = data[DIGEST:]
        return code if hashlib.sha256(code).digest() == data[:DIGEST] else None

    def put(self, key: str, code: bytes) -> None:
        """Keep it where the folder can be written."""
        with contextlib.suppress(OSError):
            self._folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            with tempfile.NamedTemporaryFile(dir=self._folder, delete=False) as file:
                file.write(hashlib.sha256(code).digest() + code)
            os.replace(file.name, self._path(key))
            self._forget_the_oldest()

    def _path(self, key: str) -> Path:
        return self._folder / f"{key}.o"

    def _forget_the_oldest(self) -> None:
        files = sorted(self._folder.glob("*.o"), key=lambda f: f.stat().st_mtime)
        for file in files[:-KEPT]:
            file.unlink(missing_ok=True)
