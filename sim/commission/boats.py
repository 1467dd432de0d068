"""Who flies: the simulated boat on the stepped clock, or `aritra run` on the boat's own wires.

Either is given the files of one run (`files`: run.toml, vessel.toml, site.toml, a mission, and excitation.toml where an
excitation is to be flown) and leaves run.mcap in the folder, as far as it came.
"""

from __future__ import annotations

import contextlib
import signal
import subprocess
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from companion.boat.load_run import setup_of
from companion.core.configuration.tables import digest
from companion.core.excitation.pen import Pen
from companion.core.messages import Alert, ExcitationStatus, GroundTruth, GuidanceReference, ModeStatus
from companion.core.model.vessel_text import vessel_toml
from companion.core.pilot.order_expiry import has_expired
from companion.core.pilot.pilot import Pilot
from companion.logs.log_file import LogError, LogFile
from companion.python_child import dependent_aritra
from sim.commission.journal import LOG, REAL, number_of
from sim.world.stepped import SteppedRun, SteppedWorld
from sim.world.stepped_controller import no_plan, stepped_controller
from sim.world.stepped_logs import TRUTH, SteppedLogs
from sim.world.world import World, WorldSetup

STEP_S = 1.0
"""Between two looks of the simulated boat at its log, in simulated time."""
LIMIT_S = 900.0
"""Longest flight: an excitation of two minutes, or the mission, and the ways to them; assumed."""
STATION_S, ARRIVED = 10.0, ("station", "done")
"""How long a mission goes on at its end, and the phases of guidance that are its end."""
ORDERS = ("start", "excite")
"""By which a flight begins."""
NEAR_M = 4.0
"""Clearance from which on somebody brings the simulated boat back; assumed."""
Say = Callable[[str], None]
Worlds = Callable[[WorldSetup, int], AbstractContextManager[SteppedWorld]]
"""A world for one flight, by its setup and seed."""


def simulated_world(setup: WorldSetup, seed: int) -> AbstractContextManager[SteppedWorld]:
    """The world with the simulated autopilot."""
    return contextlib.nullcontext(World(setup, seed))


@dataclass(frozen=True)
class Flown:
    """How a flight ended, in words; `done`: it came to its end."""

    done: bool
    ending: str


class Boat(Protocol):
    """Whoever can fly."""

    def fly(self, files: Mapping[str, str], folder: Path, say: Say) -> Flown:
        """Fly the excitation, or the mission where there is none; the log is left in `folder`."""
        ...

    def goes_on(self, ending: str) -> bool:
        """Whether another flight may begin after one that was not done, `ending` in words: somebody has looked."""
        ...


@dataclass(frozen=True)
class SimulatedBoat:
    """The boat `world` in the simulator. `seed`: of the first flight. `worlds`: with which autopilot.

    Each flight begins where the last one ended; from nearer to the fence than `NEAR_M` somebody brings it to its start.
    """

    world: WorldSetup
    seed: int
    worlds: Worlds = simulated_world

    @property
    def name(self) -> str:
        """Which boat and world a folder is about."""
        return f"a simulated boat ({digest(vessel_toml(self.world.vessel) + repr(self.world.weather))})"

    def fly(self, files: Mapping[str, str], folder: Path, say: Say) -> Flown:
        """See `Boat`."""
        setup = setup_of(files, {name: f"{folder / name}" for name in files})
        number = number_of(folder)
        here = replace(self.world, start=self._start(folder.parent, setup.pilot.pen))
        excite = setup.pilot.excitation is not None
        pilot = Pilot(setup.pilot)
        solve = no_plan if excite else stepped_controller(setup.pilot).solve
        begin = "excite" if excite else "start"
        with (
            SteppedLogs(folder, setup, time.time_ns()) as logs,
            self.worlds(here, 1000 * self.seed + number) as world,
        ):
            run = SteppedRun(world, pilot, solve, begin, logs.record)
            started = False
            while run.world.t_ns < LIMIT_S * 1e9:
                run.run(lambda _run: False, STEP_S)
                logs.sync()
                say(f"{run.world.t_ns * 1e-9:.0f} s")
                helm = run.state.helm
                started = started or helm.driving
                if started and (helm.mode in ("idle", "safe") or _settled(run)):
                    break
        done = _is_done(folder / LOG)
        why = run.state.helm.why if started else f"never began: {run.state.helm.why}"
        return Flown(done, "done" if done else why)

    def goes_on(self, ending: str) -> bool:
        """Always: somebody is there, brings it back where that is needed, and goes on."""
        return True

    def _start(self, flights: Path, pen: Pen) -> tuple[float, float, float]:
        last = _last_place(flights)
        if last is None or float(pen.clearance(np.array([last[:2]]))[0]) < NEAR_M:
            return self.world.start
        return last


@dataclass(frozen=True)
class RealBoat:
    """`aritra run` as a process of its own; it can be stopped as ever. `wires`: more words of its command line.

    `ask`: a person, told how the flight ended, whether to go on. A boat that was stopped, or has stopped itself, does
    not move again because the next flight begins. `warn`: returns as thrusters may turn.
    """

    wires: tuple[str, ...] = ()
    ask: Callable[[str], bool] = lambda _ending: False
    warn: Callable[[], None] = lambda: None

    @property
    def name(self) -> str:
        """Which boat a folder is about."""
        return REAL

    def fly(self, files: Mapping[str, str], folder: Path, say: Say) -> Flown:
        """See `Boat`."""
        words = dependent_aritra("run", "--start", "--end-after", "2", *self.wires)
        words += ["--config", str(folder / "run.toml"), "--log", str(folder / LOG)]
        if "excitation.toml" in files:
            words += ["--excite", str(folder / "excitation.toml")]
        self.warn()
        with subprocess.Popen(words) as process:
            try:
                code = process.wait(LIMIT_S)
            except subprocess.TimeoutExpired:  # a boat that cannot keep station never ends its mission by itself
                process.send_signal(signal.SIGINT)
                code = process.wait()
            except BaseException:  # we are to end: the boat does not go on without us
                process.terminate()
                process.wait()
                raise
        if _is_done(folder / LOG):
            return Flown(True, "done")
        ended = f"`aritra run` ended with exit code {code}: its last lines say why"
        return Flown(False, last_reason(folder / LOG) or ended)

    def goes_on(self, ending: str) -> bool:
        """See `Boat`."""
        return self.ask(ending)


def _settled(run: SteppedRun) -> bool:
    """Whether the mission has been over for a while; not every boat can keep station."""
    references = run.of(GuidanceReference)
    first = next((m for m in references if m.phase in ARRIVED), None)
    return first is not None and references[-1].phase in ARRIVED and _since_s(first, references[-1]) > STATION_S


def _since_s(first: GuidanceReference, last: GuidanceReference) -> float:
    return (last.t_ns - first.t_ns) * 1e-9


def _is_done(log: Path) -> bool:
    """Whether the excitation of a log came to its end, or its mission to its last waypoint."""
    flown, guided = [""], [""]
    with contextlib.suppress(LogError):
        for message in LogFile(log).messages(ExcitationStatus, GuidanceReference):
            if isinstance(message, ExcitationStatus):
                flown.append(message.phase)
            elif isinstance(message, GuidanceReference):
                guided.append(message.phase)
    return flown[-1] == "done" or (len(flown) == 1 and guided[-1] in ARRIVED)


def last_reason(log: Path) -> str:
    """Mode at the end of a log, and why, or that the order to begin has expired; empty where it cannot be read."""
    last, expired = "", ""
    with contextlib.suppress(LogError, OSError):
        for message in LogFile(log).messages(Alert, ModeStatus):
            if isinstance(message, ModeStatus):
                last = f"{message.mode}: {message.why}"
                expired = expired if message.mode == "idle" else ""
            elif isinstance(message, Alert) and any(has_expired(order, message.text) for order in ORDERS):
                expired = message.text
    return expired or last


def _last_place(folder: Path) -> tuple[float, float, float] | None:
    """Where the simulated boat was last, by the truths of all flights; None before the first."""
    for path in sorted(folder.glob(f"*/{TRUTH}"), reverse=True):
        with contextlib.suppress(LogError):
            for truth in list(LogFile(path).messages(GroundTruth))[-1:]:
                if isinstance(truth, GroundTruth):
                    return truth.north_m, truth.east_m, truth.psi_rad
    return None
