"""Fixes of a receiver in logs of ArduPilot: the vessel file says which are good enough, for the filter and for fits."""

from pathlib import Path

import pytest

from companion.logs.readers.read_run import ReadOptions, read_run
from tests.companion.logs.readers.test_dataflash import written
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
    (note,) = (note for note in run.meta.notes if note.kind == "left out")
    assert not run.known("north_m")
    count = len(whole.samples("north_m")[0])
    assert note.text == f'{count} GPS positions of a lesser fix than "fixed" (sensors.gnss.fix of the vessel file)'
