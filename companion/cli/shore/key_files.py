"""Where the command keys of boats lie: what `--command-key` names."""

from __future__ import annotations

import contextlib
import errno
import os
from pathlib import Path

from companion.boat.signing_key import load_secret
from companion.core.configuration.tables import ConfigError

KEY_FILE = "command.key"
NO_FILE = os.strerror(errno.ENOENT)


class KeyFiles:
    """Command keys: `FILE` for all boats, `BOAT=FILE` for one, or a folder as `aritra demo --shore` makes it, whose
    `command.key` or `BOAT/command.key` may be created later. Raises ConfigError for an option that cannot be meant, a
    `FILE` for all boats that cannot be used among them; that of one boat is read when it is needed. Files are read
    anew each time, for another key may lie there by now.
    """

    def __init__(self, options: list[str]) -> None:
        self._files: dict[str, Path] = {}
        self._folders: list[Path] = []
        self._key: bytes | None = None
        for each in options:
            boat, _, file = each.rpartition("=")
            if boat in self._files:
                raise ConfigError(f"--command-key: given twice for {boat or 'all boats'}")
            if not boat and (os.path.isdir(file) or file.endswith("/")):  # for names that cannot be, too
                self._folders.append(Path(file))
            else:
                self._files[boat] = Path(file)
                if not boat:
                    self._key = self._of_all(file)

    def _of_all(self, file: str) -> bytes:
        try:
            return load_secret(Path(file), where="--command-key")
        except ConfigError as error:
            if str(error).endswith(NO_FILE):
                raise ConfigError(f'{error}; a folder that will be made later ends in "/"') from None
            raise

    @property
    def boats(self) -> list[str]:
        """Boats with a file of their own."""
        return [boat for boat in self._files if boat]

    def find(self, boat: str) -> bytes | None:
        """The key of a boat. Raises ConfigError for a file that cannot be used."""
        if boat in self._files:
            return load_secret(self._files[boat], where=f"--command-key {boat}=")
        if "" in self._files:
            with contextlib.suppress(ConfigError):  # what was good at first is, for boats that come later, too
                self._key = load_secret(self._files[""], where="--command-key")
            return self._key
        for folder in self._folders if boat.strip(".") else ():
            for file in (folder / boat / KEY_FILE, folder / KEY_FILE):
                if file.exists():
                    return load_secret(file, where="--command-key")
        return None
