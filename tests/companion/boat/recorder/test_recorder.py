"""What the recorder writes: messages, times, metadata, parts; the same bytes again."""

import random
import signal
import subprocess
import time
import tracemalloc
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from mcap.reader import make_reader

from companion.core.messages import Battery, OperatorCommand, Tick
from companion.logs.log_file import LogFile
from companion.logs.metadata import log_metadata
from companion.logs.part_files import log_parts, part_path
from companion.logs.recover import recover
from companion.logs.schema import RawBytes
from companion.python_child import python
from tests.companion.boat.recorder.recorder_fixture import OFFSET_NS, make, ticks


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


@pytest.mark.real_time
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.long
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
    whole = LogFile(path)
    assert ticks(whole) == list(range(6000)) and whole.damage == []
    assert not recorder.lost
    parts[-1].rename(tmp_path / "not copied.mcap")
    of_fewer, joined = LogFile(path), recover(path)
    assert ticks(of_fewer) == list(range(joined.messages - len(parts) + 1))  # a viewer's frame in each
    for damage in (of_fewer.damage, joined.damage):
        assert damage == [f"{parts[-2]}: the log goes on in another part, which is not here"]
    assert LogFile(Path(joined.out)).damage == []


@pytest.mark.long
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
    part_path(tmp_path / "other.mcap", 1).touch()
    with pytest.raises(FileExistsError, match="older log"):  # it would be in the way at the first rotation
        make(tmp_path / "other.mcap", step_clock)


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
