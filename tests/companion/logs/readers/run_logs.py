"""Logs for the tests of runs: a stepped simulation on disk, a clean synthetic run, dataflash and telemetry bytes."""

import struct
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import polars as pl

from companion.boat.load_run import EXAMPLES, load_setup
from companion.boat.recorder import Recorder
from companion.core.messages import Message, PlanResult
from companion.core.pilot.pilot import Pilot
from companion.logs.metadata import log_metadata
from companion.logs.runs.run import Run, RunMeta
from sim.world.stepped import SteppedRun
from sim.world.world import World, WorldSetup

BOOT_NS = 7_000_000_000
WALL_OFFSET_NS = 1_790_000_000_000_000_000


@cache
def simulated(seconds: float = 15.0, seed: int = 3) -> tuple[Message, ...]:
    """All messages of a boat whose plans are random thrusts that change every second."""
    setup, rng = load_setup(EXAMPLES / "aritra.toml"), np.random.default_rng(seed)

    def solve(request, f):
        f = rng.uniform(-12, 12, 4) if f is None or request.index % 10 == 0 else f
        rows = (tuple(map(float, f)),) * 3
        plan = PlanResult(
            t_ns=request.t_ns, index=request.index, status="ok", reason="", solve_time_s=1e-3, iterations=1,
            cost=1.0, f_n=rows, x=((0.0,) * 10,) * 4,
        )  # fmt: skip
        return plan, f

    world = World(WorldSetup(setup.pilot.vessel, setup.pilot.site, start=(15.0, 15.0, 0.5), boot_ns=BOOT_NS), seed)
    run = SteppedRun(world, Pilot(setup.pilot), solve)
    run.run(lambda _: False, seconds)
    return tuple(run.messages)


def record(path: Path, messages, *, files: bool = True, **changed: Callable[[str], str]) -> Path:
    """Write messages as `aritra run` does, with (or without) the configuration in the metadata.

    `changed`: what becomes of the text of a file, by its name without ending.
    """
    setup = load_setup(EXAMPLES / "aritra.toml")
    texts = {name: changed.get(Path(name).stem, str)(text) for name, text in setup.files.items()} if files else {}
    metadata = log_metadata(setup.pilot.vessel.name, texts)
    last = max((m.t_ns for m in messages), default=0)
    with Recorder(path, metadata, lambda: last, wall_offset_ns=WALL_OFFSET_NS, background=False) as recorder:
        for message in messages:
            recorder.record(message)
    return path


def clean_run(seconds: float = 60.0, seed: int = 5) -> Run:
    """A run without faults: IMU at 50 Hz, positions at 5 Hz, voltage at 1 Hz, a boat that turns and drives."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * 50)) / 50
    r = 0.3 * np.sin(0.4 * t) + 0.1
    psi = np.cumsum(r) / 50
    north, east = np.cumsum([0.5 * np.cos(psi) / 50, 0.5 * np.sin(psi) / 50], axis=1)
    slow, volt = np.arange(len(t)) % 10 == 0, np.arange(len(t)) % 50 == 0
    noise = rng.normal(size=(6, len(t)))
    table = {
        "t_s": t,
        "pwm_left": 1500 + 200 * np.sin(0.5 * np.floor(t * 10) / 10),
        "pwm_right": 1500 + 200 * np.cos(0.3 * np.floor(t * 10) / 10),
        "battery_v": np.repeat(15.6 - 1e-5 * np.flatnonzero(volt) + 0.01 * noise[5][volt], 50)[: len(t)],
        "psi_rad": (psi + 0.002 * noise[0] + np.pi) % (2 * np.pi) - np.pi,
        "r_rad_s": r + 0.005 * noise[1],
        "ax_m_s2": 0.05 * noise[2],
        "ay_m_s2": 0.05 * noise[3],
        "north_m": np.where(slow, 15 + north + 0.05 * noise[4], np.nan),
        "east_m": np.where(slow, 15 + east + 0.05 * noise[0], np.nan),
    }
    return Run(pl.DataFrame(table).fill_nan(None), RunMeta(vessel="synthetic", source="clean"))


# --- dataflash: format messages first, then records; the layout is ArduPilot's (AP_Logger/LogStructure.h) -----

_FORMATS = {  # name -> (id, format characters, struct codes, columns)
    "RCOU": (129, "QHHHHHHHHHHHHHH", "<Q14H", "TimeUS," + ",".join(f"C{i}" for i in range(1, 15))),
    "IMU": (130, "QBffffff", "<QB6f", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    "ATT": (131, "Qccc", "<Q3h", "TimeUS,Roll,Pitch,Yaw"),
    "BAT": (132, "QBf", "<QBf", "TimeUS,Instance,Volt"),
    "GPS": (133, "QBBIHLL", "<QBBIHii", "TimeUS,I,Status,GMS,GWk,Lat,Lng"),
    "RCO2": (136, "QHHHH", "<Q4H", "TimeUS,C15,C16,C17,C18"),
    "PARM": (135, "QNf", "<Q16sf", "TimeUS,Name,Value"),
    "BCN": (134, "QBBfffffff", "<QBB7f", "TimeUS,Health,Cnt,D0,D1,D2,D3,PosX,PosY,PosZ"),
}


def dataflash(records) -> bytes:
    """Bytes of a .BIN with `records`: (name, values in the units of the log's raw integers)."""
    head = b"\xa3\x95\x80"
    layout = "BBnNZ"
    out = head + struct.pack("<BB4s16s64s", 128, 89, b"FMT", layout.encode(), b"Type,Length,Name,Format,Columns")
    for name, (ident, characters, codes, columns) in _FORMATS.items():
        length = struct.calcsize(codes) + 3
        out += head + struct.pack("<BB4s16s64s", ident, length, name.encode(), characters.encode(), columns.encode())
    for name, *values in records:
        ident, _, codes, _ = _FORMATS[name]
        out += b"\xa3\x95" + bytes([ident]) + struct.pack(codes, *values)
    return out


def tlog(records) -> bytes:
    """Bytes of a .tlog: (stamp [us], frame) each."""
    return b"".join(struct.pack(">Q", t_us) + frame for t_us, frame in records)
