"""Readings that gates reject too often are told of once, at any rate, and so is when they fit again."""

import msgspec
import numpy as np
import pytest

from companion.core.messages import Innovation
from companion.core.pilot.trust.sensors.rejected_ranges import RejectedRangesMonitor
from tests.support.vessel_fixtures import boat

S = 1_000_000_000


def alerts(accepted, sensor="range 1150", rate_Hz=1.0, each=4):
    """Level and time [s] of each alert, of a boat whose readings come `each` at once and are accepted so."""
    vessel = boat("aritra")
    uwb = msgspec.structs.replace(vessel.sensors.uwb, rate_Hz=rate_Hz)
    sensors = msgspec.structs.replace(vessel.sensors, uwb=uwb)
    monitor = RejectedRangesMonitor(msgspec.structs.replace(vessel, sensors=sensors))
    state, said = monitor.initial, []
    for k, fits in enumerate(accepted):
        t_ns = round(k // each * S / rate_Hz)
        seen = Innovation(t_ns=t_ns, sensor=sensor, innovation=(0.0,), S=(1.0,), d2=1.0, accepted=bool(fits))
        state, report = monitor.on_message(state, seen, t_ns)
        said += [(a.level, t_ns / S) for a in report.alerts]
    return said


@pytest.mark.parametrize("rate_Hz", [1.0, 10.0])
def test_outliers_of_more_than_a_third_are_told_of_within_seconds_and_once(rate_Hz):
    fits = np.random.default_rng(1).uniform(size=round(240 * rate_Hz)) > 0.42
    ((level, t_s),) = alerts(fits, rate_Hz=rate_Hz)
    assert level == "warning" and t_s <= 10.0


def test_when_they_fit_again_that_is_said():
    said = alerts([0] * 12 + [1] * 100 + [0] * 12)
    assert [level for level, _ in said] == ["warning", "info", "warning"]


@pytest.mark.parametrize("seed", range(20))
def test_reflections_as_often_as_a_basin_has_them_are_not(seed):
    assert alerts(np.random.default_rng(seed).uniform(size=4000) > 0.08) == []


def test_one_anchor_that_moved_until_its_gate_re_opens_is_not():
    assert alerts(([1] * 12 + [0, 1, 1, 1] * 3) * 20) == []


def test_what_else_is_rejected_is_no_range():
    assert alerts([0] * 100, sensor="heading") == []
