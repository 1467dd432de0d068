"""Live telemetry for Foxglove: a WebSocket server beside the console (`aritra shore --foxglove PORT`).

    /<boat>/<topic>       the structs of docs/telemetry.md as received, with their JSON schema
    /<boat>/pose, /log    the estimate as foxglove.PoseInFrame in `ned`, alerts as foxglove.Log
    /tf                   foxglove.FrameTransform: `ned` below `world`, so that north is up

foxglove-sdk (extra `shore`) does the protocol on threads of its own; a client that is too slow loses the oldest
messages and never holds anybody up. Read-only: clients can look, and nothing else.
"""

from __future__ import annotations

from typing import Any

import msgspec
from foxglove import Channel, Context, Schema, start_server

from companion.core.configuration.tables import ConfigError
from companion.core.telemetry import structs as shore
from companion.logs.foxglove import FrameTransform, Log, PoseInFrame, log_line, pose_in_frame, world_from_ned
from companion.logs.schema import viewer_schema

AGAIN_NS = 1_000_000_000
"""Period at which samples that are sent once are repeated, for viewers that join later [s]; assumed."""
ONCE = ("about", "path", "checks")
_ENCODER = msgspec.json.Encoder()


class FoxgloveServer:
    """Call it with every sample. Raises ConfigError where the port is taken."""

    def __init__(self, port: int) -> None:
        self._context = Context()
        try:
            self._server = start_server(
                name="aritra",
                host="127.0.0.1",
                port=port,
                capabilities=[],
                supported_encodings=[],
                context=self._context,
            )
        except (RuntimeError, OSError, OverflowError) as error:
            raise ConfigError(f"--foxglove {port}: {error}") from None
        self._channels: dict[str, Channel] = {}
        self._offsets_ns: dict[str, int] = {}
        self._once: dict[tuple[str, str], bytes] = {}
        self._again_ns = 0

    @property
    def port(self) -> int:
        """Where it listens."""
        return self._server.port

    def see(self, boat: str, topic: str, data: bytes, unix_ns: int) -> None:
        """One checked sample: JSON of a `ShoreMessage`. `unix_ns`: now, by our own clock."""
        sample = shore.decode(topic, data)
        if isinstance(sample, shore.About):
            self._offsets_ns[boat] = sample.unix_minus_t_ns
        offset_ns = self._offsets_ns.get(boat)
        at_ns = unix_ns if offset_ns is None else sample.t_ns + offset_ns
        self._sample(boat, topic, data, at_ns)
        if topic in ONCE:
            self._once[boat, topic] = data
        if isinstance(sample, shore.StateNow):
            self._again(unix_ns, at_ns)
            self._log(f"/{boat}/pose", pose_in_frame(at_ns, sample.north_m, sample.east_m, sample.psi_rad), at_ns)
        elif isinstance(sample, shore.AlertTold):
            self._log(f"/{boat}/log", log_line(at_ns, sample.level, sample.text, boat), at_ns)

    def close(self) -> None:
        """No more clients."""
        self._server.stop()

    def _again(self, unix_ns: int, at_ns: int) -> None:
        if abs(unix_ns - self._again_ns) < AGAIN_NS:
            return
        self._again_ns = unix_ns
        self._log("/tf", world_from_ned(at_ns), at_ns)
        for (boat, topic), data in self._once.items():
            self._sample(boat, topic, data, at_ns)

    def _sample(self, boat: str, topic: str, data: bytes, at_ns: int) -> None:
        kind = shore.TOPICS[topic]
        self._channel(f"/{boat}/{topic}", kind, f"aritra.{topic}.{shore.VERSION}").log(data, log_time=at_ns)

    def _log(self, name: str, message: PoseInFrame | Log | FrameTransform, at_ns: int) -> None:
        kind = type(message)
        self._channel(name, kind, f"foxglove.{kind.__name__}").log(_ENCODER.encode(message), log_time=at_ns)

    def _channel(self, name: str, kind: type[Any], schema: str) -> Channel:
        if name not in self._channels:
            described = Schema(name=schema, encoding="jsonschema", data=viewer_schema(kind, schema))
            self._channels[name] = Channel(name, schema=described, message_encoding="json", context=self._context)
        return self._channels[name]
