"""Evidence for the locks of telemetry: who may not, cannot; nothing that strangers send moves or stops the boat.

A real companion on a simulator, the router with deploy/zenoh/router.json5 as it is, certificates from its script. The
attackers stand in this process. In the end one honest order is obeyed: the door was there all the time.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from companion.core.messages import LoopTiming, OperatorCommand, ProcessStats
from companion.core.telemetry import structs as shore
from companion.logs.log_file import LogFile
from tests.evidence.line import Line, at_least, at_most, exactly, information
from tests.evidence.shore.attacks import (
    FLOOD_S,
    WAIT_S,
    ask,
    flood,
    malformed,
    no_certificate,
    no_command_key,
    no_tls,
    oversize,
    replayed,
    right_user_wrong_key,
    signed_order,
    wrong_ca,
    wrong_user,
)
from tests.evidence.shore.secured_boat import Range, end
from tests.support.zenoh_fixture import Console

FUZZED, FULL_FUZZED = 3000, 30_000


ROWS: tuple[tuple[str, Callable, str, str], ...] = (
    ("no TLS", no_tls, "router", "InvalidContentType"),
    ("no certificate", no_certificate, "router", "peer sent no certificates"),
    ("certificate of another authority", wrong_ca, "router", "invalid peer certificate"),
    ("wrong user: certificate of ours, name unknown", wrong_user, "router", "did not match any configured ACL subject"),
    ("right user, wrong key expression", right_user_wrong_key, "router", "is unauthorized to"),
    ("operator without the boat's command key", no_command_key, "boat", "not signed with this boat's command key"),
    ("replayed orders, rightly signed", replayed, "boat", "order from shore refused: counter"),
    ("malformed payloads by fuzzing, rightly signed", malformed, "boat", "order from shore refused: not an order"),
    ("oversize payloads, to 20 MB", oversize, "boat", "order from shore refused: longer than"),
    ("flood of unsigned orders", flood, "boat", "not signed with this boat's command key ("),
)
"""What, who does it, in whose log it is, and the words there."""


def lines(full: bool) -> Iterator[Line]:
    with tempfile.TemporaryDirectory(prefix="aritra-") as folder, Range(Path(folder)) as at:
        with at.person("watch") as session:
            at.run = shore.decode("about", Console(session).last_values()["about"]).run
        print(f"  {'attack':<48} {'tries':>7} {'accepted':>8}  {'crashed':<7}  logged")
        windows: dict[str, tuple[int, int]] = {}
        for what, attack, place, words in ROWS:
            out = at.out if place == "boat" else at.router_out
            before = _count(out, words)
            begun_ns = time.monotonic_ns()
            n = (FULL_FUZZED if full else FUZZED,) if attack is malformed else ()
            tries, accepted = attack(at, *n)
            time.sleep(WAIT_S)
            ended_ns, logged, whole = time.monotonic_ns(), _count(out, words) - before, at.whole()
            print(f"  {what:<48} {tries:>7} {accepted:>8}  {'no' if whole else 'YES':<7}  {place}: {logged} lines")
            yield exactly(f"accepted: {what}", accepted, 0)
            yield at_least("  lines of log, and nothing crashed", logged if whole else 0, 1, "", place)
            windows[what] = begun_ns, ended_ns
            if attack is flood:
                rate = tries / FLOOD_S
        with at.person("anna") as session:
            yield exactly("one honest start is obeyed", ask(session, *signed_order(at), 5.0).count("done"), 1)
        end(at.boat)
        yield exactly("the companion's exit code", at.boat.returncode, 0)
        yield from _unmoved(at.log, windows, rate)


def _unmoved(log: Path, windows: dict[str, tuple[int, int]], rate: float) -> Iterator[Line]:
    """What the pilot was given, and how the loop fared in the flood, and the memory in all attacks."""
    messages = list(LogFile(log).messages(OperatorCommand, LoopTiming, ProcessStats))
    given = [m.command for m in messages if isinstance(m, OperatorCommand)]
    # two stops of the one who is overheard, the honest start, and the stop with which a run ends
    yield exactly("the pilot was given exactly stop, stop, start, stop", given == ["stop", "stop", "start", "stop"], 1)
    late = [m for m in messages if isinstance(m, LoopTiming)]
    (begin, _), *_, flooded = windows.values()
    during = [m.lateness_ms for m in late if flooded[0] < m.t_ns < flooded[1]]
    before = [m.lateness_ms for m in late if m.t_ns < flooded[0]][-len(during) :]
    note = f"{rate:.0f} orders a second; p99 {np.percentile(before, 99):.2f} ms in the {len(before) / 10:.0f} s before"
    yield information("lateness p99 in the flood", float(np.percentile(during, 99)), "ms", note)
    yield at_least("ticks a second in the flood", len(during) / (flooded[1] - flooded[0]) * 1e9, 9.8)
    rss = [(m.t_ns, m.rss_mb) for m in messages if isinstance(m, ProcessStats)]
    at = [min(rss, key=lambda x: abs(x[0] - t_ns))[1] for t_ns in (begin, *(w[1] for w in windows.values()))]
    note = "MB before, and after each attack: " + " ".join(f"{x:.0f}" for x in at)
    yield at_most("memory after all attacks more than before", at[-1] - at[0], 30.0, "MB", note)


def _count(file: Path, words: str) -> int:
    return file.read_text(errors="replace").count(words)
