"""RC channels as the firmware sees them: overrides with a time-out each, over a receiver that may not exist.

What RC_CHANNELS_OVERRIDE means differs by channel:

    channels   release      leave alone     any other value
    1-8        0            65535           the pulse width, 65534 included
    9-16       65534        0, 65535        the pulse width
    17-18      ignored

A channel keeps its last pulse width until an override or a receiver gives it another: without a receiver
neither a release nor the end of the overrides changes anything. With one, channels it does not have read 0 once
no override holds them (the firmware's source, `RC_Channel::update` and `RCInput::read`). RC_OVERRIDE_TIME [s]: 0
refuses overrides, -1 never lets one expire.
"""

from __future__ import annotations

from collections.abc import Sequence

from sim.world.autopilot.parameter_table import CHANNELS
from sim.world.autopilot.parameters import ParameterStore

RELEASE = 0
_IGNORED = 65535
_RELEASE_HIGH = 65534
_S = 1_000_000_000


class RcInput:
    """`radio_in_us`: what each channel was last given (0: nothing yet). Times in ns."""

    def __init__(self, parameters: ParameterStore):
        self._parameters = parameters
        self._override_us = [RELEASE] * CHANNELS
        self._override_ns = [0] * CHANNELS
        self.radio_in_us = [0] * CHANNELS
        self.last_input_ns: int | None = None

    def override(self, values_us: Sequence[int], t_ns: int) -> None:
        """Take the channels of one RC_CHANNELS_OVERRIDE (18, channel 1 first)."""
        if self._parameters["RC_OVERRIDE_TIME"] == 0:
            return
        fresh = False
        for channel, value in enumerate(values_us[:CHANNELS]):
            high = channel >= 8
            if value == _IGNORED or (high and value == 0):
                continue
            self._override_us[channel] = RELEASE if high and value == _RELEASE_HIGH else value
            self._override_ns[channel] = t_ns
            fresh = True
        if fresh:
            self.last_input_ns = t_ns
            self._read(t_ns, ())

    def clear_overrides(self) -> None:
        """Forget every override (a fail-safe does this); the channels keep their last value."""
        self._override_us = [RELEASE] * CHANNELS

    def receiver(self, values_us: Sequence[int], t_ns: int) -> None:
        """Take a frame of a real receiver; an empty one means that there is none."""
        if values_us:
            self.last_input_ns = t_ns
            self._read(t_ns, values_us)

    def _read(self, t_ns: int, receiver_us: Sequence[int]) -> None:
        timeout_s = self._parameters["RC_OVERRIDE_TIME"]
        for channel in range(CHANNELS):
            value = self._override_us[channel]
            expired = timeout_s >= 0 and t_ns - self._override_ns[channel] >= timeout_s * _S
            if value != RELEASE and not expired:
                self.radio_in_us[channel] = value
            elif receiver_us:
                self.radio_in_us[channel] = receiver_us[channel] if channel < len(receiver_us) else 0
