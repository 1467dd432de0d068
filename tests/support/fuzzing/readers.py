"""How the program reads every kind of bytes that come from outside, and the errors that it documents."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as wire

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
from companion.logs.runs.run import RunError
from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.gcs_firewall import GcsFirewall
from drivers.mavlink.signing import EPOCH_NS, Signing, SigningKey
from drivers.uwb import CODECS, uwb_codec
from sim.campaign.file import load_campaign
from tests.support.fuzzing.inputs import S, example_files, log_bytes, slices, station_frames, telemetry, uwb_lines

WALL_NS = EPOCH_NS + 12 * 365 * 86400 * S


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
    return slices(b"".join(out))


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
    "mavlink": Reader(lambda: _codec(MavlinkCodec().feed), lambda: slices(telemetry()), stream=True),
    "mavlink, signed": Reader(lambda: _codec(MavlinkCodec(signing=_signing()).feed), _signed, stream=True),
    "ground station": Reader(_station, lambda: [station_frames()], stream=True),
    **{f"uwb {kind}": _uwb_reader(kind) for kind in CODECS},
    "vessel file": Reader(
        _text(lambda t: load_vessel(t, name="v")), lambda: example_files("boats/*.toml"), _CONFIG, text=True
    ),
    "site file": Reader(
        _text(lambda t: load_site(t, name="s")), lambda: example_files("sites/*.toml"), _CONFIG, text=True
    ),
    "campaign file": Reader(
        _text(lambda t: load_campaign(t, name="c")), lambda: example_files("campaigns/*.toml"), _CONFIG, text=True
    ),
    "run file": Reader(_text(lambda t: load_run(t, name="r")), lambda: example_files("*.toml"), _CONFIG, text=True),
    "excitation file": Reader(
        _text(lambda t: load_excitation(t, name="e")), lambda: example_files("excitations/*.toml"), _CONFIG, text=True
    ),
    **{
        f"mission .{kind}": Reader(
            _mission(kind), lambda kind=kind: example_files(f"missions/*.{kind}"), (mission.MissionErrors,), text=True
        )
        for kind in ("toml", "plan", "waypoints", "geojson")
    },
    "parameter file": Reader(
        _text(lambda t: parse_parameters(t, name="p")), lambda: example_files("ardupilot/*.param"), _CONFIG, text=True
    ),
    **{
        f"log .{kind}": Reader(_log(kind), lambda kind=kind: log_bytes(kind), _LOGS, text=kind == "csv")
        for kind in ("mcap", "bin", "tlog", "csv")
    },
}
"""Name -> reader."""
