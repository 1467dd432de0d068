"""The UWB tag's link: when it counts as silent, and the commands to the tag's shell."""

from __future__ import annotations

from companion.boat.recorder import Recorder
from drivers.link import DeviceLink, LinkTiming
from drivers.uwb import UwbCodec

STALE_PERIODS = 2.5
LOST_S = 20.0
"""A tag's cycles jitter, and a DWM1001 takes 5-20 s from opening its port to its first range."""
RETRY_S = 0.25
"""A tag is plugged in while all else waits for it: its port is tried so often. Assumed."""


class UwbTagLink:
    """The sending side of the link to the tag."""

    def __init__(self, link: DeviceLink, codec: UwbCodec, recorder: Recorder) -> None:
        self._link, self._codec, self._recorder = link, codec, recorder
        self._open = False

    def step(self, t_ns: int) -> None:
        """Send what the codec wants to say at `t_ns` [ns]; its start bytes, once the port is open."""
        before, self._open = self._open, self._link.is_open
        begins = self._open and not before
        for data in (self._codec.start_bytes() if begins else []) + self._codec.step(t_ns):
            if self._link.send(data):
                self._recorder.record_raw("uwb", "tx", data)


def uwb_timing(rate_hz: float) -> LinkTiming:
    """When a tag that measures at `rate_hz` counts as stale and as lost."""
    stale_s = max(LinkTiming().stale_after_s, STALE_PERIODS / rate_hz)
    return LinkTiming(stale_after_s=stale_s, lost_after_s=max(LOST_S, 2 * stale_s), backoff_max_s=RETRY_S)
