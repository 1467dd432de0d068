"""The recorder when the disk is full, slow, hanging or broken."""

import errno
import os
import subprocess
import threading
import time
from pathlib import Path

import pytest

import companion.boat.recorder as recorder_module
from companion.core.messages import Tick
from companion.logs.log_file import LogFile
from companion.logs.part_files import log_parts
from companion.logs.summary import summarise
from companion.python_child import python
from tests.companion.boat.recorder.recorder_fixture import make, ticks


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


@pytest.mark.parametrize("code", [errno.EROFS, errno.ENOSPC, errno.EUCLEAN, errno.ENODEV])
def test_a_folder_that_cannot_be_made_yet_keeps_no_boat_ashore(tmp_path, step_clock, monkeypatch, code):
    """A disk that did not mount, or is read-only after a power cut, at the first start of a boat."""
    folder = tmp_path / "not" / "there"

    def refuse(self, *_, **__):
        raise OSError(code, os.strerror(code), str(self))

    with monkeypatch.context() as broken:
        broken.setattr(Path, "mkdir", refuse)
        recorder = make(folder / "log.mcap", step_clock, background=False, folder=folder)
        assert recorder.problem is not None and os.strerror(code) in recorder.problem
    recorder.record(Tick(t_ns=1, index=0))
    step_clock.t_ns += int(recorder_module.RETRY_S * 1e9)
    recorder.sync()
    recorder.close()
    assert ticks(LogFile(folder / "log.mcap")) == [0]


def test_a_folder_that_nobody_may_make_is_a_path_to_correct(tmp_path, step_clock, monkeypatch):
    (tmp_path / "file").touch()
    for folder in (tmp_path / "file" / "logs", tmp_path / "file"):
        with pytest.raises((NotADirectoryError, FileExistsError)):
            make(folder / "log.mcap", step_clock, folder=folder)


def test_what_cannot_be_written_is_said_though_the_disk_is_written_to_at_once(tmp_path, step_clock):
    recorder = make(tmp_path / "log.mcap", step_clock, background=False)
    recorder.record(Tick(t_ns=1, index=object()))
    recorder.record(Tick(t_ns=2, index=1))
    recorder.sync()
    assert recorder.problem is not None and "cannot be written" in recorder.problem
    step_clock.t_ns += 2 * 10**9
    assert recorder.problem is None
    recorder.close()


def test_every_outage_is_said_and_that_it_is_over():
    """A problem that comes and goes within 10 s is one."""
    alerts, said = recorder_module.RecordingAlerts(), []
    for t_s in range(200):
        full, slow = 10 <= t_s < 20 or 60 <= t_s < 120, 150 <= t_s < 180 and t_s % 5 == 0
        if alert := alerts.step("disk full" if full else "disk slow" if slow else None, t_s * 10**9):
            said.append((t_s, alert.level))
    assert said == [(10, "error"), (29, "info"), (60, "error"), (129, "info"), (150, "error"), (185, "info")]


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


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EROFS])
def test_a_disk_that_is_full_at_the_start_is_tried_again(tmp_path, step_clock, monkeypatch, code):
    path = tmp_path / "late.mcap"

    def fsync(_: int) -> None:
        raise OSError(code, os.strerror(code))

    with monkeypatch.context() as full:
        full.setattr(os, "fsync", fsync)
        recorder = make(path, step_clock, background=False)
        assert recorder.problem is not None
        assert str(path) in recorder.problem and os.strerror(code) in recorder.problem
        assert list(tmp_path.iterdir()) == [], "no stub is left that would be in the way later"
        recorder.record(Tick(t_ns=1, index=0))
        step_clock.t_ns += int(recorder_module.RETRY_S * 1e9)
        recorder.sync()
        assert recorder.problem is not None
    step_clock.t_ns += int(recorder_module.RETRY_S * 1e9)
    recorder.sync()
    assert recorder.problem is None
    recorder.close()
    assert recorder.lost == 0 and ticks(LogFile(path)) == [0], "what happened meanwhile is in it"


def test_a_path_that_is_wrong_is_said_at_the_start(tmp_path, step_clock):
    (tmp_path / "there.mcap").write_bytes(b"")
    with pytest.raises(FileExistsError):
        make(tmp_path / "there.mcap", step_clock, background=False)
    with pytest.raises(FileNotFoundError):
        make(tmp_path / "no" / "folder.mcap", step_clock, background=False)


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
