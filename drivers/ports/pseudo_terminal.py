"""The device's side of a serial line: a pseudo terminal that `SerialPort` can open. For simulation.

Like a device at the end of a real cable it cannot see whether anybody listens: while nobody has the line
open, `receive` waits and what is sent is dropped and counted. Closing it is the unplugging: the program at
the other end reads end of file or EIO. A device's link is its own while it is plugged in: `LinkClaim`.
"""

from __future__ import annotations

import asyncio
import errno
import hashlib
import io
import os
import select
import socket
import tty
from pathlib import Path

from drivers.ports.descriptor import READ_BYTES, DescriptorPort

SEND_LIMIT_BYTES = 4096
LISTENER_POLL_S = 0.05
"""A hang-up is signalled without pause by the kernel, so the return of a listener has to be polled."""


class LinkClaim:
    """The right to one path, held until `release`, or until the kernel ends it with the process, however that dies.

    An abstract Unix socket (no file is left behind), named after the folder's device and inode and the file's name, so
    that every way to write the path is the same one. Raises OSError: EADDRINUSE where another port has the claim.
    """

    def __init__(self, path: Path) -> None:
        folder = os.stat(path.parent)
        name = hashlib.sha256(os.fsencode(path.name)).hexdigest()
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            self._socket.bind(f"\0aritra-pty-{folder.st_dev}-{folder.st_ino}-{name[:32]}")
        except BaseException:
            self._socket.close()
            raise

    def release(self) -> None:
        """Let others have it."""
        self._socket.close()


class PtyPort(DescriptorPort):
    """`pty:/tmp/uwb`: `link` becomes a symbolic link to the terminal's path. Without link: see `path`."""

    def __init__(self, link: str | None = None, *, send_limit_bytes: int = SEND_LIMIT_BYTES) -> None:
        super().__init__(f"pty:{link}" if link else "pty", send_limit_bytes)
        self.link = Path(link) if link else None
        self._claim: LinkClaim | None = None
        self.path = ""
        """What to open on the other side; known after `open`."""

    async def open(self) -> None:
        """Make a terminal in raw mode. Raises OSError, FileExistsError where `link` is a file of its own, EADDRINUSE
        where it is the link of another port that is open, in this process or in another one.
        """
        self._require_closed()
        claim = LinkClaim(self.link) if self.link is not None else None
        try:
            master = self._make_terminal()
        except BaseException:
            if claim is not None:
                claim.release()
            raise
        self._claim = claim
        self._begin()
        self._adopt(io.FileIO(master, "r+"))

    def _make_terminal(self) -> int:
        """Its master side; `path` and `link` lead to the other one. A link that a killed process left is replaced."""
        if self.link is not None and self.link.exists() and not self.link.is_symlink():
            raise FileExistsError(errno.EEXIST, f"{self.link} exists and is not a symbolic link")
        master, slave = os.openpty()
        try:
            tty.setraw(slave)
            os.set_blocking(master, False)
            self.path = os.ttyname(slave)
            if self.link is not None:
                self.link.unlink(missing_ok=True)
                self.link.symlink_to(self.path)
        except BaseException:
            os.close(master)
            raise
        finally:
            os.close(slave)
        return master

    async def close(self) -> None:
        """Unplug: the other side sees the end; the symbolic link goes if it is still ours."""
        link = self.link if self._handle is not None else None
        if link is not None and link.is_symlink() and os.readlink(link) == self.path:
            link.unlink()
        await super().close()
        claim, self._claim = self._claim, None
        if claim is not None:
            claim.release()

    def _has_listener(self) -> bool:
        poller = select.poll()
        poller.register(self._fileno(), 0)
        return not poller.poll(0)

    async def _readable(self) -> None:
        while self._is_open and not self._has_listener():
            await asyncio.sleep(LISTENER_POLL_S)
        if self._is_open:
            await super()._readable()

    def _read(self) -> bytes | None:
        try:
            return os.read(self._fileno(), READ_BYTES)
        except OSError as error:
            if error.errno == errno.EIO:
                return None
            raise

    def _write(self, data: memoryview) -> int:
        return os.write(self._fileno(), data) if self._has_listener() else 0
