"""Boats that work every day in weather, and then foul: their missions on the stepped clock, as logs.

The pilot of every boat uses the same vessel file; the true boat is off it by up to 5 %. Weather is new each time:
current to 0.15 m/s, wind to 5 m/s with gusts, and where waves are asked for, 3 or 6 cm of them in half of the missions.
In three missions of ten there are NLOS and dropouts. Fouling comes during the tenth mission: at
its begin, or up to a minute later; in one case of five it grows from there over three missions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import numpy as np
from msgspec.structs import replace

from companion.boat.load_run import EXAMPLES, RunSetup, load_setup
from companion.boat.recorder import Recorder
from companion.core.configuration.vessel_file import VesselFile
from companion.core.control.nmpc import Actuation, Nmpc
from companion.core.messages import GroundTruth
from companion.core.model.manoeuvring import StructuredModel
from companion.core.pilot.pilot import Pilot
from companion.jit import CodeStore, compile_loops
from companion.logs.metadata import log_metadata
from sim.world.environment import Weather
from sim.world.plant import Plant, perturbed
from sim.world.sensors import UwbFaults
from sim.world.stepped import SteppedRun
from sim.world.world import STEP_NS, World, WorldSetup

MISMATCH = 0.05
UNCHANGED = 9
"""Missions before the fouling."""
RAMP = (0.4, 0.8, 1.0)
LIMIT_S, STATION_S, PATIENT_S = 240.0, 5.0, 60.0
MORNING_NS, DAY_NS = 1_790_000_000_000_000_000, 86_400_000_000_000
"""Wall clock of the first mission, and from one to the next."""


@dataclass(frozen=True)
class Fouling:
    """`what`: "drag" (all damping) or the name of a thruster; `size`: share more drag, or less thrust.

    `begins_s`: since the start of the tenth mission; `ramps`: grows over three missions.
    """

    what: str
    size: float
    begins_s: float
    ramps: bool

    def on(self, boat: VesselFile, share: float) -> VesselFile:
        """The boat with this share of it."""
        size = share * self.size
        if self.what == "drag":
            d = boat.damping
            more = {k: getattr(d, k) * (1 + size) for k in d.__struct_fields__ if k != "source"}
            return replace(boat, damping=replace(d, **more))
        fouled = (replace(t, gain=t.gain * (1 - size)) if t.name == self.what else t for t in boat.thrusters)
        return replace(boat, thrusters=tuple(fouled))


@cache
def _setup() -> RunSetup:
    return load_setup(EXAMPLES / "aritra.toml")


@cache
def _mind() -> tuple[RunSetup, Pilot, Nmpc]:
    setup = _setup()
    told = setup.pilot
    settings = replace(told.nmpc, rescue_time_s=PATIENT_S)
    compiler = partial(compile_loops, store=CodeStore.of())
    model, actuation = StructuredModel.of(told.vessel), Actuation.of(told.vessel)
    return setup, Pilot(told), Nmpc(model, actuation, settings, lambda: 0.0, told.fence, compiler)


def vessel() -> VesselFile:
    """The file that the pilot uses."""
    return _setup().pilot.vessel


def boat(seed: int) -> VesselFile:
    """The true boat of a seed."""
    return perturbed(vessel(), np.random.default_rng([seed, 5]), MISMATCH)


def fouling(seed: int) -> Fouling:
    """A fouling of its seed: drag 15 to 60 % more, or one thruster 10 to 40 % weaker, evenly."""
    rng = np.random.default_rng([seed, 6])
    names = [t.name for t in vessel().thrusters]
    what = "drag" if seed % 2 == 0 else names[int(rng.integers(len(names)))]
    size = float(rng.uniform(0.15, 0.60) if what == "drag" else rng.uniform(0.10, 0.40))
    return Fouling(what, size, float(rng.choice([0.0, rng.uniform(0, 60)])), bool(rng.random() < 0.2))


def mission(
    sound: VesselFile, number: int, seed: int, folder: Path, cause: Fouling | None = None, *, waves: bool = False
) -> Path:
    """The log of mission `number` (from 1) of a boat, with what has come over it by then."""
    path = folder / f"mission{number:02d}.mcap"
    rng = np.random.default_rng([seed, number])
    since = number - UNCHANGED - 1
    if cause is None or since < 0:
        return _driven(sound, sound, 0.0, number, rng, waves, path)
    shares = RAMP if cause.ramps else (1.0, 1.0, 1.0)
    now = cause.on(sound, shares[min(since, 2)])
    first, at_s = (sound, cause.begins_s) if since == 0 else (now, 0.0)
    return _driven(first, now, at_s, number, rng, waves, path)


def _driven(
    first: VesselFile, then: VesselFile, at_s: float, number: int, rng: np.random.Generator, waves: bool, path: Path
) -> Path:
    """One mission of a boat that is `first` and from `at_s` on `then`; its log."""
    setup, pilot, nmpc = _mind()
    weather = Weather(
        V_c_m_s=float(rng.uniform(0, 0.15)), beta_c_deg=float(rng.uniform(0, 360)),
        V_w_m_s=float(rng.uniform(0, 5)), beta_w_deg=float(rng.uniform(0, 360)), gustiness=0.3,
        H_s_m=float(rng.choice([0.0, 0.0, 0.03, 0.06])) * waves, T_p_s=float(rng.uniform(1.6, 2.6)),
    )  # fmt: skip
    faults = UwbFaults(dropout=0.1, nlos=0.05) if rng.random() < 0.3 else UwbFaults()
    north_m, east_m = rng.uniform(7.5, 8.5, 2).tolist()
    start = (north_m, east_m, float(rng.uniform(-0.6, 0.6)))
    volts = float(rng.uniform(15.0, 16.4))
    world = World(
        WorldSetup(first, setup.pilot.site, start=start, weather=weather, faults=faults, voltage_v=volts),
        int(rng.integers(2**31)),
    )
    run = SteppedRun(world, pilot, nmpc.solve)

    def over(run: SteppedRun) -> bool:
        if then is not first and run.world.t_ns >= at_s * 1e9 and world.plant is plant:
            world.plant = _another(then, plant)
        settled = run.state.guidance.settled_ns
        return run.state.guidance.phase == "done" and settled is not None and run.world.t_ns - settled > STATION_S * 1e9

    plant = world.plant
    run.run(over, LIMIT_S)
    _write(run, setup, number, path)
    return path


def _another(vessel: VesselFile, before: Plant) -> Plant:
    """The plant of another boat in the motion of `before`."""
    plant = Plant(vessel, before.motion.x, step_ns=STEP_NS, voltage_v=before.voltage_v, t_ns=before.motion.t_ns)
    plant.motion = before.motion
    return plant


def _write(run: SteppedRun, setup: RunSetup, number: int, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    last_ns, begin_ns = run.messages[-1].t_ns, MORNING_NS + number * DAY_NS
    metadata = log_metadata(setup.pilot.vessel.name, setup.files)
    with Recorder(path, metadata, lambda: last_ns, wall_offset_ns=begin_ns, background=False) as recorder:
        for message in run.messages:
            if not isinstance(message, GroundTruth):
                recorder.record(message)
