"""Damaged dataflash logs: what is whole is read, what was passed over is told, and a power cut is no damage."""

import struct

import pytest

from companion.logs.readers.read_run import read_run
from tests.companion.logs.readers.run_logs import dataflash

FMT_BYTES, IMU_BYTES, RCOU_BYTES = 89, 36, 39
TICKS = 200


def records():
    for k in range(TICKS):
        yield ("IMU", 5_000_000 + 20_000 * k, 0, 0.1, 0.2, 0.01 * k, 1.0, -2.0, -9.8)
        yield ("RCOU", 5_000_500 + 20_000 * k, 1600 + k, 1500, 1400, 1500, *([0] * 10))


DATA = dataflash(records())
FIRST = len(DATA) - TICKS * (IMU_BYTES + RCOU_BYTES)


def imu_at(k: int) -> int:
    """Where the `k`th sample of the IMU begins; the outputs of `k` follow it."""
    return FIRST + k * (IMU_BYTES + RCOU_BYTES)


def read(tmp_path, data: bytes):
    """Ticks of the gyro's samples and of the outputs, and what is told as damaged."""
    path = tmp_path / "a.bin"
    path.write_bytes(data)
    run = read_run(path)
    outputs = [round(us - 1600) for us in run.commands()[1][:, 0]]
    told = [note.text for note in run.meta.notes if note.kind == "damaged"]
    return [round(r / 0.01) for r in run.samples("r_rad_s")[1]], outputs, told


ALL = list(range(TICKS))


@pytest.mark.parametrize("new", [b"\xa3\x95\xfe", b"\xa3\x94\x82", b"\0\0\0"], ids=["type", "second byte", "zeros"])
@pytest.mark.parametrize("tick", [20, TICKS - 3])
def test_one_damaged_header_costs_its_record(tmp_path, capfd, new, tick):
    at = imu_at(tick)
    samples, outputs, told = read(tmp_path, DATA[:at] + new + DATA[at + 3 :])
    assert samples == [k for k in ALL if k != tick] and outputs == ALL
    assert told == [f"a.bin: {IMU_BYTES} bytes passed over, the first at byte {at}"]
    assert capfd.readouterr().err == ""


def test_zeros_in_the_middle_are_told_once(tmp_path, capfd):
    at, end = imu_at(50), imu_at(100) + 10
    samples, outputs, told = read(tmp_path, DATA[:at] + bytes(end - at) + DATA[end:])
    assert samples == ALL[:50] + ALL[101:] and outputs == ALL[:50] + ALL[100:]
    assert told == [f"a.bin: {imu_at(100) + IMU_BYTES - at} bytes passed over, the first at byte {at}"]
    assert capfd.readouterr().err == ""


def test_a_record_that_lacks_bytes_is_not_filled_up_from_the_next_one(tmp_path):
    """Cut out of the outputs 20, which would have had the header of what follows for values."""
    at = imu_at(20) + IMU_BYTES
    samples, outputs, told = read(tmp_path, DATA[: at + 15] + DATA[at + 22 :])
    assert samples == ALL and outputs == [k for k in ALL if k != 20]
    assert told == [f"a.bin: {RCOU_BYTES - 7} bytes passed over, the first at byte {at}"]


def test_a_damaged_format_costs_what_it_describes(tmp_path):
    """The last format record lacks bytes: its type is not known, that of the others is."""
    format_at = DATA.index(b"BAT\0") - 5
    log = DATA[: format_at + 60] + DATA[format_at + 70 :]
    cut = log[: imu_at(9) - 10] + b"\xa3\x95\x84" + struct.pack("<QBf", 5_000_000, 0, 15.0) + log[imu_at(9) - 10 :]
    samples, outputs, told = read(tmp_path, cut)
    assert samples == outputs == ALL
    assert told == [f"a.bin: {FMT_BYTES - 10 + 16} bytes passed over, the first at byte {format_at}"]


@pytest.mark.parametrize("after", [bytes(5000), b"\xff" * 5000], ids=["zeros", "erased"])
def test_padding_at_the_end_is_no_damage(tmp_path, capfd, after):
    assert read(tmp_path, DATA + after) == (ALL, ALL, [])
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("cut", [1, 30, RCOU_BYTES - 2])
def test_a_record_that_a_power_cut_broke_off_is_no_damage(tmp_path, capfd, cut):
    assert read(tmp_path, DATA[:-cut]) == (ALL, ALL[:-1], [])
    assert capfd.readouterr().err == ""


def test_garbage_at_the_end_is_told(tmp_path):
    samples, outputs, told = read(tmp_path, DATA + b"garbage" * 100)
    assert samples == outputs == ALL
    assert told == [f"a.bin: 700 bytes passed over, the first at byte {len(DATA)}"]
