"""Rotated logs with a damaged part: what every part repeats is taken from one that is sound."""

from pathlib import Path

import pytest

from companion.core.messages import Tick
from companion.logs.log_file import LogError, LogFile
from companion.logs.recover import recover


def head_lost(data: bytes) -> bytes:
    """One bit of a length in the metadata is wrong: they cannot be read."""
    at = data.index(b"config/site.toml") - 1
    return data[:at] + bytes([data[at] ^ 0x80]) + data[at + 1 :]


def site_moved(data: bytes) -> bytes:
    """One bit of a number in the metadata is wrong: they can be read, but are not what was written."""
    return data.replace(b"north_m = -2.0", b"north_m = -3.0", 1)


def name_lost(data: bytes) -> bytes:
    """One attachment cannot be read."""
    at = data.index(b"vessel.toml", data.index(b"text/plain") - 60)
    return data[:at] + b"\xff" + data[at + 1 :]


@pytest.mark.parametrize("damage", [head_lost, site_moved, name_lost])
def test_configuration_and_clock_are_those_of_a_sound_part(drive_log, tmp_path, damage):
    path: Path = drive_log(60.0, rotate_bytes=60_000)
    whole = LogFile(path)
    ticks = list(whole.messages(Tick))
    path.write_bytes(damage(path.read_bytes()))
    recover(path, tmp_path / "sound.mcap")
    for log in (LogFile(path), LogFile(tmp_path / "sound.mcap")):
        assert {**log.metadata, "part": "0"} == whole.metadata
        assert log.attachments == whole.attachments
        assert log.wall_offset_ns == whole.wall_offset_ns > 0
        assert list(log.messages(Tick)) == ticks


@pytest.mark.parametrize(("content", "reason"), [(b"", "the file is empty"), (b"nothing", "not an MCAP log")])
def test_a_first_part_that_cannot_be_read_is_damage_and_not_the_end(drive_log, tmp_path, content, reason):
    path: Path = drive_log(60.0, rotate_bytes=60_000)
    whole = LogFile(path)
    path.write_bytes(content)
    log = LogFile(path)
    ticks = [tick.index for tick in log.messages(Tick)]
    assert f"{path}: {reason}" in log.damage[0]
    assert {**log.metadata, "part": "0"} == whole.metadata
    report = recover(path, tmp_path / "sound.mcap")
    assert f"{path}: {reason}" in report.damage[0]
    assert (report.parts, report.lost_bytes) == (len(whole.paths), len(content))
    again = LogFile(tmp_path / "sound.mcap")
    assert [tick.index for tick in again.messages(Tick)] == ticks
    assert ticks and ticks[-1] == 599 and 0 < ticks[0] < 300


def test_a_log_of_which_no_part_can_be_read_is_refused_and_leaves_nothing(drive_log):
    path: Path = drive_log(60.0, rotate_bytes=60_000)
    paths = LogFile(path).paths
    for part in paths:
        part.write_bytes(b"")
    for attempt in (LogFile, recover):
        with pytest.raises(LogError, match=r"drive\.mcap: the file is empty"):
            attempt(path)
    assert set(path.parent.iterdir()) == set(paths)
