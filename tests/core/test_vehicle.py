"""Getting to drive and noticing the end of it: every phase against every situation of the autopilot."""

from dataclasses import replace

import pytest

from companion.core.messages import Alert, Heartbeat, VehicleRequest
from companion.core.vehicle import HEARTBEAT_LOST_NS, MANUAL, RETRY_NS, Vehicle, advance, hear

S = 1_000_000_000
NOW = 100 * S
HOLD = 4


def heartbeat(armed=True, mode=MANUAL, t_ns=NOW):
    return Heartbeat(t_ns=t_ns, system=1, component=1, vehicle_type=11, autopilot=3, base_mode=0, custom_mode=mode,
                     system_status=4, armed=armed)  # fmt: skip


READY, HELD, DISARMED = heartbeat(), heartbeat(mode=HOLD), heartbeat(armed=False)
OLD = heartbeat(t_ns=NOW - HEARTBEAT_LOST_NS - 1)


@pytest.mark.parametrize(
    ("phase", "beat", "unfit", "after"),
    [
        ("stopped", READY, None, "stopped"),
        ("stopped", DISARMED, "lost", "stopped"),
        ("waiting", None, None, "waiting"),
        ("waiting", OLD, None, "waiting"),
        ("waiting", READY, "estimate lost", "waiting"),
        ("waiting", READY, None, "driving"),
        ("waiting", HELD, None, "arming"),
        ("waiting", DISARMED, None, "arming"),
        ("arming", None, None, "waiting"),
        ("arming", OLD, None, "waiting"),
        ("arming", READY, "estimate lost", "waiting"),
        ("arming", READY, None, "driving"),
        ("arming", HELD, None, "arming"),
        ("arming", DISARMED, None, "arming"),
        ("driving", READY, None, "driving"),
        ("driving", None, None, "stopped"),
        ("driving", OLD, None, "stopped"),
        ("driving", READY, "estimate lost", "stopped"),
    ],
)
def test_every_phase_in_every_situation(phase, beat, unfit, after):
    vehicle, out = advance(Vehicle(phase, "", beat), NOW, unfit=unfit)
    assert vehicle.phase == after
    if after != "driving":
        assert vehicle.why or phase == "stopped"
    errors = [m for m in out if isinstance(m, Alert) and m.level == "error"]
    assert len(errors) == (phase == "driving" and after == "stopped")
    requests = [m for m in out if isinstance(m, VehicleRequest)]
    assert bool(requests) == (after == "arming")


def test_manual_is_asked_for_before_arming_and_both_again_each_second():
    vehicle, asked = Vehicle("waiting"), []
    for k in range(60):
        t_ns = NOW + k * S // 10
        beat = heartbeat(mode=HOLD if k < 25 else MANUAL, armed=k >= 50, t_ns=t_ns)
        vehicle, out = advance(replace(vehicle, heartbeat=beat), t_ns, unfit=None)
        asked += [(k, m.action) for m in out if isinstance(m, VehicleRequest)]
    assert vehicle.phase == "driving"
    assert asked == [(0, "set_mode"), (10, "set_mode"), (20, "set_mode"), (30, "arm"), (40, "arm")]
    assert RETRY_NS == S


@pytest.mark.parametrize(("beat", "why"), [(DISARMED, "disarmed"), (HELD, "mode was changed to 4")])
def test_a_disarm_or_a_mode_change_stops_at_once_and_is_not_undone(beat, why):
    vehicle, out = hear(Vehicle("driving", "", READY), beat, NOW)
    assert vehicle.phase == "stopped" and why in vehicle.why and [a.level for a in out] == ["error"]
    vehicle, out = hear(vehicle, READY, NOW)
    assert vehicle.phase == "stopped" and not out


@pytest.mark.parametrize("phase", ["waiting", "arming", "stopped"])
@pytest.mark.parametrize("beat", [READY, DISARMED, HELD])
def test_before_driving_a_heartbeat_is_only_noted(phase, beat):
    assert hear(Vehicle(phase, "why"), beat, NOW) == (Vehicle(phase, "why", beat), [])


def test_a_heartbeat_that_comes_back_does_not_drive_by_itself():
    vehicle, _ = advance(Vehicle("driving", "", OLD), NOW, unfit=None)
    assert "no heartbeat" in vehicle.why
    vehicle, out = advance(replace(vehicle, heartbeat=READY), NOW, unfit=None)
    assert vehicle.phase == "stopped" and not out
