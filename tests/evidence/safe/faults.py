"""Random fault sequences over the whole App: `support/fault_fixture.py` plays them, `support/fault_oracle.py` judges.

The same sequences as in tests/closed_loop/test_random_faults.py, longer and more: hypothesis draws 25 for each of
eight seeds. What fails is printed as it was drawn; a shrunk one comes from the test with the same seed.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from concurrent.futures import as_completed
from pathlib import Path

from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import seed as seeded

from companion.core.messages import ModeStatus, Tick
from tests.evidence.line import Line, at_least, exactly, information
from tests.evidence.processes import processes
from tests.support.fault_fixture import FaultBench
from tests.support.fault_oracle import judge, moving
from tests.support.faults import Sequence, sequences

SEEDS = range(1, 9)
EACH = 25
PROCESSES = 2
KINDS = {
    "on the wire": ("us", "released"),
    "leases": ("override for", "lease", "overrides in one tick"),
    "motion when neutral was due": ("motion sent", "outputs ("),
    "the app raised": ("the app raised",),
}
"""Kind of fault -> words by which a sentence of the oracle is known; the first that fits from the end."""


def batch(seed: int) -> tuple[Counter[str], list[str]]:
    """Play one seed's sequences: counts, and what was done wrong."""
    counts: Counter[str] = Counter()
    wrong: list[str] = []

    @seeded(seed)
    @settings(max_examples=EACH, deadline=None, database=None, phases=[Phase.generate],
              suppress_health_check=[HealthCheck.too_slow])  # fmt: skip
    @given(told=sequences())
    def play(told: Sequence) -> None:
        with tempfile.TemporaryDirectory() as folder:
            bench = FaultBench(Path(folder) / "run.mcap", told).play()
        found = judge(bench)
        wrong.extend(f"{text}   {told}" for text in found)
        counts["sequences"] += 1
        counts["faults"] += len(told.faults)
        counts["ticks"] += sum(isinstance(m, Tick) for m in bench.seen)
        counts["seconds"] += round(bench.clock.now_ns() * 1e-9)
        overrides = [m for _, m in bench.sent if m.get_type() == "RC_CHANNELS_OVERRIDE"]
        counts["overrides"] += len(overrides)
        counts["moving"] += sum(map(moving, overrides))
        counts.update(f"mode {name}" for name in {m.mode for m in bench.of(ModeStatus)})

    play()
    return counts, wrong


def lines(full: bool) -> list[Line]:
    """Random faults: 200 sequences on the stepped clock, judged at the wire and at the speed controllers"""
    counts: Counter[str] = Counter()
    wrong: list[str] = []
    with processes(PROCESSES) as pool:
        for done in as_completed([pool.submit(batch, seed) for seed in SEEDS]):
            more, found = done.result()
            counts += more
            wrong += found
    for text in wrong[:10]:
        print(f"    {text}")
    kinds = Counter(_kind(text) for text in wrong)
    modes = sum(name.startswith("mode ") for name in counts)
    note = f"{counts['faults']} faults, seeds {SEEDS[0]} to {SEEDS[-1]}"
    return [
        at_least("fault sequences", counts["sequences"], len(SEEDS) * EACH, note=note),
        *(exactly(kind, kinds[kind], 0) for kind in KINDS),
        at_least("modes that the boat was in", modes, 9, note="of 9"),
        information("simulated time", counts["seconds"] / 3600, "h"),
        information("overrides on the wire", counts["overrides"], note=f"{counts['ticks']} ticks"),
        at_least("share of them that moved a thruster", counts["moving"] / counts["overrides"], 0.2),
    ]


def _kind(text: str) -> str:
    """Kind of a sentence of the oracle."""
    said = text.partition("   ")[0]
    return next(kind for kind in reversed(KINDS) if any(word in said for word in KINDS[kind]))
