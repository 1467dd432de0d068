"""Evidence for three holes in what the boat takes from files and from a ground station: the attacks, and what they get.

Damaged logs and logs that unpack to gigabytes; everything a station can send; numbers, anchors, waypoints and fences
that no boat can have. Each attack is made anew against the program as it is.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from random import Random

import numpy as np
from mcap.opcode import Opcode
from pymavlink.dialects.v20 import ardupilotmega as wire

from companion.boat.load_run import EXAMPLES, load_setup
from companion.core.configuration.tables import ConfigError
from companion.logs.log_file import LogError, LogFile
from companion.logs.recover import recover
from drivers.mavlink.gcs_firewall import GcsFirewall
from tests.companion.logs.page.page_logs import page_log
from tests.companion.logs.readers.run_logs import simulated
from tests.drivers.mavlink.mavlink_autopilot import Sender
from tests.evidence.line import Line, at_least, at_most, exactly, information
from tests.fault_lab.broken_logs import KINDS, bomb, chunk_of, damaged, headers, record_synced

DAMAGES = 200
"""Seeds 0 to 199, kinds in turn."""
DRIVEN_S, FULL_DRIVEN_S = 30.0, 60.0
GOAL_5_PERCENT, GOAL_WORST = 0.97, 0.90
"""Of the messages. A block of 4 kB, the largest damage, touches three chunks of a quarter of a second at most."""
BOMB_BYTES = 6_000_000_000
MOST_MB, MOST_S = 400.0, 30.0
"""A program that reads a log at all takes 0.1 GB and a second; the page of half a minute 10 s. Assumed, with room."""
S = 1_000_000_000


def damage(full: bool) -> Iterator[Line]:
    """Damaged logs: 200 damages of seven kinds to a log with an index, and to one cut off; --full: a minute's log"""
    with tempfile.TemporaryDirectory(prefix="aritra-") as name:
        folder = Path(name)
        sound = record_synced(folder / "sound.mcap", simulated(FULL_DRIVEN_S if full else DRIVEN_S)).read_bytes()
        starts = headers(sound)
        declared = starts[[i for i, at in enumerate(starts) if sound[at] == Opcode.CHUNK][2]]
        for what, whole, spared in (("with index", sound, 0), ("cut off", sound[: starts[-60]], declared)):
            shares, invented, refused = _damages(folder, whole, spared)
            note = f"{DAMAGES} damages, seeds 0 to {DAMAGES - 1}, {len(sound) / 1e6:.1f} MB"
            fifth = float(np.percentile(shares, 5))
            yield at_least(f"log {what}: messages kept, 5th percentile", fifth, GOAL_5_PERCENT, "", note)
            yield at_least("  worst", min(shares), GOAL_WORST)
            yield exactly("  messages that were never written", invented, 0)
            yield exactly("  logs that were refused", refused, 0)


def _damages(folder: Path, whole: bytes, spared: int) -> tuple[list[float], int, int]:
    """Shares of the messages kept, messages invented, logs refused. Bytes before `spared` stay: without an index
    nothing but the first chunks says what the channels are.
    """
    path, out = folder / "damaged.mcap", folder / "out.mcap"
    path.write_bytes(whole)
    written = {(e.topic, e.sequence): e.data for e in LogFile(path).entries()}
    records = [at - spared for at in headers_of(whole) if at >= spared]
    shares, invented, refused = [], 0, 0
    for seed in range(DAMAGES):
        kind = KINDS[seed % len(KINDS)]
        path.write_bytes(whole[:spared] + damaged(whole[spared:], kind, Random(seed), records))
        out.unlink(missing_ok=True)
        try:
            recover(path, out)
        except LogError:
            refused += 1
            shares.append(0.0)
            continue
        kept = [written.get((e.topic, e.sequence)) == e.data for e in LogFile(out).entries()]
        shares.append(sum(kept) / len(written))
        invented += kept.count(False)
    return shares, invented, refused


def headers_of(whole: bytes) -> list[int]:
    """Where the records begin in a log that may be cut off at a record's end."""
    return [at for at in headers(whole + bytes(8)) if at < len(whole)]


def bombs(full: bool) -> Iterator[Line]:
    """Logs that unpack to 6 GB, as they say or not, alone and in a real log: what info, recover and page take"""
    with tempfile.TemporaryDirectory(prefix="aritra-") as name:
        folder = Path(name)
        alone, liar = bomb(folder / "alone.mcap", BOMB_BYTES), bomb(folder / "liar.mcap", BOMB_BYTES, says=1000)
        many = bomb(folder / "many.mcap", 15_000_000, chunks=400)
        real = page_log(folder)
        data = real.read_bytes()
        place = next(at for at in headers(data) if data[at] == Opcode.CHUNK)
        real.write_bytes(data[:place] + chunk_of(alone) + data[place:])
        yield information("the bomb", alone.stat().st_size / 1e3, "kB", f"unpacks to {BOMB_BYTES / 1e9:g} GB")
        for path, commands in ((alone, ("info", "recover")), (liar, ("info",)), (many, ("info",)), (real, COMMANDS)):
            for command in commands:
                seconds, peak_mb, code, told = _run(command, path)
                yield at_most(f"{path.stem}: {command}: memory", peak_mb, MOST_MB, "MB")
                yield at_most("  time", seconds, MOST_S, "s")
                wholly = code == 1 and str(path) in told and "at byte " in told
                yield exactly("  exit code 1, and file and byte are told", wholly, 1)


COMMANDS = ("info", "recover", "page")


def _run(command: str, path: Path) -> tuple[float, float, int, str]:
    """Seconds, peak memory [MB], exit code and output of `aritra log COMMAND`."""
    out = [] if command == "info" else ["-o", str(path.with_suffix(f".{command}"))]
    asked = [sys.executable, "-m", "companion", "log", command, str(path), *out]
    if command == "page":
        asked.append("--no-ghosts")
    begun = time.monotonic()
    with subprocess.Popen(
        asked, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env={**os.environ, "COLUMNS": "1000"}
    ) as child:
        assert child.stdout
        told = child.stdout.read().decode()
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
    return time.monotonic() - begun, used.ru_maxrss / 1024, child.returncode, told


BY_COMMAND = ("COMMAND_LONG", "COMMAND_INT")
"""Types that are judged by the command in them."""


def station(full: bool) -> Iterator[Line]:
    """Ground station: every message of the dialect and all 65536 commands, twice, while armed and while disarmed"""
    mav = Sender(system=255, component=190)
    attacks = {
        "calibration of gyro": mav.command_long(1, 1, 241, 0, 1, 0, 0, 0, 0, 0, 0),
        "calibration of compass": mav.command_long(1, 1, 42424, 0, 0, 0, 0, 0, 0, 0, 0),
        "restart of the gate script": mav.command_long(1, 1, 42701, 0, 3, 0, 0, 0, 0, 0, 0),
        "a bootloader": mav.command_long(1, 1, 42650, 0, 0, 0, 0, 0, 290876, 0, 0),
        "an auxiliary switch": mav.command_long(1, 1, 218, 0, 31, 2, 0, 0, 0, 0, 0),
        "arming past the checks": mav.command_long(1, 1, 400, 0, 1, 2989, 0, 0, 0, 0, 0),
        "GPS_INPUT": _blank("GPS_INPUT"),
        "VISION_POSITION_ESTIMATE": _blank("VISION_POSITION_ESTIMATE"),
    }
    passed = [what for what, frame in attacks.items() if GcsFirewall(1).feed(frame, S, disarmed=False)]
    note = f"of {len(attacks)}: {', '.join(attacks)}"
    yield exactly("attacks that pass while armed", len(passed), 0, "", note)
    names = [kind.msgname for kind in wire.mavlink_map.values() if kind.msgname not in BY_COMMAND]
    for disarmed, types, commands in ((False, 17, 20), (True, 35, 37)):
        at_rest = "disarmed" if disarmed else "armed"
        found = [name for name in names if GcsFirewall(1).feed(_blank(name), S, disarmed=disarmed)]
        yield exactly(f"types that pass while {at_rest}", len(found), types, "", f"of {len(names)}")
        gate = GcsFirewall(1)
        for number in range(65536):
            first = 1.0 if number == wire.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN else 0.0
            gate.feed(mav.command_long(1, 1, number, 0, first, 0, 0, 0, 0, 0, 0), number * S, disarmed=disarmed)
        yield exactly(f"commands that pass while {at_rest}", gate.passed["COMMAND_LONG"], commands, "", "of 65536")
    disarm = mav.command_long(1, 1, 400, 0, 0, 21196, 0, 0, 0, 0, 0)
    wanted = (disarm, mav.set_mode(1, 1, 4), mav.param_request_list(1, 1))
    through = sum(bool(GcsFirewall(1).feed(frame, S, disarmed=False)) for frame in wanted)
    yield exactly("disarm, HOLD and reading parameters pass while armed", through, len(wanted))


def _blank(name: str) -> bytes:
    """A frame of a type with zeros in every field, from a ground station."""
    kind = next(kind for kind in wire.mavlink_map.values() if kind.msgname == name)
    head = wire.MAVLink_header(kind.id, mlen=kind.unpacker.size, srcSystem=255, srcComponent=190).pack()
    body = head[1:] + bytes(kind.unpacker.size)
    return head[:1] + body + wire.x25crc(body + bytes([kind.crc_extra])).crc.to_bytes(2, "little")


RUN, VESSEL, SITE, MISSION = "aritra.toml", "boats/aritra.toml", "sites/basin.toml", "missions/square.toml"
Change = Callable[[str], str]


def _ring(corners: int) -> str:
    angles = np.linspace(0, 2 * np.pi, corners, endpoint=False)
    return ", ".join(f"[{15 + 14 * np.cos(a):.6f}, {15 + 14 * np.sin(a):.6f}]" for a in angles)


def _fence(corners: int) -> Change:
    return lambda text: text.replace("[[0.5, 0.5], [29.5, 0.5], [29.5, 29.5], [0.5, 29.5]]", f"[{_ring(corners)}]")


def _put(old: str, new: str) -> Change:
    return lambda text: text.replace(old, new)


ABSURD: tuple[tuple[str, str, Change, str], ...] = (
    ("mass 1e-6 kg", VESSEL, _put("mass_kg = 45.0", "mass_kg = 1e-6"), "inertia.mass_kg: expected 0.1 to 100000"),
    ("mass 1e12 kg", VESSEL, _put("mass_kg = 45.0", "mass_kg = 1e12"), "inertia.mass_kg: expected 0.1 to 100000"),
    ("mass 5 t on 1.47 m", VESSEL, _put("mass_kg = 45.0", "mass_kg = 5000.0"), "inertia.mass_kg: expected 1.13 to 339"),
    ("force_max 0", VESSEL, _put("force_max_N = 38.0", "force_max_N = 0.0"), "thrusters[0].force_max_N: expected"),
    ("nominal voltage 1 mV", VESSEL, _put("nominal_voltage_V = 15.0", "nominal_voltage_V = 0.001"),
     "propulsion.nominal_voltage_V: expected 1 to 1000"),
    ("critical voltage 1.4 V", RUN, _put("critical_V = 13.2", "critical_V = 1.4"), "battery.critical_V: expected"),
    ("all anchors at one place", SITE, _put("_m = 30.0", "_m = 0.0"), "anchors[1]: '0CA8' stands where '1151' does"),
    ("a waypoint beyond the fence", MISSION, _put("21.0", "31.0"), "m beyond the fence"),
    ("a fence of 3,000 corners", SITE, _fence(3000), "fence: 3000 corners; expected at most 300"),
)  # fmt: skip
"""What, in which file, how, and the words of the refusal."""


def files(full: bool) -> Iterator[Line]:
    """Files: absurd numbers, anchors, waypoints and fences are refused by file and key; what is sound still loads"""
    for what, file, change, words in ABSURD:
        seconds, told = _load({file: change})
        yield exactly(f"{what}: refused with file and key", told is not None and file in told and words in told, 1)
        if "corners" in what:
            yield at_most("  after", seconds, 1.0, "s")
    seconds, told = _load({SITE: _fence(300)})
    yield at_most("a fence of 300 corners loads in", seconds if told is None else np.inf, 1.0, "s", told or "")
    sound = [path for path in (EXAMPLES / RUN, EXAMPLES / "on-board.toml") if load_setup(path)]
    yield exactly("run files that come with the program and load", len(sound), 2)


def _load(changes: dict[str, Change]) -> tuple[float, str | None]:
    """Seconds that loading the example with some files changed takes, and the refusal; None: it loads."""
    with tempfile.TemporaryDirectory(prefix="aritra-") as name:
        folder = Path(name)
        for file in (RUN, VESSEL, SITE, MISSION):
            text = (EXAMPLES / file).read_text()
            changed = changes.get(file, str)(text)
            assert (changed != text) == (file in changes), f"{file}: the example does not say that any more"
            (folder / file).parent.mkdir(exist_ok=True)
            (folder / file).write_text(changed)
        begun = time.monotonic()
        try:
            load_setup(folder / RUN)
        except ConfigError as error:
            return time.monotonic() - begun, str(error)
        return time.monotonic() - begun, None


PARTS = (damage, bombs, station, files)
