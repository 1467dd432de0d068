"""Readers under mutated bytes: valid inputs of each, broken at random from a seed, and what comes out.

    flip, insert, delete, splice, truncate, repeat, and for text: another number, another token

A case passes where the reader returns, or raises the error that it documents; anything else is kept by its kind
with the bytes that caused it. A case that takes over `CASE_S` counts as one that never ends.
"""

from __future__ import annotations

import contextlib
import io
import random
import re
import signal
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as wire

from companion.boat.load_run import EXAMPLES
from companion.core.configuration.run_file import load_run
from companion.core.configuration.site_file import load_site
from companion.core.configuration.tables import ConfigError
from companion.core.excitation.file import load_excitation
from companion.core.geometry.frames import Origin
from companion.core.guidance.missions import mission
from companion.core.model.load_vessel import load_vessel
from companion.core.preflight.parameter_file import parse_parameters
from companion.logs.log_file import LogError, LogFile
from companion.logs.readers.read_run import read_run
from companion.logs.readers.table import write_run
from companion.logs.runs.run import RunError
from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.encode import MavlinkEncoder
from drivers.mavlink.gcs_firewall import GcsFirewall
from drivers.mavlink.signing import EPOCH_NS, Signing, SigningKey
from drivers.mavlink.streams import WANTED_HZ
from drivers.uwb import CODECS, uwb_codec
from sim.campaign.file import load_campaign
from sim.world.uwb_tag import FORMATS, UwbTag
from sim.world.world import STEP_NS, World, WorldSetup
from tests.companion.logs.readers.run_logs import clean_run, dataflash, record, simulated, tlog
from tests.support.drive_fixture import START, setup

S = 1_000_000_000
CASE_S = 20
WALL_NS = EPOCH_NS + 12 * 365 * 86400 * S
NUMBERS = (b"nan", b"-inf", b"1e999", b"-1", b"0", b"18446744073709551616", b"1e-320", b"0x7f", b"9" * 400, b"-0.0")


class TookTooLongError(Exception):
    """A case that does not end."""


@dataclass
class Reader:
    """`make()` gives a fresh reader, which takes bytes; `seeds()`: valid ones; `documented`: what it may raise.

    `stream`: the reader lives on from case to case, as a codec on a wire does.
    """

    make: Callable[[], Callable[[bytes], None]]
    seeds: Callable[[], list[bytes]]
    documented: tuple[type[Exception], ...] = ()
    stream: bool = False
    text: bool = False


@dataclass
class Outcome:
    """Cases, bytes, documented errors, and first examples of what should not have been raised, by kind."""

    cases: int = 0
    size: int = 0
    raised: Counter[str] = field(default_factory=Counter)
    wrong: dict[str, bytes] = field(default_factory=dict)


def fuzz(name: str, size: int, seed: int) -> Outcome:
    """Give a reader `size` bytes of mutated input, drawn from `seed`."""
    reader, dice, out = READERS[name], random.Random(f"{name} {seed}"), Outcome()
    seeds, read = reader.seeds(), reader.make()
    for data in seeds:
        read(data)  # valid input passes: raises where it does not
    with _bounded(), contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        while out.size < size:
            data = mutated(dice, seeds, text=reader.text)
            out.cases, out.size = out.cases + 1, out.size + len(data)
            read = read if reader.stream else reader.make()
            signal.alarm(CASE_S)
            try:
                read(data)
            except reader.documented as error:
                out.raised[type(error).__name__] += 1
            except Exception as error:
                at = error.__traceback__
                while at and at.tb_next:
                    at = at.tb_next
                where = f"{Path(at.tb_frame.f_code.co_filename).name}:{at.tb_lineno}" if at else ""
                out.wrong.setdefault(f"{type(error).__name__} at {where}: {str(error)[:120]}", data)
                read = reader.make()
            finally:
                signal.alarm(0)
    return out


@contextlib.contextmanager
def _bounded():
    def late(*_):
        raise TookTooLongError(f"over {CASE_S} s")

    before = signal.signal(signal.SIGALRM, late)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def mutated(dice: random.Random, seeds: list[bytes], *, text: bool) -> bytes:
    """One of the seeds after one to eight changes; of text one to three, most of them whole numbers and words."""
    data = bytearray(dice.choice(seeds))
    for _ in range(dice.randint(1, 3 if text else 8)):
        at, length = dice.randrange(len(data) + 1), min(len(data), 1 << dice.randrange(9))
        change = dice.choice((6, 7)) if text and dice.random() < 0.7 else dice.randrange(6)
        if change == 0 and data:
            data[at % len(data)] ^= 1 << dice.randrange(8)
        elif change == 1:
            data[at:at] = dice.randbytes(dice.randint(1, 16))
        elif change == 2:
            del data[at : at + length]
        elif change == 3:
            other = dice.choice(seeds)
            begin = dice.randrange(len(other))
            data[at : at + length] = other[begin : begin + length]
        elif change == 4:
            del data[max(at, len(data) // 4) :]
        elif change == 5:
            data[at:at] = bytes(data[at : at + length]) * dice.randint(1, 8)
        elif tokens := list(re.finditer(rb"-?\d[\d.e+-]*" if change == 6 else rb"\w+", data)):
            token = dice.choice(tokens)
            data[slice(*token.span())] = dice.choice(NUMBERS) if change == 6 else dice.choice(tokens)[0]
    return bytes(data)


# --- what valid inputs are ---------------------------------------------------------------------------------


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
              encoder.set_mode(4), encoder.param_set("FS_ACTION", 5.0), encoder.param_request_list(),
              encoder.timesync(0, 9), encoder.global_origin(63, 10), encoder.command_long(183, 1, 1900)]  # fmt: skip
    more = (wire.MAVLink_manual_control_message(1, 0, 1, 2, 3, 4),
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


def _files(*patterns: str) -> list[bytes]:
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


# --- how they are read -------------------------------------------------------------------------------------


def _codec(made) -> Callable[[bytes], None]:
    """Chunks of any size, as a wire gives them, at a clock that runs."""
    state = [S]

    def read(data: bytes) -> None:
        for at in range(0, len(data), 97):
            state[0] += 5_000_000
            made(data[at : at + 97], state[0])

    return read


def _signing() -> Signing:
    return Signing(SigningKey(bytes(range(7, 39))), lambda: WALL_NS, key_name="boat.key")


def _signed() -> list[bytes]:
    mav = wire.MAVLink(None, srcSystem=1, srcComponent=1)
    signing, out = _signing(), []
    signing.equip(mav)
    for m in wire.MAVLink(None).parse_buffer(telemetry()) or []:
        signing.stamp(mav)
        out.append(bytes(m.pack(mav)))
    return _slices(b"".join(out))


def _slices(data: bytes, size: int = 4000) -> list[bytes]:
    return [data[at : at + size] for at in range(0, len(data), size)]


def _station() -> Callable[[bytes], None]:
    gate, state = GcsFirewall(1), [S]

    def read(data: bytes) -> None:
        for at in range(0, len(data), 97):
            state[0] += 40_000_000  # within what a ground station may send
            gate.feed(data[at : at + 97], state[0], disarmed=bool(at % 2))

    return read


def _text(parse: Callable[[str], object]) -> Callable[[], Callable[[bytes], None]]:
    """As the program reads text: what is not UTF-8 is refused before it comes here."""

    def read(data: bytes) -> None:
        parse(data.decode(errors="replace"))

    return lambda: read


def _mission(kind) -> Callable[[], Callable[[bytes], None]]:
    return _text(lambda text: mission.parse(text, kind, origin=Origin(12.9915, 80.2337, 0.0)))


def _log(kind: str) -> Callable[[], Callable[[bytes], None]]:
    def read(data: bytes) -> None:
        with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as folder:
            path = Path(folder) / f"a.{kind}"
            path.write_bytes(data)
            if kind == "mcap":
                log = LogFile(path)
                for _ in log.messages():
                    pass
            read_run(path)

    return lambda: read


def _uwb_reader(kind: str) -> Reader:
    return Reader(lambda: _codec(uwb_codec(kind, "tag", 4.0).feed), lambda: uwb_lines(kind), stream=True)


_CONFIG = (ConfigError,)
_LOGS = (RunError, LogError)
READERS: dict[str, Reader] = {
    "mavlink": Reader(lambda: _codec(MavlinkCodec().feed), lambda: _slices(telemetry()), stream=True),
    "mavlink, signed": Reader(lambda: _codec(MavlinkCodec(signing=_signing()).feed), _signed, stream=True),
    "ground station": Reader(_station, lambda: [station_frames()], stream=True),
    **{f"uwb {kind}": _uwb_reader(kind) for kind in CODECS},
    "vessel file": Reader(
        _text(lambda t: load_vessel(t, name="v")), lambda: _files("boats/*.toml"), _CONFIG, text=True
    ),
    "site file": Reader(_text(lambda t: load_site(t, name="s")), lambda: _files("sites/*.toml"), _CONFIG, text=True),
    "campaign file": Reader(
        _text(lambda t: load_campaign(t, name="c")), lambda: _files("campaigns/*.toml"), _CONFIG, text=True
    ),
    "run file": Reader(_text(lambda t: load_run(t, name="r")), lambda: _files("*.toml"), _CONFIG, text=True),
    "excitation file": Reader(
        _text(lambda t: load_excitation(t, name="e")), lambda: _files("excitations/*.toml"), _CONFIG, text=True
    ),
    **{
        f"mission .{kind}": Reader(
            _mission(kind), lambda kind=kind: _files(f"missions/*.{kind}"), (mission.MissionErrors,), text=True
        )
        for kind in ("toml", "plan", "waypoints", "geojson")
    },
    "parameter file": Reader(
        _text(lambda t: parse_parameters(t, name="p")), lambda: _files("ardupilot/*.param"), _CONFIG, text=True
    ),
    **{
        f"log .{kind}": Reader(_log(kind), lambda kind=kind: log_bytes(kind), _LOGS, text=kind == "csv")
        for kind in ("mcap", "bin", "tlog", "csv")
    },
}
"""Name -> reader."""
