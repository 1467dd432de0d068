"""Who flies: the simulated boat on the stepped clock, or `aritra run` on the boat's own wires.

Either is given the files of one run (`files`: run.toml, vessel.toml, site.toml, a mission, and excitation.toml where an
excitation is to be flown) and leaves run.mcap in the folder, as far as it came.
"""

from __future__ import annotations

import contextlib
import signal
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NoReturn, Protocol

import numpy as np
from msgspec.structs import replace as replaced

from companion.boat.load_run import RunSetup, setup_of
from companion.boat.recorder import Recorder
from companion.core.control.nmpc import Actuation, Nmpc
from companion.core.excitation.pen import Pen
from companion.core.messages import ExcitationStatus, GroundTruth, GuidanceReference, SolveRequest
from companion.core.model.manoeuvring import StructuredModel
from companion.core.pilot.pilot import Pilot
from companion.jit import CodeStore, compile_loops
from companion.logs.log_file import LogError, LogFile
from companion.logs.metadata import log_metadata
from companion.python_child import aritra
from sim.commission.journal import LOG, TRUTH
from sim.world.stepped import SteppedRun
from sim.world.world import World, WorldSetup

STEP_S = 1.0
"""Between two looks of the simulated boat at its log, in simulated time."""
LIMIT_S = 900.0
"""Longest flight: an excitation of two minutes, or the mission, and the ways to them; assumed."""
STATION_S, ARRIVED = 10.0, ("station", "done")
"""How long a mission goes on at its end, and the phases of guidance that are its end."""
NEAR_M = 4.0
PATIENT_S = 60.0
"""Time of the controller's rescue where the clock is stepped: its iterations end it, on every computer alike."""
Say = Callable[[str], None]


@dataclass(frozen=True)
class Flown:
    """How a flight ended, in words; `done`: as it should."""

    done: bool
    ending: str


class Boat(Protocol):
    """Whoever can fly."""

    def fly(self, files: Mapping[str, str], folder: Path, say: Say) -> Flown:
        """Fly the excitation, or the mission where there is none; the log is left in `folder`."""
        ...


@dataclass(frozen=True)
class SimulatedBoat:
    """The boat `world` in the simulator. `seed`: of the first flight.

    Each flight begins where the last one ended; from nearer to the fence than `NEAR_M` somebody brings it to its start.
    """

    world: WorldSetup
    seed: int

    def fly(self, files: Mapping[str, str], folder: Path, say: Say) -> Flown:
        """See `Boat`."""
        setup = setup_of(files, {name: f"{folder / name}" for name in files})
        number = int(folder.name[:2])
        world = replace(self.world, start=self._start(folder.parent))
        excite = setup.pilot.excitation is not None
        pilot = Pilot(setup.pilot)
        solve = _no_plan if excite else _controller(setup).solve
        run = SteppedRun(World(world, 1000 * self.seed + number), pilot, solve, begin="excite" if excite else "start")
        with _Logs(folder, setup) as logs:
            started = False
            while run.world.t_ns < LIMIT_S * 1e9:
                run.run(lambda _run: False, STEP_S)
                logs.take(run)
                say(f"{run.world.t_ns * 1e-9:.0f} s")
                helm = run.state.helm
                started = started or helm.driving
                if started and (helm.mode in ("idle", "safe") or _settled(run)):
                    break
        done = _is_done(folder / LOG)
        why = run.state.helm.why if started else f"never began: {run.state.helm.why}"
        return Flown(done, "done" if done else why)

    def _start(self, flights: Path) -> tuple[float, float, float]:
        last = _last_place(flights)
        if last is None or float(Pen(self.world.site).clearance(np.array([last[:2]]))[0]) < NEAR_M:
            return self.world.start
        return last


@dataclass(frozen=True)
class RealBoat:
    """`aritra run` as a process of its own; it can be stopped as ever. `wires`: more words of its command line."""

    wires: tuple[str, ...] = ()

    def fly(self, files: Mapping[str, str], folder: Path, say: Say) -> Flown:
        """See `Boat`."""
        words = aritra("run", "--start", "--end-after", "2", *self.wires)
        words += ["--config", str(folder / "run.toml"), "--log", str(folder / LOG)]
        if "excitation.toml" in files:
            words += ["--excite", str(folder / "excitation.toml")]
        with subprocess.Popen(words) as process:
            try:
                code = process.wait(LIMIT_S)
            except subprocess.TimeoutExpired:  # a boat that cannot keep station never ends its mission by itself
                process.send_signal(signal.SIGINT)
                code = process.wait()
        done = _is_done(folder / LOG)
        ending = "done" if done else f"`aritra run` ended with exit code {code}: its last lines say why"
        return Flown(done, ending)


class _Logs:
    """run.mcap and truth.mcap of a stepped run, written as it goes."""

    def __init__(self, folder: Path, setup: RunSetup):
        self._seen, self._t_ns = 0, 0
        metadata = log_metadata(setup.pilot.vessel.name, setup.files)
        files = {name: text.encode() for name, text in setup.files.items()}
        make = partial(Recorder, metadata=metadata, now_ns=lambda: self._t_ns, wall_offset_ns=0, background=False)
        self._run, self._truth = make(folder / LOG, attachments=files), make(folder / TRUTH)

    def __enter__(self) -> _Logs:
        return self

    def __exit__(self, *_error: object) -> None:
        self._run.close()
        self._truth.close()

    def take(self, run: SteppedRun) -> None:
        """Record what is new, and put it on the disk."""
        new = run.messages[self._seen :]
        self._seen, self._t_ns = len(run.messages), run.world.t_ns
        for message in new:
            (self._truth if isinstance(message, GroundTruth) else self._run).record(message)
        self._run.sync()
        self._truth.sync()


def _settled(run: SteppedRun) -> bool:
    """Whether the mission has been over for a while; not every boat can keep station."""
    arrived = [m.t_ns for m in run.of(GuidanceReference)[-1:] if m.phase in ARRIVED]
    first = next((m.t_ns for m in run.of(GuidanceReference) if m.phase in ARRIVED), None) if arrived else None
    return first is not None and arrived[0] - first > STATION_S * 1e9


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


def _controller(setup: RunSetup) -> Nmpc:
    settings = setup.pilot
    model, actuation = StructuredModel.of(settings.vessel), Actuation.of(settings.vessel)
    patient = replaced(settings.nmpc, rescue_time_s=PATIENT_S)
    return Nmpc(model, actuation, patient, lambda: 0.0, settings.fence, partial(compile_loops, store=CodeStore.of()))


def _no_plan(request: SolveRequest, warm: Any) -> NoReturn:
    raise AssertionError(f"tick {request.index}: an excitation asks for no plan")


def _last_place(folder: Path) -> tuple[float, float, float] | None:
    """Where the simulated boat was last, by the truths of all flights; None before the first."""
    for path in sorted(folder.glob(f"*/{TRUTH}"), reverse=True):
        with contextlib.suppress(LogError):
            for truth in list(LogFile(path).messages(GroundTruth))[-1:]:
                if isinstance(truth, GroundTruth):
                    return truth.north_m, truth.east_m, truth.psi_rad
    return None
