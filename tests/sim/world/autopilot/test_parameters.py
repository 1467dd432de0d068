import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as wire

from sim.world.autopilot import BOAT_PARAMETERS, Rover
from sim.world.autopilot.parameter_table import TABLE, WireType
from sim.world.autopilot.parameters import stored
from tests.sim.world.autopilot.autopilot_fixture import Bench, of_type, override


def read(bench, name="", index=-1):
    return of_type(bench.send(wire.MAVLink_param_request_read_message(1, 1, name.encode(), index)), "PARAM_VALUE")


def put(bench, name, value, kind=wire.MAV_PARAM_TYPE_REAL32):
    return of_type(bench.send(wire.MAVLink_param_set_message(1, 1, name.encode(), value, kind)), "PARAM_VALUE")


def test_download_is_the_whole_table_once_in_order_and_only_on_its_link():
    bench = Bench()
    bench.join("boat")
    bench.join("other")
    bench.send(wire.MAVLink_param_request_list_message(1, 1))
    got = of_type(bench.run(2.0), "PARAM_VALUE")
    assert [(m.param_id, m.param_type, m.param_index) for m in got] == [
        (row.name, row.kind, index) for index, row in enumerate(TABLE)
    ]
    assert {m.param_count for m in got} == {len(TABLE)}
    changed = {m.param_id: m.param_value for m in got}
    assert all(changed[name] == value for name, value in BOAT_PARAMETERS.items())
    assert not of_type(bench.got["other"], "PARAM_VALUE")


def test_download_takes_as_long_per_parameter_as_the_real_one():
    bench = Bench()
    bench.join("boat")
    bench.send(wire.MAVLink_param_request_list_message(1, 1))
    bench.run(len(TABLE) * 1.3 / 1272)  # the fastest seen
    assert len(of_type(bench.got["boat"], "PARAM_VALUE")) < len(TABLE)
    bench.run(len(TABLE) * 2.0 / 1272)  # the slowest seen: 3.3 s
    assert len(of_type(bench.got["boat"], "PARAM_VALUE")) == len(TABLE)


def test_names_fit_the_wire_and_are_unique():
    assert len({row.name for row in TABLE}) == len(TABLE)
    assert all(len(row.name) <= 16 for row in TABLE)
    assert all(stored(row.kind, row.default) == pytest.approx(row.default, rel=1e-6) for row in TABLE)


def test_set_echoes_to_every_link_with_index_65535():
    bench = Bench()
    bench.join("other")
    echo = put(bench, "SERVO_RC_FS_MSK", 3840.0)
    assert [(m.param_value, m.param_index, m.param_type) for m in echo] == [(3840.0, 65535, WireType.INT32)]
    bench.run(0.02)
    assert [m.param_value for m in of_type(bench.got["other"], "PARAM_VALUE")] == [3840.0]


def test_wrong_type_is_accepted_and_int8_clamps():
    bench = Bench()
    assert put(bench, "FS_ACTION", 300.0, wire.MAV_PARAM_TYPE_UINT32)[0].param_value == 127.0
    assert put(bench, "FS_ACTION", -300.0)[0].param_value == -128.0
    assert put(bench, "FS_ACTION", 1.6)[0].param_value == 1.0


@pytest.mark.parametrize("name, value", [("MAV_GCS_SYSID", 1.0), ("FS_ACTION", math.nan), ("FS_TIMEOUT", math.inf)])
def test_unknown_names_and_unfinite_values_meet_silence(name, value):
    bench = Bench()
    assert put(bench, name, value) == []
    bench.run(0.5)
    assert not of_type(bench.got["boat"], "PARAM_VALUE")


def test_read_by_name_by_index_and_of_nothing():
    bench = Bench()
    by_name = read(bench, "SCHED_LOOP_RATE")[0]
    assert (by_name.param_value, by_name.param_index) == (200.0, 65535)
    by_index = read(bench, index=7)[0]
    assert (by_index.param_id, by_index.param_index) == (TABLE[7].name, 7)
    assert read(bench, "NOT_THERE") == []
    assert read(bench, index=len(TABLE)) == []


def test_construction_names_a_parameter_that_does_not_exist():
    with pytest.raises(ValueError, match="NOT_THERE"):
        Rover(0, {"NOT_THERE": 1.0})


def test_sysid_mygcs_takes_effect_at_once():
    bench = Bench()
    bench.join("gcs", system=255)
    bench.send(override(high=1700), "gcs")
    assert bench.rover.vehicle.rc.radio_in_us[8] == 0
    put(bench, "SYSID_MYGCS", 255.0)
    bench.send(override(high=1700), "gcs")
    assert bench.rover.vehicle.rc.radio_in_us[8] == 1700


@given(st.sampled_from(list(WireType)), st.floats(allow_nan=False, allow_infinity=False, width=32))
def test_stored_equals_numpys_saturating_cut(kind, value):
    if kind is WireType.REAL32:
        assert stored(kind, value) == float(np.float32(value))
        return
    limits = np.iinfo({WireType.INT8: np.int8, WireType.INT16: np.int16, WireType.INT32: np.int32}[kind])
    expected = np.clip(np.trunc(np.float64(value) + np.copysign(0.01, value)), limits.min, limits.max)
    assert stored(kind, value) == expected
    assert stored(kind, stored(kind, value)) == stored(kind, value)
