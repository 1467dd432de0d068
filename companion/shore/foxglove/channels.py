"""Samples of telemetry -> the channels of a Foxglove context, whatever hears it: a server, or a file.

/<boat>/<topic>       the structs of docs/telemetry.md as received, with their JSON schema
/<boat>/pose, /log    the estimate as foxglove.PoseInFrame in `ned`, alerts as foxglove.Log
/<boat>/scene         foxglove.SceneUpdate: hull, ellipse of 95 %, path, fence, anchors
/<boat>/location      foxglove.LocationFix: where that is on the earth
/tf                   foxglove.FrameTransform: `ned` below `world`, so that north is up
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import msgspec
from foxglove import Channel, Context, Schema
from foxglove.channels import LocationFixChannel, SceneUpdateChannel

from companion.core.telemetry import structs as shore
from companion.logs.foxglove import FrameTransform, Log, PoseInFrame, log_line, pose_in_frame, world_from_ned
from companion.logs.schema import viewer_schema
from companion.shore.foxglove.scene import location, scene

AGAIN_NS = 1_000_000_000
"""Period at which samples that are sent once are repeated, for viewers that join later [s]; assumed."""
ONCE = ("about", "path", "checks")
_ENCODER = msgspec.json.Encoder()


class FoxgloveChannels:
    """What several boats say, on channels of their own. `context`: what the server or the file listens to."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._channels: dict[str, Channel] = {}
        self._scenes: dict[str, SceneUpdateChannel] = {}
        self._locations: dict[str, LocationFixChannel] = {}
        self._runs: dict[str, str] = {}
        self._abouts: dict[str, shore.About] = {}
        self._once: dict[tuple[str, str], tuple[shore.ShoreMessage, bytes]] = {}
        self._again_ns = 0

    def see(self, boat: str, topic: str, data: bytes, unix_ns: int) -> None:
        """One checked sample: JSON of a `ShoreMessage`. `unix_ns`: now, by our own clock.

        A sample whose numbers no viewer can have (a time beyond all calendars, a covariance cut short) is left out.
        """
        with suppress(ValueError, ArithmeticError):
            self._see(boat, topic, data, unix_ns)

    def _see(self, boat: str, topic: str, data: bytes, unix_ns: int) -> None:
        sample = shore.decode(topic, data)
        if self._runs.setdefault(boat, sample.run) != sample.run:
            self._forget(boat, sample.run)
        if isinstance(sample, shore.About):
            self._abouts[boat] = sample
        about = self._abouts.get(boat)
        at_ns = unix_ns if about is None else sample.t_ns + about.unix_minus_t_ns
        self._sample(boat, topic, sample, data, at_ns)
        if topic in ONCE:
            self._once[boat, topic] = sample, data
        if isinstance(sample, shore.StateNow):
            self._again(unix_ns, at_ns)
            self._log(f"/{boat}/pose", pose_in_frame(at_ns, sample.north_m, sample.east_m, sample.psi_rad), at_ns)
            if about and (fix := location(sample, about, boat, at_ns)):
                self._location(boat).log(fix, log_time=at_ns)
        elif isinstance(sample, shore.AlertTold):
            self._log(f"/{boat}/log", log_line(at_ns, sample.level, sample.text, boat), at_ns)

    def _forget(self, boat: str, run: str) -> None:
        """Another run of a boat begins: it has another clock, if the boat was started anew, and maybe another site."""
        self._runs[boat] = run
        self._abouts.pop(boat, None)
        self._once = {key: once for key, once in self._once.items() if key[0] != boat}

    def _again(self, unix_ns: int, at_ns: int) -> None:
        if abs(unix_ns - self._again_ns) < AGAIN_NS:
            return
        self._again_ns = unix_ns
        self._log("/tf", world_from_ned(at_ns), at_ns)
        for (boat, topic), (sample, data) in self._once.items():
            self._sample(boat, topic, sample, data, at_ns)

    def _sample(self, boat: str, topic: str, sample: shore.ShoreMessage, data: bytes, at_ns: int) -> None:
        """The sample itself, and what it changes in the scene."""
        kind = shore.TOPICS[topic]
        self._channel(f"/{boat}/{topic}", kind, f"aritra.{topic}.{shore.VERSION}").log(data, log_time=at_ns)
        if drawn := scene(sample, self._abouts.get(boat), at_ns):
            self._scene(boat).log(drawn, log_time=at_ns)

    def _log(self, name: str, message: PoseInFrame | Log | FrameTransform, at_ns: int) -> None:
        kind = type(message)
        self._channel(name, kind, f"foxglove.{kind.__name__}").log(_ENCODER.encode(message), log_time=at_ns)

    def _channel(self, name: str, kind: type[Any], schema: str) -> Channel:
        if name not in self._channels:
            described = Schema(name=schema, encoding="jsonschema", data=viewer_schema(kind, schema))
            self._channels[name] = Channel(name, schema=described, message_encoding="json", context=self._context)
        return self._channels[name]

    def _scene(self, boat: str) -> SceneUpdateChannel:
        if boat not in self._scenes:
            self._scenes[boat] = SceneUpdateChannel(f"/{boat}/scene", context=self._context)
        return self._scenes[boat]

    def _location(self, boat: str) -> LocationFixChannel:
        if boat not in self._locations:
            self._locations[boat] = LocationFixChannel(f"/{boat}/location", context=self._context)
        return self._locations[boat]
