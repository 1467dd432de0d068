"""A person's program on shore, as docs/telemetry.md shows it: python -m tests.evidence.shore.listener ENDPOINT FILE

Writes a line to FILE for every sample of the topic `state`: boat, t_ns, and when it arrived (this machine's monotonic
clock [ns]). Waits for a router where there is none. Ends with its stdin.
"""

from __future__ import annotations

import json
import sys
import threading
import time

import msgspec
import zenoh

from companion.core.telemetry import structs as shore
from companion.shore.subscriber import listen


def config(endpoint: str) -> zenoh.Config:
    """A client of the router there; scouts nothing."""
    made = zenoh.Config()
    told = {
        "mode": "client",
        "connect/endpoints": [endpoint],
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
    }
    for key, value in told.items():
        made.insert_json5(key, json.dumps(value))
    return made


def open_session(endpoint: str) -> zenoh.Session:
    """Tries again until there is a router."""
    while True:
        try:
            return zenoh.open(config(endpoint))
        except zenoh.ZError:
            time.sleep(0.5)


def main() -> int:
    if len(sys.argv) != 3:
        print(__doc__.splitlines()[0], file=sys.stderr)
        return 2
    lock = threading.Lock()
    with open(sys.argv[2], "w", buffering=1) as file, open_session(sys.argv[1]) as session:

        def heard(sample: zenoh.Sample) -> None:
            arrived = time.monotonic_ns()
            boat = str(sample.key_expr).split("/")[1]
            t_ns = msgspec.json.decode(bytes(sample.payload), type=shore.ShoreMessage).t_ns
            with lock:
                file.write(f"{boat} {t_ns} {arrived}\n")

        held = listen(session, heard, topic="state")
        print("listening", flush=True)
        sys.stdin.read()
        del held
    return 0


if __name__ == "__main__":
    sys.exit(main())
