"""Authentication of the console's requests: host, origin, token. Pure.

Three strangers are kept out. A page of another site that posts to us, or opens a WebSocket: its `Origin` is not ours.
A name of a stranger that was made to point at us (DNS rebinding): its `Host` is neither an IP address nor a name of
this machine. Somebody in the same network: without the token of the address that the console printed, nothing is
served. On the loopback address there is no token; whoever may run programs on this machine may use the console.
"""

from __future__ import annotations

import hmac
import ipaddress
from dataclasses import dataclass


@dataclass(frozen=True)
class RequestAuth:
    """`names`: host names of this machine; `token`: None: none is needed."""

    names: frozenset[str]
    token: str | None

    def host(self, host: str | None) -> bool:
        """Whether a Host header names this machine."""
        name = _name(host or "")
        return name in self.names or _is_address(name)

    def origin(self, origin: str | None, host: str | None, *, needed: bool) -> bool:
        """Whether an Origin header is that of our own page. `needed`: it must be present."""
        if origin is None:
            return not needed
        return host is not None and origin.lower() in (f"http://{host.lower()}", f"https://{host.lower()}")

    @staticmethod
    def cookie(port: int | None) -> str:
        """Name of the cookie with the token: browsers keep the cookies of all ports of a host together."""
        return f"aritra_token_{port}"

    def knows(self, token: str | None) -> bool:
        """Whether a token is ours."""
        return self.token is None or hmac.compare_digest((token or "").encode(errors="replace"), self.token.encode())


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches a server bound to `host`."""
    if host == "localhost":
        return True
    return _is_address(host) and ipaddress.ip_address(host).is_loopback


def _name(host: str) -> str:
    """Host header without its port."""
    if host.startswith("["):
        name, _, port = host[1:].partition("]")
        return name.lower() if not port or port.startswith(":") else ""
    return host.rsplit(":", 1)[0].lower() if ":" in host else host.lower()


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
