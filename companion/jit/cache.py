"""Machine code kept in a folder between runs: one file for each key, written atomically.

The folder is `$ARITRA_CACHE`, else systemd's `$CACHE_DIRECTORY`, else `$XDG_CACHE_HOME/aritra` or `.cache/aritra` in
the home of `$HOME` or, without it, of the user database: never a folder that all share. It and its files must be this
user's alone (`private_folder`): where they are not, nothing of them is run, and it is said. Where the folder cannot be
written nothing is kept, and the code is compiled at each start (a second or two). A file holds the SHA-256 of the code
and the code: a truncated or changed file is not run but replaced. New code is compiled in a child process (`worker`),
as the compiler would otherwise occupy 30 MB of the companion for as long as it runs.
"""

from __future__ import annotations

import os
import pwd
from collections.abc import Callable, Mapping
from pathlib import Path

from companion.jit.checksummed import ChecksumError, checked, with_checksum
from companion.jit.private_folder import NotPrivate, PrivateFolder
from companion.jit.worker import ChildFailed, compiled_in_child

MOST_FILES = 200
"""Files kept, some 50 kB each; the oldest are deleted. One boat needs a dozen; assumed enough for many boats."""


def cache_folder(environment: Mapping[str, str]) -> Path | None:
    """The folder, by the variables of the environment; None: a user without a home, for whom nothing is kept."""
    if named := environment.get("ARITRA_CACHE"):
        return Path(named)
    if folders := environment.get("CACHE_DIRECTORY"):
        return Path(folders.split(":")[0])
    if caches := environment.get("XDG_CACHE_HOME"):
        return Path(caches) / "aritra"
    home = environment.get("HOME") or _home()
    return Path(home) / ".cache" / "aritra" if home else None


def _home() -> str | None:
    """Home of the user who runs this."""
    try:
        return pwd.getpwuid(os.geteuid()).pw_dir
    except KeyError:
        return None


class CodeStore:
    """Object code in a folder, by key; None: nothing is kept. `make` compiles in a child process; where that fails, or
    where the folder or a file in it is not private, `tell` gets the reason, once.
    """

    def __init__(
        self,
        folder: Path | None,
        make: Callable[[str], bytes] = compiled_in_child,
        tell: Callable[[str], None] = lambda _: None,
    ):
        self._folder = PrivateFolder(folder) if folder else None
        self._make, self._tell = make, tell
        self._told: set[str] = set()

    @classmethod
    def of(cls, environment: Mapping[str, str] = os.environ, tell: Callable[[str], None] = lambda _: None) -> CodeStore:
        """The store in the folder of `environment`."""
        return cls(cache_folder(environment), tell=tell)

    def get(self, key: str) -> bytes | None:
        """The code, or None where there is none, or it is damaged or not private."""
        if self._folder is None:
            return None
        try:
            return checked(self._folder.read(_name(key)))
        except NotPrivate as found:
            self._say(f"machine code is not taken from where others can put theirs: {found}")
        except (OSError, ChecksumError):
            pass
        return None

    def put(self, key: str, code: bytes) -> None:
        """Store the code; nothing happens where the folder cannot be written or is not private."""
        if self._folder is None:
            return
        try:
            self._folder.write(_name(key), with_checksum(code))
            self._delete_oldest(self._folder.path)
        except (OSError, NotPrivate):
            pass

    def made(self, text: str) -> bytes | None:
        """Object code of a module's text, compiled in a child process; None where that failed."""
        try:
            return self._make(text)
        except ChildFailed as error:
            self._tell(f"machine code is compiled in this process, not in one of its own: {error}")
            return None

    def _say(self, text: str) -> None:
        if text not in self._told:
            self._told.add(text)
            self._tell(text)

    @staticmethod
    def _delete_oldest(folder: Path) -> None:
        files = sorted(folder.glob("*.o"), key=lambda f: f.stat().st_mtime)
        for file in files[:-MOST_FILES]:
            file.unlink(missing_ok=True)


def _name(key: str) -> str:
    return f"{key}.o"
