"""Every reader of bytes that come from outside, under a little mutated input: the documented error or none.

`scripts/evidence safe --only fuzz` gives them over 10 million bytes. What was found is kept below.
"""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as wire

from companion.core.messages import Attitude, ImuSample
from companion.logs.readers.read_run import read_run
from companion.logs.runs.run import RunError
from drivers.mavlink.codec import MavlinkCodec
from tests.support.fuzzing.fuzz import fuzz
from tests.support.fuzzing.inputs import log_bytes
from tests.support.fuzzing.readers import READERS

BYTES = 8_000
SEED = 1
LEFT_OPEN = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
"""pymavlink leaves a dataflash log open when it raises while it opens it."""


@LEFT_OPEN
@pytest.mark.parametrize("name", READERS)
def test_only_documented_errors(name):
    out = fuzz(name, BYTES, SEED)
    assert out.wrong == {} and out.size >= BYTES


def test_an_undocumented_error_is_seen(monkeypatch):
    monkeypatch.setattr(READERS["site file"], "documented", ())
    assert any(kind.startswith("ConfigError") for kind in fuzz("site file", BYTES, SEED).wrong)


# --- found by fuzzing --------------------------------------------------------------------------------------


def _spoilt(tmp_path, old, new, count):
    (data,) = log_bytes("bin")
    assert old in data
    (tmp_path / "a.bin").write_bytes(data.replace(old, new, count))
    return tmp_path / "a.bin"


def test_a_dataflash_record_with_an_impossible_stamp_is_left_out_and_told(tmp_path):
    stamp = (1_000_000 + 20_000 * 50).to_bytes(8, "little")
    run = read_run(_spoilt(tmp_path, stamp, b"\xff" * 8, 1))
    assert [note.text for note in run.meta.notes if note.kind == "damaged"] == ["1 damaged records are left out"]


@LEFT_OPEN
def test_a_dataflash_log_whose_columns_are_damaged_names_the_file_or_leaves_them_out(tmp_path):
    with pytest.raises(RunError, match=r"a\.bin: cannot be read as a dataflash log, .*Unsupported format char"):
        read_run(_spoilt(tmp_path, b"QBffffff", b"QB$fffff", 1))
    run = read_run(_spoilt(tmp_path, b"TimeUS,Roll", b"TimeUX,Roll", 1))
    assert any(note.kind == "damaged" and note.text.startswith("200 ") for note in run.meta.notes)


def test_a_table_that_is_not_text_names_its_line(tmp_path):
    (data,) = log_bytes("csv")
    lines = data.split(b"\n")
    header = next(i for i, line in enumerate(lines) if not line.startswith(b"#"))
    lines[header + 3] = b"\xff" + lines[header + 3]
    (tmp_path / "a.csv").write_bytes(b"\n".join(lines))
    notes = [note.text for note in read_run(tmp_path / "a.csv").meta.notes if note.kind == "garbage"]
    assert notes == [f"line {header + 4}: is not UTF-8 text; 1 such lines are left out"]


def test_a_sensor_that_repeats_its_last_message_is_silent():
    """A frozen stream must not look alive: a stamp too old would give way to the time of arrival."""
    codec, mav = MavlinkCodec(target_system=1), wire.MAVLink(None, srcSystem=1, srcComponent=1)

    def heard(message, t_s):
        return [type(m) for m in codec.feed(bytes(message.pack(mav)), round(t_s * 1e9))]

    attitude = wire.MAVLink_attitude_message(7000, 0.0, 0.0, 1.0, 0.0, 0.0, 0.1)
    imu = wire.MAVLink_raw_imu_message(7_000_000, 1, 2, -1000, 0, 0, 5, 0, 0, 0)
    assert heard(attitude, 1.0) == [Attitude] and heard(imu, 1.0) == [ImuSample]
    assert [heard(m, 1.0 + 0.02 * k) for k in range(1, 50) for m in (attitude, imu)] == [[]] * 98
    assert codec.counters.repeated == {"ATTITUDE": 49, "RAW_IMU": 49}
    attitude.time_boot_ms += 20
    assert heard(attitude, 2.0) == [Attitude]
    unstamped = wire.MAVLink_attitude_message(0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.1)
    assert heard(unstamped, 2.1) == heard(unstamped, 2.2) == [Attitude], "0 is no stamp"
