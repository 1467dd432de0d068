"""Fixes of a receiver in logs of ArduPilot: the vessel file says which are good enough, for the filter and for fits."""

from pathlib import Path

import pytest

from companion.logs.readers.gps import NO_FIX, Fix, good_fixes, gps_stream
from companion.logs.readers.read_run import ReadOptions, read_run
from companion.logs.runs.run import LogProblem
from tests.companion.logs.readers.run_logs import dataflash
from tests.companion.logs.readers.test_dataflash import records, written
from tests.companion.logs.readers.test_tlog import Autopilot
from tests.support.vessel_fixtures import boat


def bin_log(folder: Path) -> Path:
    return written(folder, gps=True)


def telemetry_log(folder: Path) -> Path:
    return Autopilot(20.0).write(folder / "a.tlog")


@pytest.mark.parametrize("log", [bin_log, telemetry_log])
def test_a_fix_that_the_boats_filter_would_not_take_is_no_position_for_a_fit(log, tmp_path):
    lake = boat("lake")
    assert lake.sensors.gnss and lake.sensors.gnss.fix == "fixed"
    whole = read_run(log(tmp_path))
    assert whole.known("north_m") and not any(note.kind == "left out" for note in whole.meta.notes)
    run = read_run(log(tmp_path), ReadOptions(vessel=lake))
    (note,) = (note for note in run.meta.notes if note.kind == NO_FIX)
    assert not run.known("north_m")
    count = len(whole.samples("north_m")[0])
    asked = f'none of {count} GPS fixes is as good as "fixed", which sensors.gnss.fix of the vessel file asks for: '
    assert note.text.startswith(f"{asked}{count} 3D; write a lesser fix there")


def fixes(count: int, kind: int, first_deg: tuple[float, float] = (63.4, 10.4)) -> list[Fix]:
    """Fixes along a meridian, 0.1 m apart, the first one at `first_deg`."""
    return [(k, *(first_deg if not k else (63.4 + 1e-6 * k, 10.4)), kind) for k in range(count)]


def test_a_few_lesser_fixes_are_said():
    notes: list[LogProblem] = []
    assert len(good_fixes({0: [*fixes(20, 6), *fixes(3, 4), *fixes(2, 1)]}, boat("lake"), notes)) == 20
    assert notes[0].text == '3 GPS positions of a lesser fix than "fixed" (sensors.gnss.fix of the vessel file)'


@pytest.mark.parametrize(
    ("receivers", "text"),
    [
        ({}, "no fix of a GPS receiver in it"),
        ({0: fixes(5, 1), 1: fixes(7, 2)}, "none of 12 GPS fixes has three dimensions: 5 no fix, 7 2D"),
        ({0: fixes(5, 5), 1: fixes(7, 1)}, 'none of 12 GPS fixes is as good as "fixed"'),
    ],
)
def test_why_there_is_no_position_is_said(receivers, text):
    notes: list[LogProblem] = []
    assert good_fixes(receivers, boat("lake"), notes) == []
    assert notes[0].kind == NO_FIX and notes[0].text.startswith(text)


def test_the_receiver_with_fixes_is_read_and_the_first_of_two_as_good():
    for receivers, read in (
        ({1: fixes(9, 3)}, 1),
        ({0: fixes(3, 3), 1: fixes(9, 3)}, 1),
        ({0: fixes(9, 3), 1: fixes(10, 3)}, 0),
    ):
        notes: list[LogProblem] = []
        assert good_fixes(receivers, None, notes) == receivers[read]
        assert [n.text.startswith("GPS receiver 1 (from 0) is read, with 9 good fixes") for n in notes] == [True] * read


def test_a_log_with_the_second_receiver_alone_has_positions(tmp_path):
    second = [(*r[:2], 1, *r[3:]) if r[0] == "GPS" else r for r in records(gps=True)]
    (tmp_path / "a.BIN").write_bytes(dataflash(second))
    assert read_run(tmp_path / "a.BIN").known("north_m")


@pytest.mark.parametrize("first_deg", [(0.0, 0.0), (63.4, 10.4 + 2**26 / 1e7), (63.43, 10.4)])
def test_one_bad_first_fix_is_left_out_and_is_no_origin(first_deg):
    notes: list[LogProblem] = []
    stream, text = gps_stream(fixes(200, 3, first_deg), None, notes)
    assert len(stream.t_ns) == 199 and "origin at the first fix, 63.4000010 10.4000000" in text
    assert stream.columns["north_m"][0] == 0.0 and abs(stream.columns["north_m"]).max() < 30
    assert notes[0].kind == "impossible" and "1 of 200 lie kilometres from all others" in notes[0].text


@pytest.mark.parametrize("longitude_deg", [10.4, 180.0])
def test_the_origin_of_a_sound_log_is_its_first_fix(longitude_deg):
    """Over 11 km, and across the date line, too."""
    along = [(k, 63.4, (longitude_deg + 0.001 * k + 180) % 360 - 180, 3) for k in range(-20, 200)]
    notes: list[LogProblem] = []
    stream, _ = gps_stream(along, None, notes)
    assert not notes and stream.columns["east_m"][0] == 0.0
    assert stream.columns["east_m"][-1] == pytest.approx(10_960, rel=0.01)


def test_positions_of_the_autopilots_filter_serve_where_there_is_no_receivers(tmp_path):
    class Filtered(Autopilot):
        def put(self, message, mav=None):
            if message.get_type() == "GPS_RAW_INT":
                message = self.mav.global_position_int_encode(0, message.lat, message.lon, 0, 0, 0, 0, 0, 0)
            super().put(message, mav)

    run = read_run(Filtered(20.0).write(tmp_path / "a.tlog"))
    whole = read_run(telemetry_log(tmp_path))
    assert run.samples("north_m")[1].tolist() == whole.samples("north_m")[1].tolist()
    assert [n.kind for n in run.meta.notes] == ["filtered positions"] and run.meta.latency_s is None
