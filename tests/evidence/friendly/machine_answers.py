"""What this machine answers, for a comparison with another: a stepped mission, plans, trajectories, into a folder.

    python -m tests.evidence.friendly.machine_answers drive|plan FOLDER

drive: the demo mission on the stepped clock (seed 1); writes what its controller was asked to `requests.json`, what
came of it to `mission.json`. plan: answers FOLDER/requests.json and simulates random pulses (seed 2), each by machine
code and by the interpreter; writes both to `plans.npz`. Needs nothing but the boat's packages.
"""

from __future__ import annotations

import platform
import sys
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from msgspec.structs import replace

from companion.boat.load_run import load_setup
from companion.core.control.nmpc import Actuation, Nmpc
from companion.core.messages import GroundTruth, GuidanceReference, SolveRequest, StateEstimate
from companion.core.model.manoeuvring import StructuredModel
from companion.core.pilot.pilot import Pilot
from companion.jit import compile_loops
from sim.trajectory import simulate
from sim.world.score import track_of, tracking
from sim.world.stepped import SteppedRun
from sim.world.stepped_controller import stepped_controller
from sim.world.world import World, WorldSetup

ROOT = Path(__file__).resolve().parents[3]
START, SEED, LIMIT_S = (8.0, 8.0, 0.35), 1, 240.0
STEP_S, STEPS, BOATS = 0.01, 2000, 4
"""Trajectories: 20 s of four boats, pulses that change each second."""


def drive(folder: Path) -> None:
    """The mission of the shipped run file by the boat's own pilot and controller."""
    setup = load_setup(ROOT / "deploy/aritra.toml").pilot
    run = SteppedRun(World(WorldSetup(setup.vessel, setup.site, start=START), SEED), Pilot(setup),
                     stepped_controller(setup).solve)  # fmt: skip
    finished = run.run(lambda run: run.state.guidance.phase == "done", LIMIT_S)
    points = np.array(setup.mission.path.points)
    track = track_of(run.of(StateEstimate), run.of(GuidanceReference), run.of(GroundTruth))
    (folder / "requests.json").write_bytes(msgspec.json.encode(run.of(SolveRequest)))
    answer = {
        "finished": finished,
        "machine": platform.machine(),
        "passed": len(run.state.guidance.passed),
        "points": len(points),
        "cross_track_rms_m": tracking(track, points)["cross_track_rms_m"],
        "t_s": track.t_s.tolist(),
        "truth": track.truth.tolist(),
    }
    (folder / "mission.json").write_bytes(msgspec.json.encode(answer))


def plan(folder: Path) -> None:
    """Plans and trajectories by both ways."""
    requests = msgspec.json.decode((folder / "requests.json").read_bytes(), type=list[SolveRequest])
    out: dict[str, Any] = {}
    for name, compiler in (("compiled", compile_loops), ("interpreted", None)):
        out[f"plans_{name}"] = np.array(answered(requests, compiler))
        out[f"motion_{name}"] = motion(compiled=compiler is not None)
    np.savez(folder / "plans.npz", **out)


def answered(requests: list[SolveRequest], compiler: Any) -> list[Any]:
    """Forces of the plan to each request, each solve from the plan before it; as many iterations by either way."""
    setup = load_setup(ROOT / "deploy/aritra.toml").pilot
    settings = replace(setup.nmpc, interpreted_iterations=setup.nmpc.iterations)
    model, actuation = StructuredModel.of(setup.vessel), Actuation.of(setup.vessel)
    nmpc = Nmpc(model, actuation, settings, lambda: 0.0, setup.fence, compiler)
    warm, plans = None, []
    for request in requests:
        result, warm = nmpc.solve(request, warm)
        plans.append(result.f_n)
    return plans


def motion(compiled: bool) -> np.ndarray:
    """States of boats under random pulses."""
    vessel = load_setup(ROOT / "deploy/aritra.toml").pilot.vessel
    rng = np.random.default_rng(2)
    pulses = np.repeat(rng.uniform(1300.0, 1700.0, (BOATS, STEPS // 100, 4)), 100, axis=1)
    result = simulate(vessel, np.zeros(6), pulses, STEP_S, machine_code=compiled)
    if bool(result.why_interpreted) == compiled:
        raise SystemExit(f"asked for machine code: {compiled}, got: {result.why_interpreted or 'machine code'}")
    return np.asarray(result.x)


if __name__ == "__main__":
    {"drive": drive, "plan": plan}[sys.argv[1]](Path(sys.argv[2]))
