"""An excitation flown by the boat's own program in the simulated world, on the stepped clock, links as real bytes.

The logs are like a boat's: run.mcap as `aritra run` writes it, truth.mcap as `aritra sim` does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from companion.boat.load_run import RunSetup
from companion.boat.recorder import Recorder
from companion.core.excitation.pen import Pen
from companion.core.messages import Alert, ExcitationStatus, GroundTruth, Message, SolveRequest
from companion.core.pilot.pilot import Pilot
from companion.logs.metadata import log_metadata
from sim.world.stepped import SteppedRun
from sim.world.world import World, WorldSetup

LIMIT_S = 7200.0
PER_SAY_S = 10.0
AFTER_S = 1.0
"""Neutral at the end of the log."""


@dataclass(frozen=True)
class FlownExcitation:
    """One flight: all messages, its ending as text, least distance of the true boat from the fence [m]."""

    messages: tuple[Message, ...]
    done: bool
    ending: str
    least_clearance_m: float
    statuses: tuple[ExcitationStatus, ...]
    truths: tuple[GroundTruth, ...]

    @property
    def duration_s(self) -> float:
        """Duration of the excitation [s], from its first tick to its last."""
        return (self.statuses[-1].t_ns - self.statuses[0].t_ns) * 1e-9 if self.statuses else 0.0


def fly(
    setup: RunSetup, world: WorldSetup, seed: int, say: Callable[[str], None] = lambda _: None, limit_s: float = LIMIT_S
) -> FlownExcitation:
    """Fly the setup's excitation in `world` until it is over or the boat has stopped for good."""
    run = SteppedRun(World(world, seed), Pilot(setup.pilot), _no_plan, begin="excite")
    next_ns, started = 0, False

    def over(run: SteppedRun) -> bool:
        nonlocal next_ns, started
        helm = run.state.helm
        started = started or helm.driving
        if run.world.t_ns >= next_ns:
            next_ns = run.world.t_ns + round(PER_SAY_S * 1e9)
            say(f"{run.world.t_ns * 1e-9:.0f} s")
        return started and helm.mode in ("idle", "safe")

    run.run(over, limit_s)
    ending = run.state.helm.why if started else f"never began: {run.state.helm.why}"
    run.run(lambda _: False, AFTER_S)
    statuses, truths = tuple(run.of(ExcitationStatus)), tuple(run.of(GroundTruth))
    track = np.array([(m.north_m, m.east_m) for m in truths])
    clearance = float(Pen(setup.pilot.site).clearance(track).min())
    done = bool(statuses) and statuses[-1].phase == "done"
    return FlownExcitation(tuple(run.messages), done, ending, clearance, statuses, truths)


def _no_plan(request: SolveRequest, warm: Any) -> NoReturn:
    raise AssertionError(f"tick {request.index}: an excitation asks for no plan")


def notes(flown: FlownExcitation) -> list[Alert]:
    """The alerts of the boat's program."""
    return [m for m in flown.messages if isinstance(m, Alert)]


def write_logs(flown: FlownExcitation, setup: RunSetup, folder: Path) -> tuple[Path, Path]:
    """run.mcap and truth.mcap into `folder`. Raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    run, truth = folder / "run.mcap", folder / "truth.mcap"
    metadata = log_metadata(setup.pilot.vessel.name, setup.files)
    last_ns = flown.messages[-1].t_ns
    for path, wanted in ((run, False), (truth, True)):
        path.unlink(missing_ok=True)
        files = {} if wanted else {name: text.encode() for name, text in setup.files.items()}
        with Recorder(
            path, metadata, lambda: last_ns, wall_offset_ns=0, attachments=files, background=False
        ) as recorder:
            for message in flown.messages:
                if isinstance(message, GroundTruth) == wanted:
                    recorder.record(message)
    return run, truth
