"""Fail-safes: radio (FS_THR_ENABLE) and ground station (FS_GCS_ENABLE), acting FS_TIMEOUT after they began.

Radio: no input for 0.5 s, or the throttle channel below FS_THR_VALUE. Ground station: nothing from
SYSID_MYGCS for FS_GCS_TIMEOUT, once it has been heard. Overrides count as being heard, so this one never
fires while they flow. Neither acts in HOLD. The action clears all overrides, then does FS_ACTION:
0 nothing, 1-4 HOLD (the returns home need a position), 5 disarm. As in the firmware's source, the text names
the check that noticed that time was up, which may be "Radio" where the ground station is what was lost.
"""

from __future__ import annotations

from collections.abc import Callable

from sim.world.autopilot.modes import Mode, ModeControl
from sim.world.autopilot.parameters import ParameterStore
from sim.world.autopilot.rc import RcInput

RADIO, GCS = 1, 2
_RADIO_LOSS_NS = 500_000_000
_S = 1_000_000_000
_WARNING, _INFO = 4, 6
_DISARM = 5


class Failsafe:
    """`bits`: conditions that hold now; `triggered`: those that were acted upon."""

    def __init__(self, parameters: ParameterStore, rc: RcInput, modes: ModeControl, say: Callable[[int, str], None]):
        self._parameters, self._rc, self._modes, self._say = parameters, rc, modes, say
        self._since_ns = 0
        self.bits = 0
        self.triggered = 0
        self.gcs_heard_ns: int | None = None

    @property
    def rc_valid(self) -> bool:
        """Whether the firmware believes its RC input: with FS_THR_ENABLE = 0 it does so for ever."""
        return self._rc.last_input_ns is not None and not self.bits & RADIO

    def advance(self, t_ns: int) -> None:
        """Evaluate both conditions at t."""
        p = self._parameters
        if p["FS_THR_ENABLE"]:
            throttle = self._rc.radio_in_us[int(p["RCMAP_THROTTLE"]) - 1]
            last_ns = self._rc.last_input_ns
            silent = last_ns is None or t_ns - last_ns > _RADIO_LOSS_NS
            self._set(RADIO, "Radio", silent or throttle < p["FS_THR_VALUE"], t_ns)
        if p["FS_GCS_ENABLE"] and self.gcs_heard_ns is not None:
            lost = t_ns - self.gcs_heard_ns > p["FS_GCS_TIMEOUT"] * _S
            self._set(GCS, "GCS", lost, t_ns)

    def _set(self, bit: int, name: str, on: bool, t_ns: int) -> None:
        before = self.bits
        self.bits = before | bit if on else before & ~bit
        if not before and self.bits:
            self._since_ns = t_ns
        if self.triggered and not self.bits:
            self._say(_INFO, f"{name} Failsafe Cleared")
        self.triggered &= self.bits
        overdue = t_ns - self._since_ns > self._parameters["FS_TIMEOUT"] * _S
        if self.bits and not self.triggered and overdue and self._modes.mode is not Mode.HOLD:
            self._act(name)

    def _act(self, name: str) -> None:
        self.triggered = self.bits
        self._say(_WARNING, f"{name} Failsafe")
        self._rc.clear_overrides()
        action = self._parameters["FS_ACTION"]
        if action == _DISARM:
            self._modes.disarm()
        elif action:
            self._modes.set_mode(Mode.HOLD)
