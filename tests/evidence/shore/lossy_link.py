"""A bad radio link between two network namespaces: -m tests.evidence.shore.lossy_link NAMESPACE_A NAMESPACE_B [SEED]

What `tc netem` does, for kernels that are built without it: a TUN device in each namespace (10.77.0.1 in A, 10.77.0.2
in B), and whole IP packets carried between them, each way dropped with probability `loss`, late by `delay_s`, or all of
them dropped while not `up`. So TCP sees real losses and sends again. Each line of JSON on stdin sets the link; the
answer is a line on stdout. Ends with its stdin. Needs root.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import heapq
import json
import os
import random
import select
import struct
import subprocess
import sys
import time
from dataclasses import dataclass, replace

CLONE_NEWNET = 0x40000000
TUNSETIFF = 0x400454CA
IFF_TUN, IFF_NO_PI = 0x0001, 0x1000
MTU = 1500
ADDRESSES = ("10.77.0.1", "10.77.0.2")


@dataclass(frozen=True)
class Link:
    """How the link is, both ways."""

    loss: float = 0.0
    delay_s: float = 0.0
    up: bool = True


def open_tun(namespace: str, address: str) -> int:
    """A TUN device in a namespace, up and with an address; its file descriptor works from anywhere."""
    libc = ctypes.CDLL(None, use_errno=True)
    with open(f"/var/run/netns/{namespace}") as there, open("/proc/self/ns/net") as here:
        if libc.setns(there.fileno(), CLONE_NEWNET):
            raise OSError(ctypes.get_errno(), f"cannot enter namespace {namespace}")
        try:
            tun = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
            fcntl.ioctl(tun, TUNSETIFF, struct.pack("16sH", b"radio", IFF_TUN | IFF_NO_PI))
            for words in (f"addr add {address}/24 dev radio", f"link set radio mtu {MTU} up", "link set lo up"):
                subprocess.run(["ip", *words.split()], check=True)
        finally:
            libc.setns(here.fileno(), CLONE_NEWNET)
    return tun


def carry(tuns: tuple[int, int], rng: random.Random) -> None:
    """Until stdin ends."""
    link, late, order = Link(), list[tuple[float, int, int, bytes]](), 0
    across = {tuns[0]: tuns[1], tuns[1]: tuns[0]}
    while True:
        wait = max(0.0, late[0][0] - time.monotonic()) if late else None
        ready, _, _ = select.select([*tuns, sys.stdin], [], [], wait)
        if sys.stdin in ready:
            if not (line := sys.stdin.readline()):
                return
            link = replace(Link(), **json.loads(line))
            print(link, flush=True)
        now = time.monotonic()
        for tun in tuns:
            if tun in ready:
                packet = os.read(tun, MTU + 100)
                if link.up and rng.random() >= link.loss:
                    order += 1
                    heapq.heappush(late, (now + link.delay_s, order, across[tun], packet))
        while late and late[0][0] <= now:
            with contextlib.suppress(BlockingIOError):  # a full queue loses packets, as a radio's does
                os.write(late[0][2], late[0][3])
            heapq.heappop(late)


def main() -> int:
    if len(sys.argv) not in (3, 4):
        print(__doc__.splitlines()[0], file=sys.stderr)
        return 2
    a, b = sys.argv[1:3]
    tuns = open_tun(a, ADDRESSES[0]), open_tun(b, ADDRESSES[1])
    print("carrying", flush=True)
    carry(tuns, random.Random(int(sys.argv[3]) if len(sys.argv) == 4 else 1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
