"""Rotated logs with a damaged part: what every part repeats is taken from one that is sound."""

import shutil
from pathlib import Path

import pytest

from companion.core.messages import Tick
from companion.logs.log_file import LogError, LogFile
from companion.logs.recover import recover
from companion.logs.summary import summarise


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


def test_a_part_that_is_missing_is_told(drive_log, tmp_path):
    """What was in it was missing without a word."""
    path: Path = drive_log(60.0, rotate_bytes=60_000)
    paths = LogFile(path).paths
    whole = [tick.index for tick in LogFile(path).messages(Tick)]
    own = [{tick.index for tick in LogFile(path).messages(Tick)} for path in (alone(p, tmp_path) for p in paths)]
    paths[1].unlink()
    told = f"{paths[2]}: what comes before it (part 1 of the log) was not read"
    log = LogFile(path)
    assert [tick.index for tick in log.messages(Tick)] == [index for index in whole if index not in own[1]]
    assert log.damage == [told] and log.lacks_after is not None
    assert recover(path, tmp_path / "sound.mcap").damage == [told]


def test_messages_of_a_head_that_is_lost_are_missing(drive_log, tmp_path):
    part = LogFile(alone(LogFile(drive_log(60.0, rotate_bytes=60_000)).paths[1], tmp_path))
    (ticks,) = [topic for topic in summarise(part).topics if topic.topic == "/tick"]
    assert ticks.missing == next(part.messages(Tick)).index > 0


def alone(path, tmp_path):
    """A copy of one file of a log where no other is."""
    copy = tmp_path / "alone" / path.name / path.name
    copy.parent.mkdir(parents=True)
    return Path(shutil.copy(path, copy))


def test_a_part_of_another_run_is_left_out_and_told(drive_log, tmp_path):
    """An older log's `NAME.part1.mcap`, say: what was in it was joined to the log without a word."""
    path: Path = drive_log(60.0, rotate_bytes=60_000)
    first, second = LogFile(path).paths[:2]
    other = tmp_path / "other"
    other.mkdir()
    for file in (first, second):
        shutil.copy(file, other / file.name)
    shifted = (other / second.name).read_bytes()
    clock = LogFile(path).metadata["wall_offset_ns"].encode()
    (other / second.name).write_bytes(shifted.replace(clock, clock[:-3] + b"123", 1))
    log = LogFile(other / first.name)
    ticks = [tick.index for tick in log.messages(Tick)]
    assert ticks == [tick.index for tick in LogFile(alone(first, tmp_path)).messages(Tick)]
    assert log.damage == [
        f"{other / second.name}: is part of another run than drive.mcap: left out",
        f"{other / first.name}: the log goes on in another part, which is not here",
    ]
    assert recover(other / first.name, tmp_path / "sound.mcap").damage == log.damage


def test_a_part_whose_clock_has_a_damaged_digit_is_no_other_run(drive_log):
    path: Path = drive_log(60.0, rotate_bytes=60_000)
    log = LogFile(path)
    ticks, clock = list(log.messages(Tick)), log.metadata["wall_offset_ns"].encode()
    log.paths[1].write_bytes(log.paths[1].read_bytes().replace(clock, b"3" + clock[1:], 1))
    assert list(log.messages(Tick)) == ticks and not log.damage


def test_a_log_opened_by_a_later_part_says_so_and_goes_on(drive_log):
    path: Path = drive_log(60.0, rotate_bytes=60_000)
    paths = LogFile(path).paths
    log = LogFile(paths[2])
    assert log.paths == paths[2:]
    assert [tick.index for tick in log.messages(Tick)][-1] == 599
    assert log.damage == [f"{paths[2]}: what comes before it (parts 0 to 1 of the log) was not read"]


def test_a_log_of_which_no_part_can_be_read_is_refused_and_leaves_nothing(drive_log):
    path: Path = drive_log(60.0, rotate_bytes=60_000)
    paths = LogFile(path).paths
    for part in paths:
        part.write_bytes(b"")
    for attempt in (LogFile, recover):
        with pytest.raises(LogError, match=r"drive\.mcap: the file is empty"):
            attempt(path)
    assert set(path.parent.iterdir()) == set(paths)
