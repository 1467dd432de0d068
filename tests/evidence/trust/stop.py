"""Evidence that STOP always works, that orders expire, and that one boat's trouble is not the others'.

Each part replays the attack that opened a hole, against the code as it is.
"""

from __future__ import annotations

import asyncio
import random
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from companion.boat.start_interlock import StartInterlock, companion_of
from companion.core.messages import Alert, OperatorCommand, VehicleRequest
from tests.companion.boat.app_fixture import Bench
from tests.evidence.line import Line, at_least, at_most, exactly, information
from tests.evidence.trust.stop_attacks import ATTACKS, BOAT
from tests.evidence.trust.stop_bench import Water, at_sea, counts, until
from tests.evidence.trust.stop_processes import stop_with_real_processes
from tests.support.drive_fixture import setup

STOPS, SEED = 500, 22
GOAL_MS = 300.0
DEAD = tuple(f"dead-{k}" for k in range(60))
"""Names in a STOP ALL that nobody answers to."""
GUEST_S, TRIES = 25.0, 44
"""How long the second program stayed when the hole was found, and how often a stop was tried afterwards."""


def stop_500_times(full: bool) -> Iterator[Line]:
    """STOP 500 times, among twins, made-up samples and answers, floods, wrong clocks, dead boats, half-sent requests"""
    took: list[float] = []
    by_attack: dict[str, list[float]] = {name: [] for name in ATTACKS}
    twins: Counter[str] = Counter()

    async def story(water: Water) -> None:
        rng = random.Random(SEED)
        for k in range(STOPS):
            names = {ATTACKS[k % len(ATTACKS)], *rng.sample(ATTACKS, rng.choice((0, 0, 1, 2)))}
            await water.drive()
            await water.attackers.begin(*sorted(names))
            await asyncio.sleep(rng.uniform(0.0, 0.1))  # anywhere between two ticks
            took.append(1e3 * await water.stop_s([*(DEAD if rng.random() < 0.3 else ()), BOAT]))
            stops, others, there = await water.attackers.end()
            twins.update(stops=min(stops, there), others=others, there=there)
            for name in names:
                by_attack[name].append(took[-1])
        twins["strangers"] = (await counts(water))[0]
        twins["samples"] = sum(water.console.store.refused.values())

    at_sea(story)
    for name, each in by_attack.items():
        print(f"  {name:<28} {len(each):>4} times, p95 {np.percentile(each, 95):6.0f} ms, largest {max(each):6.0f} ms")
    yield exactly("stops that ended in neutral", int(np.isfinite(took).sum()), STOPS)
    note = f"median {np.median(took):.0f}, largest {max(took):.0f}; a tick is 100 ms"
    yield at_most(
        "from the page's STOP to neutral that lasts, p95", float(np.percentile(took, 95)), GOAL_MS, "ms", note
    )
    yield exactly("twins that did not obey", twins["there"] - twins["stops"], 0, "", f"of {twins['there']}")
    note = f"refused at the boat; {twins['samples']} samples left out at the console"
    yield information("orders of strangers meanwhile", twins["strangers"], "", note)


def name_taken_twice(full: bool) -> Iterator[Line]:
    """Hole 1: a second program of the name comes for 25 s and goes; one unsigned sample; START to a shared name"""
    seen: Counter[str] = Counter()
    refused = ("wrong_run", "late")

    async def stops(water: Water, what: str, tries: int) -> None:
        for _ in range(tries):
            await water.drive()
            given = await water.post("/order", {"boat": BOAT, "command": "stop"})
            outcome = given["outcome"] or {}
            seen[f"{what}: refused"] += outcome.get("code") in refused or outcome.get("status") != "done"
            await until(lambda: water.boat.still, 5.0)

    async def story(water: Water) -> None:
        await water.attackers.begin("twin an hour ahead")
        begun_s = time.monotonic()
        await until(lambda: len(water.console.known.runs(BOAT)) == 2, 10.0)
        for command in ("start", "hold"):
            given = await water.post("/order", {"boat": BOAT, "command": command})
            seen["told"] += given["state"] == "not_sent" and "several programs call themselves" in given["why"]
        await asyncio.sleep(GUEST_S - (time.monotonic() - begun_s))
        seen["others"] = (await water.attackers.end())[1]
        seen["boat"] = (await counts(water))[1]
        await stops(water, "guest", TRIES)
        await until(lambda: len(water.console.known.runs(BOAT)) == 1, 10.0)
        given = await water.post("/order", {"boat": BOAT, "command": "start"})
        seen["ours"] = (given["outcome"] or {}).get("status") == "done"
        for what in ("one sample of another run", "one sample an hour ahead"):
            await water.attackers.begin(what)
            await water.attackers.end()
            await stops(water, what, 5)

    at_sea(story)
    yield exactly("STOP refused, of 44 after it had gone", seen["guest: refused"], 0, "", "was 44")
    for what in ("one sample of another run", "one sample an hour ahead"):
        yield exactly(f"STOP refused, of 5 after {what}", seen[f"{what}: refused"], 0, "", "was 5, for good")
    yield exactly("START and HOLD to the shared name, refused in a sentence", seen["told"], 2, "", "START went to it")
    yield exactly("  and obeyed by the other program", seen["others"], 0)
    yield at_least("  alerts of the boat: another calls itself so", seen["boat"], 1)
    yield exactly("START to ours once it is alone again", seen["ours"], 1)


def orders_that_wait(full: bool) -> Iterator[Line]:
    """Hole 3: orders given where no autopilot is, which is plugged in later"""
    away_s = 600.0 if full else 60.0
    for guarded in (True, False):
        for command in ("start", "hold"):
            with tempfile.TemporaryDirectory() as folder:
                bench = _unplugged(Path(folder), command, away_s, guarded=guarded)
            where = f"{command}, {'' if guarded else 'un'}checked, plugged in after {away_s:g} s"
            requests = [r for r in bench.of(VehicleRequest) if r.action != "disarm"]
            yield exactly(f"{where}: obeyed", len(requests) + (bench.mode != "idle"), 0, "", "drove off at once")
            told = [a.text for a in bench.of(Alert) if f"{command} expired" in a.text]
            yield exactly("  told that it expired", len(told), 1, "", told[0][:60] if told else "")


def _unplugged(folder: Path, command: str, away_s: float, *, guarded: bool) -> Bench:
    guard = (lambda codec: StartInterlock(codec, companion_of(setup()))) if guarded else None
    bench = Bench(folder / "run.mcap", guard=guard)

    async def story(bench: Bench) -> None:
        bench.deaf = True
        bench.app.command(OperatorCommand(t_ns=bench.clock.now_ns(), command=command))
        await bench.run(away_s)
        bench.deaf = False
        await bench.run(30.0)
        assert bench.mode in ("idle", "auto", "hold", "starting", "safe")

    assert bench.scene(story) is None
    return bench


PARTS = (stop_500_times, stop_with_real_processes, name_taken_twice, orders_that_wait)
