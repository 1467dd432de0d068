"""`recover`: sound output, honest report."""

import pytest
from mcap.reader import make_reader

from companion.core.messages import Tick
from companion.logs.log_file import LogError, LogFile
from companion.logs.recover import recover


def test_a_cut_log_becomes_a_sound_indexed_one(drive_log, tmp_path):
    path = drive_log(20.0)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 2 // 3])
    whole = list(LogFile(path).messages())
    report = recover(path)
    out = tmp_path / "drive.recovered.mcap"
    assert report.out == str(out)
    with out.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == report.messages
        assert {a.name for a in reader.iter_attachments()} == {"vessel.toml", "site.toml"}
    log = LogFile(out)
    assert list(log.messages()) == whole
    assert not log.damage
    assert log.metadata == LogFile(path).metadata
    assert report.kept_bytes + report.lost_bytes == len(content) * 2 // 3
    assert 0 < report.lost_bytes < 80_000
    assert report.last_t_ns == max(message.t_ns for message in whole)
    assert report.last_log_time_ns is not None
    assert report.last_t_ns is not None
    assert report.last_log_time_ns - log.wall_offset_ns >= report.last_t_ns
    assert len(report.damage) == 1


def test_parts_are_joined_and_a_sound_log_loses_nothing(drive_log, tmp_path):
    path = drive_log(60.0, rotate_bytes=60_000)
    parts = len(LogFile(path).paths)
    assert parts > 2
    report = recover(path, tmp_path / "joined.mcap")
    assert (report.parts, report.lost_bytes, report.damage) == (parts, 0, [])
    joined = LogFile(tmp_path / "joined.mcap")
    assert len(joined.paths) == 1
    assert list(joined.messages()) == list(LogFile(path).messages())
    assert [m.index for m in joined.messages(Tick) if isinstance(m, Tick)] == list(range(600))


def test_an_existing_file_is_never_overwritten(drive_log, tmp_path):
    path = drive_log(1.0)
    out = tmp_path / "there.mcap"
    out.write_text("mine")
    with pytest.raises(LogError, match=r"there\.mcap"):
        recover(path, out)
    assert out.read_text() == "mine"


def test_an_interrupt_leaves_no_half_copy(drive_log, tmp_path, monkeypatch):
    path, out = drive_log(2.0), tmp_path / "sound.mcap"

    def interrupt(self):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr("companion.logs.part.LogPart.finish", interrupt)
        recover(path, out)
    assert not out.exists()
    assert recover(path, out).lost_bytes == 0


def test_a_missing_log_is_an_error_and_leaves_nothing(tmp_path):
    with pytest.raises(LogError, match=r"absent\.mcap"):
        recover(tmp_path / "absent.mcap")
    assert list(tmp_path.iterdir()) == []
