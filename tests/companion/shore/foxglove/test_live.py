"""Foxglove: the live server speaks its protocol to a client, and the layouts name nothing that is not there."""

import asyncio
import importlib
import json
import re
import struct
from importlib.resources import files
from typing import Any

import msgspec
import pytest

from companion.core.configuration.tables import ConfigError
from companion.core.telemetry import structs as shore
from companion.logs.foxglove import VIEWER_KINDS, Log, PoseInFrame
from companion.logs.schema import KINDS, viewer_schema

UNIX_NS = 1_790_000_000_000_000_000
HEAD = {"run": "r"}


def state(t_ns: int) -> shore.StateNow:
    return shore.StateNow(
        **HEAD, t_ns=t_ns, north_m=1.0, east_m=2.0, psi_rad=0.3, u_m_s=0.4, v_m_s=0.0, r_rad_s=0.0,
        covariance=(0.0,) * 21, disturbance_n=(0.0, 0.0, 0.0), health="healthy", reason="",
    )  # fmt: skip


def about(offset_ns: int) -> shore.About:
    return shore.About(
        **HEAD, t_ns=0, vessel="v", site="s", configuration="c", software="x", unix_minus_t_ns=offset_ns, period_s=0.1,
        lat_deg=0.0, lon_deg=0.0, rotation_deg=0.0, thrusters=(), anchors=(), within=(((0.0, 1.0),),), without=(),
        commands=False, length_m=1.0, beam_m=0.5,
    )  # fmt: skip


def heard(told: list[shore.ShoreMessage], topics: set[str]) -> dict[str, list[tuple[int, Any]]]:
    """What a client that subscribes to `topics` gets, over a real WebSocket: topic -> (time [ns], message)."""
    aiohttp = pytest.importorskip("aiohttp", reason="the extra `shore` is not installed")
    live = pytest.importorskip("companion.shore.foxglove.live", reason="the extra `shore` is not installed")
    server = live.FoxgloveServer(0)

    async def listen() -> dict[str, list[tuple[int, Any]]]:
        url, protocols = f"http://127.0.0.1:{server.port}", ["foxglove.sdk.v1"]
        async with aiohttp.ClientSession() as client, client.ws_connect(url, protocols=protocols) as socket:
            assert socket.protocol == "foxglove.sdk.v1"
            channels, got, now_ns = {}, {}, UNIX_NS
            while set(got) != topics:
                now_ns += 1_000_000_000
                for each in told:  # again and again: a client subscribes when it has seen a topic
                    server.see("boat", shore.topic_of(each), shore.encode(each), now_ns)
                try:
                    message = await socket.receive(timeout=0.2)
                except TimeoutError:
                    continue
                if message.type is aiohttp.WSMsgType.TEXT:
                    for channel in json.loads(message.data).get("channels", ()):
                        if channel["topic"] in topics:
                            wanted = [{"id": len(channels), "channelId": channel["id"]}]
                            channels[len(channels)] = channel
                            await socket.send_json({"op": "subscribe", "subscriptions": wanted})
                elif message.type is aiohttp.WSMsgType.BINARY:
                    kind, number, t_ns = struct.unpack("<BIQ", message.data[:13])
                    assert kind == 1
                    channel = channels[number]
                    got.setdefault(channel["topic"], []).append((t_ns, read(channel, message.data[13:])))
            return got

    try:
        return asyncio.run(asyncio.wait_for(listen(), 30.0))
    finally:
        server.close()


def read(channel: dict, data: bytes):
    """A message as the client's program has it: JSON, or Foxglove's own protobuf class."""
    name = channel["schemaName"]
    if channel["encoding"] == "json":
        assert json.loads(channel["schema"])["title"] == name
        return json.loads(data)
    word = name.removeprefix("foxglove.")
    return getattr(importlib.import_module(f"foxglove_schemas_protobuf.{word}_pb2"), word).FromString(data)


def test_a_client_gets_samples_pose_and_alerts_with_their_times():
    alert = shore.AlertTold(**HEAD, t_ns=7, level="error", text="leak")
    topics = {"/boat/state", "/boat/pose", "/boat/log", "/tf", "/boat/about"}
    got = heard([about(1000), state(5), alert], topics)
    t_ns, sample = got["/boat/state"][0]
    assert t_ns == 1005  # by the boat's own clock
    assert shore.decode("state", json.dumps(sample).encode()) == state(5)
    assert got["/boat/pose"][0][1]["pose"]["position"] == {"x": 1.0, "y": 2.0, "z": 0.0}
    assert got["/boat/log"][0][1]["message"] == "leak"
    assert got["/tf"][0][1]["child_frame_id"] == "ned"
    assert got["/boat/about"][0][1]["vessel"] == "v"


def test_a_boat_that_was_started_anew_is_not_stamped_by_the_clock_that_it_had_before():
    """Its monotonic clock began anew: until it tells what time it has, its samples are of now."""
    t_ns, _ = heard([about(1000), msgspec.structs.replace(state(5), run="next")], {"/boat/state"})["/boat/state"][0]
    assert t_ns > UNIX_NS


def test_a_client_sees_the_scene_and_the_place_on_the_earth():
    got = heard([about(1000), state(5)], {"/boat/scene", "/boat/location"})
    drawn = {e.id: t_ns for t_ns, update in got["/boat/scene"] for e in update.entities}
    assert set(drawn) & {"fence", "hull", "ellipse"}
    (t_ns, fix), *_ = got["/boat/location"]
    assert (t_ns, fix.timestamp.nanos, fix.frame_id) == (1005, 1005, "boat")
    assert abs(fix.latitude) < 1e-4


def test_numbers_that_no_viewer_can_have_end_nothing():
    live = pytest.importorskip("companion.shore.foxglove.live", reason="the extra `shore` is not installed")
    server = live.FoxgloveServer(0)
    odd = [about(2**62), state(2**62), state(-5), msgspec.structs.replace(state(5), covariance=(1.0,))]
    odd += [msgspec.structs.replace(about(0), lat_deg=90.0), msgspec.structs.replace(state(5), north_m=1e308)]
    try:
        for sample in odd:
            server.see("boat", shore.topic_of(sample), shore.encode(sample), UNIX_NS)
    finally:
        server.close()


def test_a_boat_that_told_no_clock_is_stamped_when_it_was_heard():
    assert heard([state(5)], {"/boat/state"})["/boat/state"][0][0] >= UNIX_NS


def test_a_port_that_is_taken_is_told():
    live = pytest.importorskip("companion.shore.foxglove.live", reason="the extra `shore` is not installed")
    first = live.FoxgloveServer(0)
    try:
        with pytest.raises(ConfigError, match=f"--foxglove {first.port}"):
            live.FoxgloveServer(first.port)
    finally:
        first.close()


@pytest.mark.parametrize("kind", shore.TOPICS.values(), ids=shore.TOPICS)
def test_every_topic_has_a_schema_in_the_viewers_dialect(kind):
    def check(node: dict) -> None:
        assert isinstance(node["type"], str)
        assert not {"$ref", "anyOf", "prefixItems"} & set(node)
        for value in node.get("properties", {}).values():
            assert value["type"] != "array" or value["items"]["type"] != "array"
            check(value)

    check(json.loads(viewer_schema(kind, "name")))


# --- layouts ---------------------------------------------------------------------------------------


def layout(name: str) -> dict:
    return json.loads(files("deploy").joinpath("foxglove", f"{name}.json").read_text())


def described() -> dict[str, dict[str, type]]:
    """Layout -> topics that its data has, and their structs."""
    messages = pytest.importorskip("foxglove.messages", reason="the extra `shore` is not installed")
    logged = {**KINDS, **{topic: kind for kind, topic in VIEWER_KINDS.items()}}
    live = {f"/aritra/{topic}": kind for topic, kind in shore.TOPICS.items()}
    drawn = {"/aritra/scene": messages.SceneUpdate, "/aritra/location": messages.LocationFix}
    return {"log": logged, "live": {**live, **drawn, "/aritra/pose": PoseInFrame, "/aritra/log": Log}}


def leaves(node: dict | str) -> list[str]:
    if isinstance(node, str):
        return [node]
    assert node["direction"] in ("row", "column")
    assert 0 < node["splitPercentage"] < 100
    return [*leaves(node["first"]), *leaves(node["second"])]


@pytest.mark.parametrize("name", ["log", "live"])
def test_a_layout_shows_every_panel_once_and_each_path_leads_somewhere(name):
    found, topics = layout(name), described()[name]
    panels = found["configById"]
    assert sorted(leaves(found["layout"])) == sorted(panels)
    paths = [p["value"] for config in panels.values() for p in config.get("paths", ())]
    assert len(paths) > 15
    for path in paths:
        matched = re.fullmatch(r"(/[\w/]+)((?:\.\w+(?:\[\d\])?)+)", path)
        assert matched, path
        node = json.loads(viewer_schema(topics[matched[1]], "name"))
        for step in matched[2][1:].split("."):
            node = node["properties"][step.split("[")[0]]
            node = node["items"] if "[" in step else node
        wanted = (
            {"string"}
            if any(path in str(c["paths"]) for k, c in panels.items() if k[0] == "S")
            else {"number", "integer"}
        )
        assert node["type"] in wanted, path
    (log,) = (config["topicToRender"] for key, config in panels.items() if key.startswith("RosOut!"))
    assert topics[log] is Log
    (drawn,) = (config["topics"] for key, config in panels.items() if key.startswith("3D!"))
    maps = [config["followTopic"] for key, config in panels.items() if key.startswith("map!")]
    shown = [topics[topic].__name__ for topic in (*drawn, *maps)]
    assert shown == {"log": ["PoseInFrame"], "live": ["SceneUpdate", "PoseInFrame", "LocationFix"]}[name]
