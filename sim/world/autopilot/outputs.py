"""From RC channels to the 16 outputs: one function per SERVOn_FUNCTION wiring, and the time it takes.

    33-36    motors 1-4 of the Omni-X mixer (`mixer`), where FRAME_TYPE is 2.
    51-66    plain RCINn: the channel's last value, whatever the mode, arming or age. It stays for ever.
    94-97    Script1-4, written by a Lua gate where SCR_ENABLE was set at boot: the gate's channel only while
             armed, RC input valid and mode MANUAL, clamped to 1100-1900 us; else 1500 us. SERVOn_TRIM once the
             script has been stopped (`script`), no pulse where there is none.
    140-155  RCINnScaled: through RCn_MIN/TRIM/MAX/DZ to SERVOn_MIN/TRIM/MAX; SERVOn_TRIM in a radio
             fail-safe where SERVO_RC_FS_MSK names the channel, the last value where it does not.
    other    no pulses (0).

The safety switch cuts them all (0). From override to output it takes what was measured of the real firmware
(`companion.core.configuration.override_latency`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from functools import partial

from companion.core.configuration.override_latency import override_latency_s
from companion.core.constants import NEUTRAL_US
from sim.world.autopilot.failsafe import RADIO, Failsafe
from sim.world.autopilot.mixer import FACTORS, FIRST_FUNCTION, OMNI_X, OmniMixer
from sim.world.autopilot.modes import Mode, ModeControl
from sim.world.autopilot.parameter_table import CHANNELS
from sim.world.autopilot.parameters import ParameterStore
from sim.world.autopilot.rc import RcInput
from sim.world.autopilot.script import GateScript
from sim.world.autopilot.stick import pulse_us, share

GATE_MIN_US, GATE_MAX_US = 1100, 1900
_S = 1_000_000_000

Wiring = Callable[[int], int]
"""Takes the pulse width last commanded, gives the one wanted now [us]."""


def latency_ns(loop_rate_hz: float, *, script: bool = False) -> int:
    """`override_latency_s` [ns]."""
    return round(override_latency_s(loop_rate_hz, script=script) * _S)


class Outputs:
    """`pulses_us`: the 16 pulse widths that leave the autopilot at the last `advance` (0: no pulse)."""

    def __init__(
        self,
        parameters: ParameterStore,
        rc: RcInput,
        modes: ModeControl,
        failsafe: Failsafe,
        gate_channels: tuple[int, ...],
        script: GateScript,
    ):
        self._parameters, self._rc, self._modes, self._failsafe = parameters, rc, modes, failsafe
        self._gate_channels, self._script = gate_channels if script.exists else (), script
        self._t_ns = 0
        self._mixer = OmniMixer(parameters, rc, modes, failsafe)
        loop_rate_hz = parameters["SCHED_LOOP_RATE"]
        self._latency_ns, self._gate_latency_ns = latency_ns(loop_rate_hz), latency_ns(loop_rate_hz, script=True)
        self._wired: list[tuple[int, Wiring, int]] = []
        self._version = -1
        self._wanted_us = [0] * CHANNELS
        self._now_us = [0] * CHANNELS
        self._pending: list[deque[tuple[int, int]]] = [deque() for _ in range(CHANNELS)]
        self.pulses_us = (0,) * CHANNELS

    def advance(self, t_ns: int) -> None:
        """Work out what each output should do, and let through what was wanted long enough ago."""
        if self._version != self._parameters.version:
            self._version = self._parameters.version
            self._wired = [(i, *self._wiring(i)) for i in range(CHANNELS)]
        self._t_ns = t_ns
        self._script.advance(t_ns)
        self._mixer.advance(t_ns)
        changed = False
        for i, wiring, delay_ns in self._wired:
            wanted = 0 if self._modes.safety_on else wiring(self._wanted_us[i])
            pending = self._pending[i]
            if wanted != self._wanted_us[i]:
                self._wanted_us[i] = wanted
                pending.append((t_ns + delay_ns, wanted))
            while pending and pending[0][0] <= t_ns:
                self._now_us[i] = pending.popleft()[1]
                changed = True
        if changed:
            self.pulses_us = tuple(self._now_us)

    def due_before(self, end_ns: int) -> Iterator[tuple[int, tuple[int, ...]]]:
        """What changes between now and `end_ns`, in order: when [ns], and the 16 pulse widths from then on."""
        pulses_us = list(self._now_us)
        due = ((t_ns, i, us) for i, pending in enumerate(self._pending) for t_ns, us in pending if t_ns < end_ns)
        for t_ns, i, wanted_us in sorted(due):
            pulses_us[i] = wanted_us
            yield t_ns, tuple(pulses_us)

    def _wiring(self, output: int) -> tuple[Wiring, int]:
        function = int(self._parameters[f"SERVO{output + 1}_FUNCTION"])
        if FIRST_FUNCTION <= function < FIRST_FUNCTION + len(FACTORS) and self._parameters["FRAME_TYPE"] == OMNI_X:
            return partial(self._motor, output + 1, function - FIRST_FUNCTION), self._latency_ns
        if 51 <= function <= 66:
            return partial(self._plain, function - 51), self._latency_ns
        if 94 <= function < 94 + len(self._gate_channels):
            gate = partial(self._gated, output + 1, self._gate_channels[function - 94] - 1)
            return gate, self._gate_latency_ns
        if 140 <= function <= 155:
            return partial(self._scaled, output + 1, function - 140), self._latency_ns
        return self._unused, self._latency_ns

    def _motor(self, output: int, motor: int, last_us: int) -> int:
        return pulse_us(self._parameters, output, self._mixer.motors[motor])

    def _plain(self, channel: int, last_us: int) -> int:
        return self._rc.radio_in_us[channel]

    def _gated(self, output: int, channel: int, last_us: int) -> int:
        if self._script.ended:
            return last_us if self._script.writes(self._t_ns) else int(self._parameters[f"SERVO{output}_TRIM"])
        value = self._rc.radio_in_us[channel]
        passes = self._modes.armed and self._failsafe.rc_valid and self._modes.mode is Mode.MANUAL
        if not passes or value == 0:
            return NEUTRAL_US
        return max(GATE_MIN_US, min(GATE_MAX_US, value))

    def _scaled(self, output: int, channel: int, last_us: int) -> int:
        p = self._parameters
        if not self._failsafe.rc_valid:
            masked = int(p["SERVO_RC_FS_MSK"]) >> channel & 1
            return int(p[f"SERVO{output}_TRIM"]) if masked and self._failsafe.bits & RADIO else last_us
        return pulse_us(p, output, share(p, channel + 1, self._rc.radio_in_us[channel]))

    @staticmethod
    def _unused(last_us: int) -> int:
        return 0
