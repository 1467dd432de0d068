"""Machine code kept in a folder between runs: one file for each key, written atomically.

The folder is `$ARITRA_CACHE`, else systemd's `$CACHE_DIRECTORY`, else `$XDG_CACHE_HOME/aritra` or `~/.cache/aritra`.
Where it cannot be written nothing is kept, and the code is compiled at each start (a second or two). A file holds the
SHA-256 of the code and the code: a truncated or changed file is not run but replaced. New code is compiled in a child
process (`worker`), as the compiler would otherwise occupy 30 MB of the companion for as long as it runs.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

from companion.jit.checksummed import ChecksumError, checked, with_checksum
from companion.jit.worker import ChildFailed, compiled_in_child

MOST_FILES = 200
"""Files kept, some 50 kB each; the oldest are deleted. One boat needs a dozen; assumed enough for many boats."""


def cache_folder(environment: Mapping[str, str]) -> Path:
    """The folder, by the variables of the environment."""
    if named := environment.get("ARITRA_CACHE"):
        return Path(named)
    if folders := environment.get("CACHE_DIRECTORY"):
        return Path(folders.split(":")[0])
    home = environment.get("XDG_CACHE_HOME") or str(Path(environment.get("HOME", tempfile.gettempdir())) / ".cache")
    return Path(home) / "aritra"


class CodeStore:
    """Object code in a folder, by key. `make` compiles in a child process; where that fails `tell` gets the reason."""

    def __init__(
        self,
        folder: Path,
        make: Callable[[str], bytes] = compiled_in_child,
        tell: Callable[[str], None] = lambda _: None,
    ):
        self._folder, self._make, self._tell = folder, make, tell

    @classmethod
    def of(cls, environment: Mapping[str, str] = os.environ, tell: Callable[[str], None] = lambda _: None) -> CodeStore:
        """The store in the folder of `environment`."""
        return cls(cache_folder(environment), tell=tell)

    def get(self, key: str) -> bytes | None:
        """The code, or None where there is none or it is damaged."""
        try:
            return checked(self._path(key).read_bytes())
        except (OSError, ChecksumError):
            return None

    def put(self, key: str, code: bytes) -> None:
        """Store the code; nothing happens where the folder cannot be written."""
        with contextlib.suppress(OSError):
            self._folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            with tempfile.NamedTemporaryFile(dir=self._folder, delete=False) as file:
                file.write(with_checksum(code))
            os.replace(file.name, self._path(key))
            self._delete_oldest()

    def made(self, text: str) -> bytes | None:
        """Object code of a module's text, compiled in a child process; None where that failed."""
        try:
            return self._make(text)
        except ChildFailed as error:
            self._tell(f"machine code is compiled in this process, not in one of its own: {error}")
            return None

    def _path(self, key: str) -> Path:
        return self._folder / f"{key}.o"

    def _delete_oldest(self) -> None:
        files = sorted(self._folder.glob("*.o"), key=lambda f: f.stat().st_mtime)
        for file in files[:-MOST_FILES]:
            file.unlink(missing_ok=True)
