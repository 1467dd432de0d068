"""Valid inputs of every reader: telemetry, frames of ground stations, tags, logs."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as wire

from companion.boat.load_run import EXAMPLES
from companion.logs.readers.table import write_run
from drivers.mavlink.encode import MavlinkEncoder
from drivers.mavlink.streams import WANTED_HZ
from drivers.uwb import uwb_codec
from sim.world.uwb_tag import FORMATS, UwbTag
from sim.world.world import STEP_NS, World, WorldSetup
from tests.companion.logs.readers.run_logs import clean_run, dataflash, record, simulated, tlog
from tests.support.drive_fixture import START, setup

S = 1_000_000_000


@cache
def telemetry(seconds: float = 12.0) -> bytes:
    """What the simulated autopilot sends when it is asked for our streams, after it was armed and told things."""
    told = setup().pilot
    world, encoder = World(WorldSetup(told.vessel, told.site, start=START), 5), MavlinkEncoder(1, 191, 1, 1)
    asked = [encoder.set_message_interval(name, hz) for name, hz in WANTED_HZ.items()]
    asked += [encoder.request_message("AUTOPILOT_VERSION"), encoder.param_request_read("SYSID_MYGCS"),
              encoder.timesync(0, 7), encoder.set_mode(5), encoder.arm()]  # fmt: skip
    out = [world.mavlink(data, "boat") for data in asked]
    for _ in range(round(seconds * S / STEP_NS)):
        out += [data for _, data in world.step().mavlink]
    return b"".join(out)


@cache
def station_frames() -> bytes:
    """What a ground station may send, good and refused."""
    encoder = MavlinkEncoder(255, 190, 1, 1)
    mav = wire.MAVLink(None, srcSystem=255)
    frames = [encoder.heartbeat(), encoder.neutral((9, 10, 11, 12)), encoder.arm(), encoder.disarm(),
              encoder.set_mode(4),
              encoder.timesync(0, 9), encoder.global_origin(63, 10), encoder.command_long(183, 1, 1900)]  # fmt: skip
    more = (wire.MAVLink_param_set_message(1, 1, b"FS_ACTION", 5.0, 9), wire.MAVLink_param_request_list_message(1, 1),
            wire.MAVLink_manual_control_message(1, 0, 1, 2, 3, 4),
            wire.MAVLink_setup_signing_message(1, 1, [1] * 32, 5),
            wire.MAVLink_vision_position_estimate_message(1, 1.0, 2.0, 0.0, 0.0, 0.0, 0.5, [0.0] * 21, 0))  # fmt: skip
    return b"".join([*frames, *(bytes(m.pack(mav)) for m in more)] * 4)


def uwb_lines(kind: str) -> list[bytes]:
    """What tags of every variant of a wire format send."""
    found = []
    for variant in (v for v, codec in FORMATS.items() if codec == kind):
        ids = {"dwm1001": ("1A2B", "90C4", "0F31"), "makerfabs": ("1", "2", "A3")}.get(
            kind.split("-", maxsplit=1)[0], ("0", "1", "2")
        )
        anchors = {name: (10.0 * i, 8.0 * (i % 2), 2.0) for i, name in enumerate(ids)}
        tag = UwbTag(variant, anchors=anchors, rate_hz=4.0, streaming=True)
        ranges = dict(zip(ids, (4.2, 7.125, None), strict=True))
        cycles = [tag.cycle(ranges, (1.5, 2.25, 0.3), k * S // 4) for k in range(8)]
        talk = uwb_codec(kind, "tag", 4.0)
        answers = [tag.receive(data, 0) for k in range(8) for data in [*talk.start_bytes(), *talk.step(k * S // 10)]]
        found += [b"".join(cycles), b"".join(answers + cycles)]
    return [data for data in found if data]


def example_files(*patterns: str) -> list[bytes]:
    return [path.read_bytes() for pattern in patterns for path in sorted(EXAMPLES.glob(pattern))]


@cache
def log_bytes(kind: str) -> list[bytes]:
    """A small valid log as `.mcap`, `.bin`, `.tlog` or `.csv`."""
    with tempfile.TemporaryDirectory() as folder:
        if kind == "mcap":
            messages = [m for m in simulated(8.0) if type(m).__name__ != "SolveRequest"]
            return [record(Path(folder) / "a.mcap", messages[-400:]).read_bytes()]
        if kind == "csv":
            write_run(clean_run(4.0), Path(folder) / "a.csv")
            return [(Path(folder) / "a.csv").read_bytes()]
    if kind == "bin":
        rows = []
        for k in range(200):
            t = 1_000_000 + 20_000 * k
            rows += [("IMU", t, 0, 0.0, 0.0, 0.1, 0.0, 0.0, -9.8), ("ATT", t, 1, 2, 30 * k % 36000),
                     ("RCOU", t, *[1500 + k] * 14)]  # fmt: skip
            if k % 10 == 0:
                rows += [("BAT", t, 0, 15.5), ("GPS", t, 0, 3, 1000 * k, 2300, 634000000 + k, 104000000 + k)]
        return [dataflash(rows)]
    frames = telemetry(6.0)
    mav = wire.MAVLink(None)
    found = mav.parse_buffer(frames) or []
    return [tlog([(1_700_000_000_000_000 + 5000 * k, bytes(m.get_msgbuf())) for k, m in enumerate(found)])]


def slices(data: bytes, size: int = 4000) -> list[bytes]:
    return [data[at : at + size] for at in range(0, len(data), size)]
