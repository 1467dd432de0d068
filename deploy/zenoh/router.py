#!/usr/bin/env python3
"""A zenoh router where zenohd is not installed: router.py router.json5

Reads the same configuration file as zenohd (no plugins) and relays until it is interrupted. Who was turned away at the
door is told on stdout; RUST_LOG=zenoh::net::routing::interceptor::access_control=trace tells of every message, too,
whether it was let through.
"""

import signal
import sys

import zenoh

LOG = "warn,zenoh::net::routing::interceptor::access_control=info"
"""Bad certificates, and names that the file does not know."""
ENDING = (signal.SIGINT, signal.SIGTERM)


def main() -> int:
    """Exit code: 0 after an interrupt, 2 without a usable configuration."""
    if len(sys.argv) != 2:
        print("usage: router.py CONFIG.json5", file=sys.stderr)
        return 2
    zenoh.init_log_from_env_or(LOG)
    signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)  # before zenoh's threads start: one of them might get the signal
    try:
        config = zenoh.Config.from_file(sys.argv[1])
        config.insert_json5("mode", '"router"')
        with zenoh.open(config) as session:
            print(f"router {session.info.zid()} on {config.get_json('listen/endpoints')}", flush=True)
            signal.sigwait(ENDING)
    except zenoh.ZError as error:
        print(f"router.py: {sys.argv[1]}: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
