"""The link to a sensor with a wire of its own: when it counts as silent, and what its codec wants to say to it."""

from __future__ import annotations

from companion.boat.recorder import Recorder
from drivers.devices import DeviceCodec
from drivers.link import DeviceLink, LinkTiming

STALE_PERIODS = 2.5
LOST_S = 20.0
"""A tag's cycles jitter, and a DWM1001 takes 5-20 s from opening its port to its first range."""
RETRY_S = 0.25
"""A device is plugged in while all else waits for it: its port is tried so often. Assumed."""


class SensorDevice:
    """The sending side of the link to one sensor. `name`: its key in the vessel file; `recorder`: of what is sent."""

    def __init__(self, name: str, link: DeviceLink, codec: DeviceCodec, recorder: Recorder | None = None) -> None:
        self.name, self.link = name, link
        self._codec, self._recorder = codec, recorder
        self._open = False

    def step(self, t_ns: int) -> None:
        """Send what the codec wants to say at `t_ns` [ns]; its start bytes, once the port is open."""
        before, self._open = self._open, self.link.is_open
        begins = self._open and not before
        for data in (self._codec.start_bytes() if begins else []) + self._codec.step(t_ns):
            if self.link.send(data) and self._recorder:
                self._recorder.record_raw(self.name, "tx", data)


def device_timing(rate_hz: float) -> LinkTiming:
    """When a sensor that measures at `rate_hz` counts as stale and as lost."""
    stale_s = max(LinkTiming().stale_after_s, STALE_PERIODS / rate_hz)
    return LinkTiming(stale_after_s=stale_s, lost_after_s=max(LOST_S, 2 * stale_s), backoff_max_s=RETRY_S)
