"""Schemas: every message has one, and viewers can read it."""

import inspect
import json

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from companion.core import messages as m
from companion.logs.foxglove import VIEWER_KINDS, viewer_message, world_from_ned
from companion.logs.schema import KINDS, RawBytes, viewer_schema

ALL = [*KINDS.values(), RawBytes, *VIEWER_KINDS]


def test_every_message_class_has_a_topic():
    members = [*inspect.getmembers(m.sensors, inspect.isclass), *inspect.getmembers(m.control, inspect.isclass)]
    classes = {kind for _, kind in members if issubclass(kind, m.Message)}
    assert set(KINDS.values()) == classes - {m.Message, m.Measured}


def check_dialect(schema: dict, where: str) -> None:
    """The rules of the open-source Foxglove Studio's parser, which refuses the whole channel otherwise."""
    assert schema["type"] == "object", where
    for name, field in schema["properties"].items():
        place = f"{where}.{name}"
        assert not {"$ref", "anyOf", "oneOf", "allOf"} & field.keys(), place
        assert field["type"] in ("boolean", "string", "number", "integer", "object", "array"), place
        if field["type"] == "object":
            check_dialect(field, place)
        if field["type"] == "array":
            items = field["items"]
            assert items["type"] in ("boolean", "string", "number", "integer", "object"), place
            if items["type"] == "object":
                check_dialect(items, place)


@pytest.mark.parametrize("kind", ALL, ids=lambda kind: kind.__name__)
def test_viewers_can_read_the_schema(kind):
    schema = json.loads(viewer_schema(kind, "name"))
    check_dialect(schema, kind.__name__)
    assert schema["title"] == "name"
    left_out = {name for name in kind.__struct_fields__ if name not in schema["properties"]}
    assert left_out <= {"f_n", "x", "reference"}  # arrays of arrays only


def test_a_pose_points_where_the_boat_points():
    estimate = m.StateEstimate(
        t_ns=1_500_000_000, north_m=3.0, east_m=4.0, psi_rad=0.7, u_m_s=0.0, v_m_s=0.0, r_rad_s=0.0,
        covariance=(), accel_bias_m_s2=(), gyro_bias_rad_s=0.0, anchor_bias_m={}, disturbance_n=(),
        health="healthy", reason="",
    )  # fmt: skip
    shown = json.loads(msgspec.json.encode(viewer_message(estimate, 2_000_000_000)))
    assert shown["timestamp"] == {"sec": 3, "nsec": 500_000_000}
    assert shown["pose"]["position"] == {"x": 3.0, "y": 4.0, "z": 0.0}
    q = shown["pose"]["orientation"]
    bow = Rotation.from_quat([q["x"], q["y"], q["z"], q["w"]]).apply([1.0, 0.0, 0.0])
    np.testing.assert_allclose(bow, [np.cos(0.7), np.sin(0.7), 0.0], atol=1e-12)


def test_the_world_frame_has_north_ahead_east_right_and_down_below():
    q = world_from_ned(0).rotation
    ned_axes = Rotation.from_quat([q.x, q.y, q.z, q.w]).apply(np.eye(3))
    np.testing.assert_allclose(ned_axes, [[0, 1, 0], [1, 0, 0], [0, 0, -1]], atol=1e-12)


def test_an_alert_is_a_log_line_and_a_tick_is_not():
    shown = viewer_message(m.Alert(t_ns=0, level="error", text="leak"), 0)
    assert json.loads(msgspec.json.encode(shown)) == {
        "timestamp": {"sec": 0, "nsec": 0}, "level": 4, "message": "leak", "name": "aritra", "file": "", "line": 0,
    }  # fmt: skip
    assert viewer_message(m.Tick(t_ns=0, index=0), 0) is None
