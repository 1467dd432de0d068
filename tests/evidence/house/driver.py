"""Runs in either tree, by path: driver.py TREE log SECONDS SEED... | driver.py TREE rounds

log: a line "SEED SHA256 MESSAGES" for each seed, of the log of a mission on the stepped clock.
rounds: for every line on standard input a line "NMPC_S FIT_S WORLD_S": processor time of the same three computations,
which depends less than wall time on who else uses the machine.
"""

from __future__ import annotations

import hashlib
import sys
import time
from contextlib import suppress
from importlib import import_module
from pathlib import Path

import msgspec

NAMES = {
    "load_setup": ("companion.boat.load_run", "companion.setup"),
    "Pilot": ("companion.core.pilot.pilot", "companion.core.pilot"),
    "Nmpc": ("companion.core.control.nmpc", "companion.core.nmpc"),
    "Actuation": ("companion.core.control.nmpc", "companion.core.nmpc"),
    "StructuredModel": ("companion.core.model.manoeuvring", "companion.core.vessel"),
    "topic": ("companion.core.messages",),
    "SolveRequest": ("companion.core.messages",),
    "SteppedRun": ("sim.world.stepped",),
    "World": ("sim.world.world",),
    "WorldSetup": ("sim.world.world",),
    "Weather": ("sim.world.environment",),
    "teleop_run": ("sim.world.teleop_log", "sim.identify.teleop"),
    "fit_structured": ("sim.fitting.identify.result", "sim.identify.structured.result"),
}
"""What the driver needs -> modules that have it: where it is now, then where it was."""
FIT_S, WORLD_S = 60.0, 60.0
REPEATS = 10
"""Of solves and fits in a round: each takes well below a second."""


def find(name: str):
    """The object of that name from the first of its modules that is there."""
    for module in NAMES[name]:
        try:
            return getattr(import_module(module), name)
        except (ImportError, AttributeError):
            continue
    raise ImportError(f"{name}: in none of {', '.join(NAMES[name])}")


class Bench:
    """The example boat of a tree. Its NMPC measures no time, so that nothing of the clock is in the log."""

    def __init__(self, tree: Path):
        companion = import_module("companion").__file__ or ""
        assert tree in Path(companion).parents, f"{companion} is not of {tree}"
        self.setup = find("load_setup")(tree / "deploy/aritra.toml").pilot
        self.pilot = find("Pilot")(self.setup)
        self.vessel = self.setup.vessel

    def nmpc(self):
        patient = msgspec.structs.replace(self.setup.nmpc, rescue_time_s=60.0)
        model, actuation = find("StructuredModel").of(self.vessel), find("Actuation").of(self.vessel)
        machine_code = {}  # the older trees compile by themselves, the newer are handed a compiler
        with suppress(ImportError):
            machine_code["compiler"] = import_module("companion.jit").compile_loops
        return find("Nmpc")(model, actuation, patient, lambda: 0.0, self.setup.fence, **machine_code)

    def driven(self, seed: int, seconds: float):
        """A mission of so many seconds; odd seeds in current and wind, on a boat that is not as believed."""
        rough = find("Weather")(V_c_m_s=0.1, beta_c_deg=70.0, V_w_m_s=3.0, beta_w_deg=200.0, gustiness=0.2)
        more = {"weather": rough, "mismatch": 0.1} if seed % 2 else {}
        world = find("WorldSetup")(self.vessel, self.setup.site, start=(8.0, 8.0, 0.35), **more)
        run = find("SteppedRun")(find("World")(world, seed), self.pilot, self.nmpc().solve)
        run.run(lambda run: False, seconds)
        return run


def log(bench: Bench, seconds: float, seeds: list[int]) -> None:
    """A digest of every message in order: its topic and its JSON."""
    topic = find("topic")
    for seed in seeds:
        digest, messages = hashlib.sha256(), bench.driven(seed, seconds).messages
        for message in messages:
            digest.update(topic(type(message)).encode() + b" " + msgspec.json.encode(message) + b"\n")
        print(seed, digest.hexdigest(), len(messages), flush=True)


def rounds(bench: Bench) -> None:
    """Time the solver over recorded states, one structured fit, and the stepped world, once for every line of input."""
    kind, fit = find("SolveRequest"), find("fit_structured")
    requests = [m for m in bench.driven(1, WORLD_S).messages if isinstance(m, kind)]
    run = find("teleop_run")(bench.vessel, 11, FIT_S)
    nmpc = bench.nmpc()
    fit([run], bench.vessel)
    print("ready", flush=True)
    for _ in sys.stdin:
        solving = clocked(lambda: replay(nmpc, requests), REPEATS)
        fitting = clocked(lambda: fit([run], bench.vessel), REPEATS)
        print(solving, fitting, clocked(lambda: bench.driven(1, WORLD_S), 1), flush=True)


def clocked(compute, times: int) -> float:
    """Processor time of one of so many calls in a row [s]."""
    begun = time.process_time()
    for _ in range(times):
        compute()
    return (time.process_time() - begun) / times


def replay(nmpc, requests) -> None:
    """Solve recorded requests in order, each from the plan before it."""
    warm = None
    for request in requests:
        _, warm = nmpc.solve(request, warm)


if __name__ == "__main__":
    made = Bench(Path(sys.argv[1]))
    if sys.argv[2] == "log":
        log(made, float(sys.argv[3]), [int(word) for word in sys.argv[4:]])
    else:
        rounds(made)
