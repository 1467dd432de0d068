"""The recorder: what it writes, and what it does when the disk is full, slow, broken, or the process is killed."""

import errno
import os
import random
import signal
import subprocess
import threading
import time
import tracemalloc
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from mcap.reader import make_reader

import companion.boat.recorder as recorder_module
from companion.boat.recorder import Recorder
from companion.core.messages import Battery, OperatorCommand, Tick
from companion.logs.log_file import LogFile
from companion.logs.metadata import log_metadata
from companion.logs.part import log_parts
from companion.logs.recover import recover
from companion.logs.schema import RawBytes
from companion.logs.summary import summarise
from companion.python_child import python

OFFSET_NS = 1_700_000_000_000_000_000


def make(path: Path, now_ns, **options) -> Recorder:
    return Recorder(path, {"vessel": "test"}, now_ns, wall_offset_ns=OFFSET_NS, **options)


def ticks(log: LogFile) -> list[int]:
    return [message.index for message in log.messages(Tick) if isinstance(message, Tick)]


def test_an_independent_reader_finds_messages_times_metadata_and_attachments(tmp_path, step_clock):
    path = tmp_path / "log.mcap"
    with make(path, step_clock, attachments={"boat.toml": b"mass_kg = 1"}) as recorder:
        recorder.record(Battery(t_ns=step_clock.t_ns - 7, voltage_v=14.8))
        recorder.record_raw("uwb", "rx", b"\x00\xffles\r\n")
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        found = {channel.topic: (schema, channel, message) for schema, channel, message in reader.iter_messages()}
        (attachment,) = reader.iter_attachments()
        (metadata,) = reader.iter_metadata()
    schema, channel, message = found["/battery"]
    assert schema is not None
    assert (schema.name, schema.encoding, channel.message_encoding) == ("aritra.Battery", "jsonschema", "json")
    assert message.data == b'{"t_ns":4999999993,"voltage_v":14.8,"current_a":null,"remaining_percent":null}'
    assert message.log_time == OFFSET_NS + step_clock.t_ns
    assert message.publish_time == step_clock.t_ns - 7
    assert b'"direction":"rx","data":"AP9sZXMNCg=="' in found["/raw/uwb"][2].data
    assert (attachment.name, attachment.data) == ("boat.toml", b"mass_kg = 1")
    assert metadata.name == "aritra"
    assert metadata.metadata["wall_offset_ns"] == str(OFFSET_NS)


def test_metadata_tells_configuration_and_versions():
    metadata = log_metadata("aritra", {"boat.toml": "mass_kg = 1\n"})
    # by sha256sum
    assert metadata["config_sha256"] == "fbeea1ee8d6839573cbf4495cc8ebdf48c6968e428f14eee2eac184bc1ea6eaa"
    assert metadata["config/boat.toml"] == "mass_kg = 1\n"
    assert {"version", "git_revision", "python", "machine", "vessel"} <= metadata.keys()


CHILD = """
import sys, time
from pathlib import Path
from typing import Literal
from companion.core.messages import Tick
from companion.boat.recorder import Recorder
r = Recorder(Path(sys.argv[1]), {}, time.monotonic_ns, wall_offset_ns=0)
print("ready", flush=True)
i = 0
while True:
    for _ in range(10):
        r.record(Tick(t_ns=time.monotonic_ns(), index=i))
        i += 1
    time.sleep(0.02)
"""


@pytest.mark.alone
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_sigkill_loses_at_most_one_second(tmp_path, seed):
    path = tmp_path / "killed.mcap"
    with subprocess.Popen(python("-c", CHILD, path), stdout=subprocess.PIPE) as child:
        assert child.stdout is not None
        child.stdout.readline()
        time.sleep(random.Random(seed).uniform(1.2, 2.0))
        killed_ns = time.monotonic_ns()
        child.send_signal(signal.SIGKILL)
    report = recover(path)
    assert report.damage, "a killed recorder leaves no footer"
    assert report.last_t_ns is not None
    assert 0 <= killed_ns - report.last_t_ns <= 1e9
    log = LogFile(Path(report.out))
    indices = ticks(log)
    assert indices == list(range(len(indices)))  # nothing missing before the end
    assert not log.damage
    assert len(indices) > 100


def test_rotation_gives_sound_parts_that_read_as_one(tmp_path, step_clock):
    path = tmp_path / "long.mcap"
    with make(path, step_clock, background=False, rotate_bytes=20_000) as recorder:
        for index in range(6000):
            recorder.record(Tick(t_ns=step_clock.t_ns + index, index=index))
    parts = log_parts(path)
    assert len(parts) > 2
    for part in parts:
        with part.open("rb") as file:
            summary = make_reader(file, validate_crcs=True).get_summary()
        assert summary is not None
        assert summary.statistics is not None
    assert ticks(LogFile(path)) == list(range(6000))
    assert not recorder.lost


def test_memory_does_not_grow_with_the_length_of_a_log(tmp_path, step_clock):
    """A file's index, one entry for each chunk and channel, is in memory until the file ends."""

    def grown(name, rotate_bytes):
        kinds = [f"link{k}" for k in range(12)]
        with make(tmp_path / name, step_clock, background=False, rotate_bytes=rotate_bytes) as recorder:
            tracemalloc.start()
            held = []
            for n in range(600):
                for kind in kinds:
                    recorder.record_raw(kind, "rx", b"x")
                recorder.sync()
                if n in (100, 599):
                    held.append(tracemalloc.get_traced_memory()[0])
            tracemalloc.stop()
        return held[1] - held[0], len(log_parts(tmp_path / name))

    whole, one = grown("whole.mcap", 1 << 40)
    parted, many = grown("parted.mcap", 60_000)
    assert one == 1 and many > 4
    assert whole > 500_000 and parted < whole / 3, (whole, parted)


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EIO])
def test_a_disk_error_is_told_counted_and_survived(tmp_path, step_clock, monkeypatch, code):
    path = tmp_path / "full.mcap"
    broken = False

    def fsync(_: int) -> None:
        if broken:
            raise OSError(code, os.strerror(code))

    monkeypatch.setattr(os, "fsync", fsync)
    recorder = make(path, step_clock, background=False)
    recorder.record(Tick(t_ns=1, index=0))
    recorder.sync()
    assert recorder.problem is None
    broken = True
    recorder.record(Tick(t_ns=2, index=1))
    recorder.sync()
    assert recorder.problem is not None
    assert os.strerror(code) in recorder.problem
    assert recorder.lost == 1
    recorder.record(Tick(t_ns=3, index=2))  # waits in the queue for a better disk
    recorder.sync()
    broken = False
    step_clock.t_ns += int(recorder_module.RETRY_S * 1e9)
    recorder.sync()
    assert recorder.problem is None
    recorder.close()
    assert recorder.lost == 1
    # The failed batch had reached the file when fsync failed; whether it is kept is the disk's choice.
    assert [index for index in ticks(LogFile(path)) if index != 1] == [0, 2]


def test_a_disk_that_never_comes_back_costs_no_memory_and_leaves_no_stubs(tmp_path, step_clock, monkeypatch):
    monkeypatch.setattr(recorder_module, "MAX_QUEUED", 50)
    path = tmp_path / "gone.mcap"
    recorder = make(path, step_clock, background=False)
    monkeypatch.setattr(os, "fsync", _no_space)
    recorder.record(Tick(t_ns=1, index=0))
    recorder.sync()
    for index in range(1, 201):
        recorder.record(Tick(t_ns=1, index=index))
        step_clock.t_ns += 1_000_000_000
        recorder.sync()
    recorder.close()
    assert recorder.lost == 201
    assert recorder.problem is not None
    assert list(tmp_path.iterdir()) == [path]


def _no_space(_: int) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


LIMITED = """
import resource, sys
from pathlib import Path
from typing import Literal
from companion.core.messages import Tick
from companion.boat.recorder import Recorder
resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, 30_000))
now = [0]
with Recorder(Path(sys.argv[1]), {}, lambda: now[0], wall_offset_ns=0, background=False) as r:
    for i in range(20_000):
        r.record(Tick(t_ns=i, index=i))
        now[0] += 10_000_000
print(r.lost, r.problem)
"""


def test_the_kernel_refusing_to_write_ends_one_part_and_the_next_goes_on(tmp_path):
    path = tmp_path / "limited.mcap"
    run = subprocess.run(python("-c", LIMITED, path), capture_output=True, text=True, check=True)
    lost = int(run.stdout.split()[0])
    assert lost > 0
    assert len(log_parts(path)) > 2
    log = LogFile(path)
    summary = summarise(log)
    (stats,) = (topic for topic in summary.topics if topic.topic == "/tick")
    assert 20_000 <= stats.messages + lost <= 20_000 + recorder_module.INLINE_BATCH * len(log.paths)
    assert 0 < stats.missing <= lost  # the sequence numbers tell; what is lost at the end leaves no gap
    assert summary.damage


def test_a_hanging_disk_never_holds_the_caller(tmp_path, monkeypatch):
    monkeypatch.setattr(recorder_module, "MAX_QUEUED", 100)
    recorder = make(tmp_path / "hang.mcap", time.monotonic_ns)
    go = threading.Event()
    monkeypatch.setattr(os, "fsync", lambda _: go.wait(10))
    start = time.monotonic()
    while time.monotonic() - start < 0.6:
        recorder.record(Tick(t_ns=1, index=0))
        time.sleep(0.001)
    assert recorder.lost > 0
    assert recorder.problem is not None
    assert "keep up" in recorder.problem
    go.set()
    recorder.close()
    summary = summarise(LogFile(tmp_path / "hang.mcap"))
    assert next(t.missing for t in summary.topics if t.topic == "/tick") <= recorder.lost


def test_a_disk_that_hangs_is_told_while_it_hangs_and_every_time(tmp_path, monkeypatch):
    """Long before the queue is full: a write that has not come back is enough."""
    monkeypatch.setattr(recorder_module, "HANG_S", 0.5)
    recorder = make(tmp_path / "hang.mcap", time.monotonic_ns)
    recorder.record(Tick(t_ns=1, index=0))
    assert recorder.problem is None
    sync, gates, told = os.fsync, [threading.Event() for _ in range(2)], []
    monkeypatch.setattr(os, "fsync", lambda fd: (next(g for g in gates if not g.is_set()).wait(10), sync(fd)))
    for gate in gates:
        start = time.monotonic()
        while not (recorder.problem and "hangs" in recorder.problem):
            assert time.monotonic() - start < 5.0
            recorder.record(Tick(t_ns=1, index=len(told)))
            time.sleep(0.01)
        told.append(recorder.problem)
        assert recorder.lost == 0
        gate.set()
        if gate is gates[-1]:
            monkeypatch.setattr(os, "fsync", sync)
        while recorder.problem == told[-1]:
            time.sleep(0.01)
    assert recorder.problem is None or "slow" in recorder.problem
    recorder.close()
    assert len(ticks(LogFile(tmp_path / "hang.mcap"))) > 10 and told == [told[0]] * 2
    assert str(tmp_path) in told[0]


def test_a_run_ends_though_its_disk_hangs(tmp_path, monkeypatch):
    monkeypatch.setattr(recorder_module, "CLOSE_S", 0.5)
    recorder, go = make(tmp_path / "hang.mcap", time.monotonic_ns), threading.Event()
    recorder.record(Tick(t_ns=1, index=0))
    recorder.sync()
    hanging = threading.Event()
    monkeypatch.setattr(os, "fsync", lambda _: (hanging.set(), go.wait(10)))
    recorder.record(Tick(t_ns=2, index=1))
    assert hanging.wait(5.0)
    start = time.monotonic()
    recorder.close()
    assert time.monotonic() - start < 5.0, "well before the disk comes back"
    assert ticks(LogFile(tmp_path / "hang.mcap"))[0] == 0
    go.set()
    recorder.close()
    assert ticks(LogFile(tmp_path / "hang.mcap")) == [0, 1], "and had it come back in time, nothing were lost"


def test_a_slow_disk_is_told_while_it_is_slow(tmp_path, step_clock, monkeypatch):
    recorder = make(tmp_path / "slow.mcap", step_clock, background=False)

    def slow(_: int) -> None:
        step_clock.t_ns += 800_000_000

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", slow)
        recorder.sync()
    assert recorder.problem is not None
    assert "slow" in recorder.problem
    assert recorder.slowest_sync_s == pytest.approx(0.8)
    recorder.sync()
    assert recorder.problem is None
    recorder.close()


def test_numpy_numbers_are_numbers_and_the_unwritable_is_counted(tmp_path, step_clock):
    path = tmp_path / "numpy.mcap"
    with make(path, step_clock) as recorder:
        recorder.record(Battery(t_ns=int(np.int64(3)), voltage_v=np.float64(0.1)))
        recorder.record(OperatorCommand(t_ns=1, command=object()))  # pyright: ignore[reportArgumentType]
        assert recorder.lost == 1
        assert recorder.problem is not None
        assert "/operator_command cannot be written" in recorder.problem
    assert list(LogFile(path).messages(Battery)) == [Battery(t_ns=3, voltage_v=0.1)]


def test_a_log_is_never_overwritten_and_a_missing_folder_is_an_error(tmp_path, step_clock):
    make(tmp_path / "log.mcap", step_clock).close()
    with pytest.raises(FileExistsError):
        make(tmp_path / "log.mcap", step_clock)
    with pytest.raises(FileNotFoundError):
        make(tmp_path / "absent" / "log.mcap", step_clock)


def test_closing_twice_is_fine_and_what_comes_after_is_counted(tmp_path, step_clock):
    recorder = make(tmp_path / "log.mcap", step_clock)
    recorder.close()
    recorder.close()
    recorder.sync()
    recorder.record(OperatorCommand(t_ns=1, command="stop"))
    assert recorder.lost == 1
    assert list(LogFile(tmp_path / "log.mcap").messages()) == []


def test_a_time_before_zero_is_kept_in_the_message(tmp_path, step_clock):
    path = tmp_path / "log.mcap"
    with make(path, step_clock) as recorder:
        recorder.record(Tick(t_ns=-30_000_000, index=0))
    assert [message.t_ns for message in LogFile(path).messages()] == [-30_000_000]


def test_the_same_drive_on_a_stepped_clock_gives_the_same_bytes(tmp_path, drive_log):
    first = drive_log(5.0).read_bytes()
    (tmp_path / "drive.mcap").unlink()
    assert drive_log(5.0).read_bytes() == first


def test_raw_bytes_come_back_in_order_per_link(tmp_path, step_clock):
    path = tmp_path / "raw.mcap"
    sent: list[tuple[str, Literal["rx", "tx"], bytes]] = [("mavlink", "tx", bytes([k])) for k in range(256)]
    sent.append(("uwb", "rx", b""))
    with make(path, step_clock) as recorder:
        for link, direction, data in sent:
            recorder.record_raw(link, direction, data)
    assert [(r.link, r.direction, r.data) for r in LogFile(path).raw()] == sent
    assert all(isinstance(r, RawBytes) for r in LogFile(path).raw("uwb"))
    assert len(list(LogFile(path).raw("uwb"))) == 1
