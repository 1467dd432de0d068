"""Damage and bombs: what is whole is kept, wherever the damage is; what unpacks to too much is left out, and told."""

import gzip
from pathlib import Path
from random import Random

import polars as pl
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from companion.core.messages import Tick
from companion.logs.log_file import LogError, LogFile
from companion.logs.readers import table
from companion.logs.readers.table import read_parquet, write_run
from companion.logs.readers.text_table import csv_lines
from companion.logs.recover import recover
from companion.logs.runs.run import RunError
from companion.logs.unpack import MOST_CHUNK_BYTES, MOST_RATIO
from tests.companion.logs.readers.run_logs import clean_run
from tests.fault_lab.broken_logs import KINDS, bomb, damaged, headers, record_synced

CHUNK = 6
"""Opcode."""
CHUNK_TICKS, CHUNKS = 25, 40


@pytest.fixture(scope="module")
def sound_file(tmp_path_factory) -> Path:
    """A log of 40 chunks with 25 ticks each."""
    ticks = tuple(Tick(t_ns=10_000_000 * k, index=k) for k in range(CHUNK_TICKS * CHUNKS))
    return record_synced(tmp_path_factory.mktemp("sound") / "log.mcap", ticks)


@pytest.fixture
def sound(sound_file) -> bytes:
    return sound_file.read_bytes()


def declaring(data):
    """Where the chunk begins that says what the channel of ticks is: the second."""
    return [at for at in headers(data) if data[at] == CHUNK][1]


def indices(folder, data):
    path, out = folder / "x.mcap", folder / "out.mcap"
    path.write_bytes(data)
    out.unlink(missing_ok=True)
    report = recover(path, out)
    assert report.kept_bytes + report.lost_bytes == len(data)
    got = [m.index for m in LogFile(out).messages(Tick)]
    assert [m.index for m in LogFile(path).messages(Tick)] == got, "every reader keeps the same"
    return got, report


@settings(max_examples=120, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@example("bit", 2726, False)  # a chunk that says to hold ten more
@given(st.sampled_from([kind for kind in KINDS if kind != "cut out"]), st.integers(0, 1 << 30), st.booleans())
@pytest.mark.long
def test_one_damage_costs_what_it_touches(sound_file, tmp_path, kind, seed, indexed):
    """Without an index, too: the first chunk is spared then, as only it says what the channels are."""
    sound = sound_file.read_bytes()
    starts = headers(sound)
    whole = sound if indexed else sound[: starts[-12]]
    spared = 0 if indexed else starts[starts.index(declaring(sound)) + 1]
    records = [at - spared for at in starts if spared <= at < len(whole)]
    broken = whole[:spared] + damaged(whole[spared:], kind, Random(seed), records)
    got, _ = indices(tmp_path, broken)
    kept, before = set(got), indices(tmp_path, whole)[0]
    assert got == sorted(kept) and kept <= set(before), "nothing is invented, doubled or out of order"
    lost = len(before) - len(got)
    touched = 1 + 4096 // 200 if kind in ("overwritten", "zeros") else 1
    assert lost <= CHUNK_TICKS * touched


@pytest.mark.parametrize("byte", range(9))
def test_a_chunk_with_a_damaged_header_is_known_by_its_inner_lengths_and_checksum(sound, tmp_path, byte):
    starts = [at for at in headers(sound) if sound[at] == CHUNK]
    at = starts[5] + byte
    got, report = indices(tmp_path, sound[:at] + bytes([sound[at] ^ 0x55]) + sound[at + 1 :])
    assert got == list(range(CHUNK_TICKS * CHUNKS)), "nothing is lost"
    assert report.lost_bytes < 1000


def test_a_chunk_that_says_to_be_longer_than_an_index_can_be_is_left_out(sound, tmp_path):
    at = [at for at in headers(sound) if sound[at] == CHUNK][5]
    name = at + 9 + 8 + 8 + 8 + 4
    top = name + 4 + sound[name] + 7  # the highest byte of the length of what the chunk holds
    got, report = indices(tmp_path, sound[:top] + b"\xff" + sound[top + 1 :])
    assert len(got) == CHUNK_TICKS * (CHUNKS - 1) and len(report.damage) == 1


def test_a_damaged_first_byte_of_the_file_loses_nothing_but_the_magic(sound, tmp_path):
    got, report = indices(tmp_path, b"\0" + sound[1:])
    assert len(got) == CHUNK_TICKS * CHUNKS
    assert "damaged place(s) skipped" in report.damage[0] and "first bytes" in report.damage[0]


def test_bytes_cut_out_of_the_first_chunk_leave_the_rest(sound, tmp_path):
    """The index at the end stands elsewhere then than the footer says; what it repeats of the channels still counts."""
    chunk = declaring(sound)
    got, report = indices(tmp_path, sound[: chunk + 60] + sound[chunk + 90 :])
    assert got == list(range(CHUNK_TICKS, CHUNK_TICKS * CHUNKS))
    assert f"from byte {chunk}" in report.damage[0]


def test_an_attachment_with_a_wrong_checksum_is_left_out(drive_log):
    path = drive_log(2.0)
    data = path.read_bytes()
    at = data.rindex(b'name = "synthetic"')
    path.write_bytes(data[:at] + b"N" + data[at + 1 :])
    log = LogFile(path)
    assert "vessel.toml" not in log.attachments and "site.toml" in log.attachments
    assert len(list(log.messages(Tick))) == 20
    assert "ATTACHMENT" in log.damage[0]


@pytest.mark.parametrize(
    ("unpacked", "says", "words"),
    [
        (10 * MOST_CHUNK_BYTES, None, "would unpack to 167.8 MB; a chunk may have 16.78 MB"),
        (10 * MOST_CHUNK_BYTES, 1000, "unpacks to more than the 1000 bytes"),
        (1000, 5000, "unpacks to fewer than the 5000 bytes"),
    ],
)
def test_a_chunk_that_unpacks_to_too_much_is_left_out_with_its_place(tmp_path, unpacked, says, words):
    path = bomb(tmp_path / "bomb.mcap", unpacked, says)
    log = LogFile(path)
    assert list(log.entries()) == []
    assert str(path) in log.damage[0] and "at byte 25" in log.damage[0] and words in log.damage[0]


def test_many_chunks_get_no_more_together_than_the_file_s_size_allows(tmp_path):
    path = bomb(tmp_path / "many.mcap", MOST_CHUNK_BYTES - 100, chunks=30)
    log = LogFile(path)
    got = sum(len(entry.data) for entry in log.entries())
    assert 0 < got <= MOST_CHUNK_BYTES + MOST_RATIO * path.stat().st_size < 30 * MOST_CHUNK_BYTES
    assert "this file to more than" in log.damage[0] and "100 times its size" in log.damage[0]


def test_a_packed_table_is_unpacked_no_further_than_its_size_allows(tmp_path):
    path = tmp_path / "run.csv.gz"
    path.write_bytes(gzip.compress(bytes(60_000_000)))
    with pytest.raises(RunError, match=r"run\.csv\.gz: unpacks to more than 22\.\d+ MB"):
        csv_lines(path)


def test_a_parquet_table_of_too_many_numbers_is_refused_before_it_is_read(tmp_path, monkeypatch):
    path = tmp_path / "run.parquet"
    pl.DataFrame({"t_s": [0.0] * 1000, "u_m_s": [0.0] * 1000}).write_parquet(path)
    monkeypatch.setattr(table, "MOST_CELLS", 1999)
    with pytest.raises(RunError, match=r"run\.parquet: 2000 numbers; expected at most 1999"):
        read_parquet(path)


def test_a_parquet_table_with_a_damaged_footer_is_refused_by_name(tmp_path):
    """Polars panics over some of these, which is no Exception."""
    path = tmp_path / "run.parquet"
    write_run(clean_run(2.0), path)
    data, outcomes = path.read_bytes(), set()
    for at in range(len(data) - 1350, len(data) - 1150):
        for bit in (0x02, 0x80):
            path.write_bytes(data[:at] + bytes([data[at] ^ bit]) + data[at + 1 :])
            try:
                read_parquet(path)
            except RunError as error:
                outcomes.add(str(error).startswith(f"{path}: "))
    assert outcomes == {True}


def test_what_holds_no_record_is_no_log(tmp_path):
    path = tmp_path / "noise.mcap"
    path.write_bytes(Random(3).randbytes(200_000))
    with pytest.raises(LogError, match="not an MCAP log"):
        LogFile(path)
