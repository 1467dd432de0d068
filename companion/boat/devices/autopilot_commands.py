"""Everything that the boat sends to the autopilot: recorded, and shown to the ground station that looks on."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from companion.boat.gcs_forward import GcsForward
from companion.boat.position_feed import PositionFeed
from companion.boat.recorder import Recorder
from companion.core.messages import OverrideLease, StateEstimate, VehicleRequest
from drivers.link import DeviceLink
from drivers.mavlink.codec import MavlinkCodec

NEUTRAL_REPEATS = 10
NEUTRAL_PERIOD_S = 0.1
"""Neutral is sent ten times in a second before a release: without a receiver a release changes nothing."""

Attempt = Callable[[Callable[[], object]], None]
"""Calls what may fail, and does not fail itself."""


class AutopilotCommands:
    """The sending side of the MAVLink link. `channels`: those that the boat overrides."""

    def __init__(
        self,
        link: DeviceLink,
        codec: MavlinkCodec,
        channels: tuple[int, ...],
        recorder: Recorder,
        *,
        forward: GcsForward | None = None,
        position: PositionFeed | None = None,
    ) -> None:
        self._link, self._encoder, self._channels, self._recorder = link, codec.encoder, channels, recorder
        self._forward, self._position = forward, position

    def send(self, data: bytes) -> bool:
        """Send frames of ours; whether the port was open for them."""
        sent = self.pass_on(data)
        if sent and self._forward:
            self._forward.show_own(data)
        return sent

    def pass_on(self, frame: bytes) -> bool:
        """Send a frame of the ground station, or of ours, without showing it to the station."""
        if sent := self._link.send(frame):
            self._recorder.record_raw("mavlink", "tx", frame)
        return sent

    def override(self, lease: OverrideLease) -> bool:
        """Override the channels of a lease with its pulse widths."""
        return self.send(self._encoder.override(lease))

    def neutral(self) -> None:
        """Override all channels of the boat with neutral."""
        self.send(self._encoder.neutral(self._channels))

    async def rest(self, attempt: Attempt, pause: Callable[[], Awaitable[None]]) -> None:
        """Neutral, again and again for a second."""
        for _ in range(NEUTRAL_REPEATS):
            attempt(self.neutral)
            await pause()

    def leave(self, attempt: Attempt) -> None:
        """Neutral once more, disarm, and then give the channels back; each of them whatever became of the others."""
        attempt(self.neutral)
        attempt(lambda: self.send(self._encoder.disarm()))
        attempt(lambda: self.send(self._encoder.release(self._channels)))

    def request(self, request: VehicleRequest) -> None:
        """Request a mode, arming or disarming."""
        if request.action == "set_mode":
            self.send(self._encoder.set_mode(request.custom_mode or 0))
        else:
            self.send(self._encoder.arm() if request.action == "arm" else self._encoder.disarm())

    def position(self, estimate: StateEstimate, *, restarts: int, begins: int) -> None:
        """Our estimate for the autopilot's own filter, where the run file asks for it; see `PositionFeed.frames`."""
        if self._position:
            for frame in self._position.frames(estimate, restarts=restarts, begins=begins):
                self.send(frame)
