"""An excitation flown by the boat's own program in the simulated world, on the stepped clock, links as real bytes.

The logs are like a boat's: run.mcap as `aritra run` writes it, truth.mcap as `aritra sim` does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from companion.boat.load_run import RunSetup
from companion.core.messages import Alert, ExcitationStatus, GroundTruth, Message
from companion.core.pilot.pilot import Pilot
from sim.world.stepped import SteppedRun
from sim.world.stepped_controller import no_plan
from sim.world.stepped_logs import RUN, TRUTH, SteppedLogs
from sim.world.world import World, WorldSetup

LIMIT_S = 7200.0
PER_SAY_S = 10.0
AFTER_S = 1.0
"""Neutral at the end of the log."""


@dataclass(frozen=True)
class FlownExcitation:
    """One flight: what belongs into its logs, in order, each message with its simulated time [ns]; its ending as text;
    least distance of the true boat from the fence [m].
    """

    logged: tuple[tuple[Message, int], ...]
    done: bool
    ending: str
    least_clearance_m: float
    statuses: tuple[ExcitationStatus, ...]
    truths: tuple[GroundTruth, ...]

    @property
    def messages(self) -> tuple[Message, ...]:
        """All of `logged`, without the times."""
        return tuple(message for message, _ in self.logged)

    @property
    def duration_s(self) -> float:
        """Duration of the excitation [s], from its first tick to its last."""
        return (self.statuses[-1].t_ns - self.statuses[0].t_ns) * 1e-9 if self.statuses else 0.0


def fly(
    setup: RunSetup, world: WorldSetup, seed: int, say: Callable[[str], None] = lambda _: None, limit_s: float = LIMIT_S
) -> FlownExcitation:
    """Fly the setup's excitation in `world` until it is over or the boat has stopped for good."""
    logged: list[tuple[Message, int]] = []
    run = SteppedRun(
        World(world, seed), Pilot(setup.pilot), no_plan, begin="excite", record=lambda *told: logged.append(told)
    )
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
    clearance = float(setup.pilot.pen.clearance(track).min())
    done = bool(statuses) and statuses[-1].phase == "done"
    return FlownExcitation(tuple(logged), done, ending, clearance, statuses, truths)


def notes(flown: FlownExcitation) -> list[Alert]:
    """The alerts of the boat's program."""
    return [m for m in flown.messages if isinstance(m, Alert)]


def write_logs(flown: FlownExcitation, setup: RunSetup, folder: Path, begin_unix_ns: int) -> tuple[Path, Path]:
    """run.mcap and truth.mcap into `folder`, as if it had begun at `begin_unix_ns` (Unix time [ns]). Raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    run, truth = folder / RUN, folder / TRUTH
    for path in (run, truth):
        path.unlink(missing_ok=True)
    with SteppedLogs(folder, setup, begin_unix_ns) as logs:
        for message, t_ns in flown.logged:
            logs.record(message, t_ns)
    return run, truth
