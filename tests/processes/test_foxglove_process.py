"""`aritra shore --foxglove`: what a boat tells over zenoh reaches a client of Foxglove's protocol."""

import asyncio
import json
import re
import socket
import struct
import time

import pytest

pytest.importorskip("aiohttp", reason="the extra `shore` is not installed")
pytest.importorskip("foxglove", reason="the extra `shore` is not installed")

import aiohttp
import zenoh

from companion.core.telemetry import structs as shore
from tests.support.console_fixture import served, state

pytestmark = pytest.mark.real_time


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


async def first_pose(url: str, tell) -> dict:
    """The first pose of the boat that a client sees while `tell` goes on telling states.

    It subscribes until something comes: the SDK may tell of a channel a moment before it takes subscriptions to it.
    """
    wanted = []
    async with aiohttp.ClientSession() as client, client.ws_connect(url, protocols=["foxglove.sdk.v1"]) as ws:
        end = time.monotonic() + 30.0
        while time.monotonic() < end:
            tell()
            try:
                message = await ws.receive(timeout=0.2)
            except TimeoutError:
                if wanted:
                    await ws.send_json({"op": "subscribe", "subscriptions": wanted})
                continue
            if message.type is aiohttp.WSMsgType.BINARY:
                assert struct.unpack("<BI", message.data[:5]) == (1, 7)
                return json.loads(message.data[13:])
            for channel in json.loads(message.data).get("channels", ()):
                if channel["topic"] == "/otter/pose":
                    assert channel["schemaName"] == "foxglove.PoseInFrame"
                    wanted = [{"id": 7, "channelId": channel["id"]}]
                    await ws.send_json({"op": "subscribe", "subscriptions": wanted})
    raise AssertionError("no pose within 30 s")


def test_a_boats_state_arrives_as_a_pose(tmp_path):
    endpoint, log = f"tcp/127.0.0.1:{free_port()}", tmp_path / "shore.txt"
    with served(log, "--listen", endpoint, "--foxglove", "0"):
        end = time.monotonic() + 15.0
        while "zenoh: ready" not in log.read_text():
            assert time.monotonic() < end, log.read_text()
            time.sleep(0.05)
        found = re.search(r"Foxglove: ws://(\S+)", log.read_text())
        config = zenoh.Config()
        for key, value in (
            ("mode", '"client"'),
            ("connect/endpoints", json.dumps([endpoint])),
            ("scouting/multicast/enabled", "false"),
        ):
            config.insert_json5(key, value)
        with zenoh.open(config) as session:
            k = 0

            def tell() -> None:
                nonlocal k
                k += 1
                session.put(shore.telemetry_key("otter", "state"), shore.encode(state(k)))

            pose = asyncio.run(first_pose(f"http://{found[1]}", tell))
    assert pose["frame_id"] == "ned"
    assert pose["pose"]["position"]["y"] == 2.0
    assert 1.0 <= pose["pose"]["position"]["x"] <= k
