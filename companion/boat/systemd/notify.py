"""The wire to the service manager: `KEY=value` lines in datagrams to the socket that NOTIFY_SOCKET names.

Protocol: sd_notify(3), sd_watchdog_enabled(3). Outside a service there is no socket, and nothing is sent.
What to say is decided in `companion.boat.systemd.status`. Why not a library: docs/adr/0017-own-sd-notify.md.
"""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Mapping, Sequence


class SdNotify:
    """One sender. `environ`, `pid`: of this process. Never waits and never raises: the control loop calls it."""

    def __init__(self, environ: Mapping[str, str], pid: int):
        self._address = _address(environ.get("NOTIFY_SOCKET", ""))
        self.watchdog_ns = _watchdog_ns(environ, pid) if self._address else None
        """Without WATCHDOG=1 for this long the service manager kills the process; None: it does not watch."""
        self._socket = None
        if self._address:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.setblocking(False)

    def send(self, lines: Sequence[str]) -> bool:
        """Send `lines` as one datagram; False where it was not taken (queue full, nobody there)."""
        if not self._socket or not lines:
            return True
        text = "\n".join(" ".join(line.splitlines()) for line in lines)
        with contextlib.suppress(OSError):
            self._socket.sendto(text.encode(errors="replace"), self._address)
            return True
        return False

    def close(self) -> None:
        """Nothing can be sent afterwards."""
        if self._socket:
            self._socket.close()


def _address(name: str) -> str:
    """Socket address: a path, or `@name` in the abstract namespace; anything else is none of ours."""
    if name.startswith("@"):
        return "\0" + name[1:]
    return name if name.startswith("/") else ""


def _watchdog_ns(environ: Mapping[str, str], pid: int) -> int | None:
    """WATCHDOG_USEC, where it is meant for this process."""
    usec, whose = environ.get("WATCHDOG_USEC", ""), environ.get("WATCHDOG_PID", str(pid))
    meant = whose == str(pid) and usec.isascii() and usec.isdigit() and int(usec) > 0
    return int(usec) * 1000 if meant else None
