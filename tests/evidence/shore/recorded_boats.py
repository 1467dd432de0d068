"""Many boats on one machine: python -m tests.evidence.shore.recorded_boats ENDPOINT N RUN.mcap [NAME]

Plays the messages of a real run's log (`aritra demo` writes one) into the telemetry of N boats NAME-1 .. NAME-N (one
boat: NAME; default `boat`), each with a zenoh session, a thread and keys of its own, at 10 Hz, for ever, each from
another place of the log, with stamps of now. So shore meets the connections, bytes and rates of N boats, not N
companions: those need a seventh of a core each. Orders are not taken. Ends with SIGINT or SIGTERM.
"""

from __future__ import annotations

import secrets
import signal
import sys
import threading
import time
from pathlib import Path

from msgspec.structs import replace

from companion.boat.load_run import RunSetup, setup_of
from companion.boat.uplink.telemetry import Telemetry, config_of
from companion.core.configuration.run_file import TelemetryLink
from companion.core.messages import LoopTiming, Message
from companion.core.telemetry.view import TelemetryView, Who, wants
from companion.logs.log_file import LogFile

PERIOD_S = 0.1
Ticks = list[tuple[int, list[Message]]]


def ticks_of(log: Path) -> tuple[RunSetup, Ticks]:
    """The log's configuration; and tick by tick its time [ns] and the messages that telemetry wants."""
    file = LogFile(log)
    ticks, now = [], list[Message]()
    for message in file.messages():
        if wants(message):
            now.append(message)
        if isinstance(message, LoopTiming):
            ticks.append((message.t_ns, now))
            now = []
    prefix = "config/"
    texts = {name.removeprefix(prefix): text for name, text in file.metadata.items() if name.startswith(prefix)}
    return setup_of(texts, {name: f"{log}: {name}" for name in texts}), ticks


def boat(name: str, endpoint: str, setup: RunSetup) -> Telemetry:
    """Telemetry of one boat, started; says on stdout what a run would."""
    link = TelemetryLink(connect=(endpoint,), boat=name)
    who = Who(secrets.token_hex(6), setup.digest, "recorded", time.time_ns() - time.monotonic_ns(), commands=False)
    made = Telemetry(
        name, link, config_of(link, Path(), where="recorded"), TelemetryView(setup.pilot, who, link.rate_Hz)
    )
    made.start(lambda alert: print(f"{name}: {alert.text}", flush=True), tuple)
    return made


def play(boats: list[Telemetry], ticks: Ticks, ended: threading.Event) -> None:
    """Feed them until `ended`, evenly spread over the log; a boat behind its time is not made up for."""
    places = [k * len(ticks) // len(boats) for k in range(len(boats))]
    due = time.monotonic()
    while not ended.wait(max(0.0, due - time.monotonic())):
        due = max(due + PERIOD_S, time.monotonic() - PERIOD_S)
        for k, each in enumerate(boats):
            then_ns, messages = ticks[places[k]]
            shift_ns = time.monotonic_ns() - then_ns
            for message in messages:
                each.see(replace(message, t_ns=message.t_ns + shift_ns))
            places[k] = (places[k] + 1) % len(ticks)


def main() -> int:
    """Exit code: 0 after an interrupt, 2 for bad arguments."""
    if len(sys.argv) not in (4, 5) or not sys.argv[2].isdigit() or sys.argv[2] == "0":
        print(__doc__.splitlines()[0], file=sys.stderr)
        return 2
    endpoint, n, name = sys.argv[1], int(sys.argv[2]), sys.argv[4] if len(sys.argv) == 5 else "boat"
    setup, ticks = ticks_of(Path(sys.argv[3]))
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    boats = [boat(f"{name}-{k + 1}" if n > 1 else name, endpoint, setup) for k in range(n)]
    print(f"playing {len(ticks)} ticks as {n} boats", flush=True)
    play(boats, ticks, ended)
    for each in boats:
        each.close()
    print(f"published {sum(b.published for b in boats)}, dropped {sum(b.dropped for b in boats)}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
