"""Rows of the pre-flight check on estimate, UWB, battery, disk and configuration."""

import math
import random
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs

from companion.core.configuration.run_file import BatteryLimits
from companion.core.estimation.health import SETTLES
from companion.core.geometry.anchors import hdop
from companion.core.geometry.fence import Fence
from companion.core.messages import (
    AnchorRange,
    Battery,
    Innovation,
    StateEstimate,
    UwbPosition,
    UwbRanges,
)
from companion.core.preflight.boat import battery_rows, configuration_rows, disk_rows, estimator_rows, uwb_rows
from companion.core.preflight.observations import Disk, cycles_of
from companion.core.preflight.rows import Row, worst
from tests.companion.core.preflight.observations_fixture import SITE, VESSEL, by_name, heard


def estimate(health="healthy", reason=""):
    return StateEstimate(
        t_ns=0, north_m=8.0, east_m=9.0, psi_rad=0.3, u_m_s=0.0, v_m_s=0.0, r_rad_s=0.0, covariance=(0.0,) * 36,
        accel_bias_m_s2=(0.0, 0.0), gyro_bias_rad_s=0.0, anchor_bias_m={}, disturbance_n=(0.0,) * 3, health=health,
        reason=reason,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("health", "level"), [("healthy", "ok"), ("degraded", "warning"), ("initialising", "refuse"), ("lost", "refuse")]
)
def test_the_estimate_s_health_decides(health, level):
    rows = by_name(estimator_rows(heard(estimate=estimate(health, "one anchor in range"))))
    assert rows["state"].level == level
    assert health in rows["state"].found


def test_an_estimate_whose_speed_settles_as_after_every_start_is_in_order():
    rows = by_name(estimator_rows(heard(estimate=estimate("degraded", SETTLES))))
    assert rows["state"].level == "ok" and "settles" in rows["state"].found


@pytest.mark.parametrize(("north_m", "health", "told"), [(8.0, "healthy", False), (1500.0, "healthy", True),
                                                         (0.2, "degraded", True), (1500.0, "lost", False)])  # fmt: skip
def test_a_boat_beyond_its_fence_is_told_that_it_will_not_drive(north_m, health, told):
    """As on the bank, or at a site whose origin is a kilometre off: all else was in order, and it stayed neutral."""
    fence, lies = Fence((SITE.fence,)), structs.replace(estimate(health), north_m=north_m)
    rows = by_name(estimator_rows(heard(estimate=lies), fence))
    assert ("place" in rows) == told
    assert not told or (rows["place"].level == "warning" and "beyond the fence" in rows["place"].found)


def test_innovations_that_do_not_fit_are_told_by_sensor():
    def series(sensor, d2, accepted):
        return [
            Innovation(t_ns=k, sensor=sensor, innovation=(0.1,), S=(0.01,), d2=d2, accepted=accepted) for k in range(10)
        ]

    rows = by_name(
        estimator_rows(
            heard(
                estimate=estimate(),
                innovations=(*series("range A", 1.0, True), *series("range B", 9.0, True), *series("imu", 1.0, False)),
            )
        )
    )
    assert rows["innovations: range"].level == rows["innovations: imu"].level == "warning"
    assert "d2 5.0" in rows["innovations: range"].found and "0 % accepted" in rows["innovations: imu"].found


def cycles(north=8.0, east=9.0, anchors=None, offset=None, count=5):
    """Ranges of a tag at a place, 1 cm of noise (seed 5); `offset`: what is added to one anchor's."""
    dice, offset = random.Random(5), offset or {}
    anchors = SITE.anchors if anchors is None else anchors
    away = VESSEL.sensors.uwb.z_m
    return tuple(
        UwbRanges(
            t_ns=k, t_rx_ns=k, tag="tag",
            ranges=tuple(
                AnchorRange(
                    anchor=a.id,
                    range_m=math.dist((a.north_m, a.east_m, a.down_m), (north, east, away)) + dice.gauss(0, 0.01)
                    + offset.get(a.id, 0.0),
                )
                for a in anchors
            ),
        )
        for k in range(count)
    )  # fmt: skip


def test_uwb_in_order_shows_where_the_boat_is():
    rows = by_name(uwb_rows(heard(ranges=cycles(), uwb_hz=1.0), SITE, VESSEL))
    assert worst(rows.values()) == "ok"
    assert "4 of 4" in rows["anchors"].found
    north, east = map(float, re.findall(r"[\d.]+(?= m)", rows["geometry"].found))
    assert (north, east) == pytest.approx((8.0, 9.0), abs=0.03)


@pytest.mark.parametrize(
    ("ranges", "hz", "name", "level", "word"),
    [
        ((), 0.0, "tag", "refuse", "nothing was opened"),
        (cycles(anchors=SITE.anchors[:3]), 1.0, "anchors", "warning", f"not {SITE.anchors[3].id}"),
        (cycles(anchors=SITE.anchors[:2]), 1.0, "anchors", "refuse", "2 of 4"),
        (cycles(offset={SITE.anchors[1].id: 1.5}), 1.0, "residuals", "warning", f"{SITE.anchors[1].id} +1"),
        (cycles(), 0.2, "cycles", "warning", "0.2 Hz"),
    ],
)
def test_one_fault_of_the_uwb_is_the_row_that_says_so(ranges, hz, name, level, word):
    rows = by_name(uwb_rows(heard(ranges=ranges, uwb_hz=hz), SITE, VESSEL))
    assert rows[name].level == level and word in rows[name].found
    assert [n for n, row in rows.items() if row.level != "ok"] == [name]


def test_unknown_anchors_are_named():
    stranger = type(SITE.anchors[0])(id="DEAD", north_m=0.0, east_m=15.0, down_m=-2.0, source="assumed")
    rows = by_name(uwb_rows(heard(ranges=cycles(anchors=(*SITE.anchors, stranger)), uwb_hz=1.0), SITE, VESSEL))
    assert rows["anchors"].level == "warning" and "unknown: DEAD" in rows["anchors"].found


@given(st.integers(3, 6), st.floats(0, 2 * math.pi))
def test_hdop_of_a_regular_ring_is_two_over_the_root_of_its_anchors(count, turn):
    angles = turn + np.arange(count) * 2 * np.pi / count
    ring = np.column_stack((10 * np.cos(angles), 10 * np.sin(angles), np.zeros(count)))
    assert hdop(ring, 0.0, 0.0, 0.0) == pytest.approx(2 / math.sqrt(count))


def test_anchors_in_one_line_with_the_boat_leave_a_direction_open():
    line = np.array([(0.0, 0.0, 0.0), (5.0, 0.0, 0.0), (10.0, 0.0, 0.0)])
    assert hdop(line, 20.0, 0.0, 0.0) == math.inf


@pytest.mark.parametrize(("north", "level"), [(8.0, "ok"), (-9.0, "warning")])
def test_positions_of_a_tag_are_looked_for_inside_the_fence(north, level):
    positions = tuple(UwbPosition(t_ns=k, t_rx_ns=k, tag="t", x_m=9.0, y_m=north, z_m=0.0) for k in range(4))
    rows = by_name(uwb_rows(heard(positions=positions, uwb_hz=1.0), SITE, VESSEL))
    assert rows["positions"].level == level
    assert (rows["cycles"].level, rows["cycles"].found) == ("ok", "1.0 Hz")


def test_a_tag_that_tells_positions_only_has_a_rate_too():
    positions = tuple(UwbPosition(t_ns=k, t_rx_ns=k, tag="t", x_m=9.0, y_m=8.0, z_m=0.0) for k in range(4))
    row = by_name(uwb_rows(heard(positions=positions, uwb_hz=0.5), SITE, VESSEL))["cycles"]
    assert row.level == "warning" and row.found == "0.5 Hz"


def test_ranges_and_position_of_one_cycle_are_one_cycle():
    positions = [UwbPosition(t_ns=k, t_rx_ns=k, tag="t", x_m=9.0, y_m=8.0, z_m=0.0) for k in range(3)]
    assert cycles_of([*cycles(count=4), *positions]) == 4, "a cycle without a fix counts"
    assert cycles_of(positions) == 3 and cycles_of(()) == 0


NO_LIMITS, LIMITS = BatteryLimits(), BatteryLimits(low_V=14.6, critical_V=14.0)


@pytest.mark.parametrize(
    ("voltage_v", "limits", "level"),
    [
        (16.0, NO_LIMITS, "ok"), (13.5, NO_LIMITS, "warning"), (12.0, NO_LIMITS, "refuse"),
        (14.5, LIMITS, "warning"), (13.9, LIMITS, "refuse"),
    ],
)  # fmt: skip
def test_battery(voltage_v, limits, level):
    rows = by_name(battery_rows(heard(battery=Battery(t_ns=0, voltage_v=voltage_v)), 15.0, limits))
    assert rows["voltage"].level == level


@pytest.mark.parametrize("voltage_v", [None, 0.0, 7.4, 22.6, 65.5])
@pytest.mark.parametrize(("limits", "level"), [(NO_LIMITS, "warning"), (LIMITS, "refuse")])
def test_a_voltage_that_no_pack_has_leaves_the_limits_without_use(voltage_v, limits, level):
    told = None if voltage_v is None else Battery(t_ns=0, voltage_v=voltage_v)
    row = by_name(battery_rows(heard(battery=told), 15.0, limits))["voltage"]
    assert row.level == level and "BATT_MONITOR" in row.fix
    assert ("critical_V of the run file count for nothing" in row.why) is (limits == LIMITS)


def test_limits_in_per_cent_need_somebody_who_counts():
    limits, full = BatteryLimits(critical_percent=20), Battery(t_ns=0, voltage_v=16.0)
    row = by_name(battery_rows(heard(battery=full), 15.0, limits))["charge"]
    assert row.level == "refuse" and "BATT_CAPACITY" in row.fix
    counted = Battery(t_ns=0, voltage_v=16.0, remaining_percent=80)
    assert worst(battery_rows(heard(battery=counted), 15.0, limits)) == "ok"


@pytest.mark.parametrize(
    ("disk", "level"),
    [
        (Disk("logs", 10**11), "ok"),
        (Disk("logs", 5 * 10**8), "warning"),
        (Disk("logs", 10**7), "refuse"),
        (Disk("logs", 0, problem="Permission denied"), "refuse"),
        (Disk("logs", 2 * 10**9, quota_bytes=8e9, used_bytes=10**9), "warning"),
        (Disk("logs", 2 * 10**9, quota_bytes=8e9, used_bytes=7 * 10**9), "ok"),
    ],
)
def test_disk(disk, level):
    assert by_name(disk_rows(heard(disk=disk)))["log folder"].level == level


def test_warnings_of_the_configuration_become_rows():
    rows = list(configuration_rows(["waypoint 3 lies beyond the fence"], "abc: vessel x"))
    assert [row.level for row in rows] == ["ok", "warning"] and rows[1].found == "waypoint 3 lies beyond the fence"


def test_the_verdict_is_the_worst():
    def row(level):
        return Row(area="a", name="n", level=level, found="f", needed="n", why="w")

    assert worst([]) == "ok"
    assert worst([row("ok"), row("warning")]) == "warning"
    assert worst([row("refuse"), row("ok"), row("warning")]) == "refuse"
