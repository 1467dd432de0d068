"""The stops that are tried on every autopilot, by wiring: what stops the boat, and what gives back what it took."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from tests.support.autopilots.ground_station import (
    FORCED_REBOOT,
    SAFETY_OFF,
    SAFETY_ON,
    SCRIPTS_RESTART,
    SCRIPTS_STOP,
)
from tests.support.autopilots.stop_trial import NEUTRAL_S, Act, Stop, Trial

MANUAL, ACRO, HOLD, GUIDED = 0, 1, 4, 15
ARM, DISARM = (400, 1), (400, 0)


def _nothing(trial: Trial) -> None:
    """The companion is gone: nobody does anything."""


def _cut(trial: Trial) -> None:
    trial.watched.cut = True


def _join(trial: Trial) -> None:
    trial.watched.cut = False


def _held(trial: Trial) -> None:
    """SIGSTOP for 6 s, then SIGCONT: what the autopilot has sent meanwhile comes at once."""
    trial.watched.held = True
    trial.go(6.0, alive=False)
    trial.watched.held = False


def _ordered(*command: float) -> Act:
    return lambda trial: trial.station.command(int(command[0]), *command[1:])


def _mode(number: int) -> Act:
    return lambda trial: trial.station.mode(number)


def _disarm_and_arm(trial: Trial) -> None:
    trial.station.command(*DISARM)
    trial.go(0.3)
    trial.station.command(*ARM)


def _arm_later(trial: Trial) -> None:
    """A real firmware refuses to arm for some 20 s after its start."""
    trial.go(26.0)
    trial.station.command(*ARM)


def _press_and_release(trial: Trial) -> None:
    trial.station.command(*SAFETY_ON)
    trial.go(0.3)
    trial.station.command(*SAFETY_OFF)


SAFETY = Stop("safety switch pressed, released", _ordered(*SAFETY_ON), _ordered(*SAFETY_OFF))
SCRIPT = Stop("script stopped, started again", _ordered(*SCRIPTS_STOP), _ordered(*SCRIPTS_RESTART))
REBOOT = Stop("forced reboot, armed by a ground station 30 s later", _ordered(*FORCED_REBOOT), _arm_later)
KILLED = Stop("companion killed", _nothing, alive=False, mode="")
CUT = Stop("link cut, joined again", _cut, _join)
ENDED = Stop("SIGINT, SIGTERM: end of the run", Trial.end_of_the_run, alive=False, mode="")
ANY_WIRING = (
    KILLED,
    Stop("companion stopped for 6 s (SIGSTOP, SIGCONT)", _held),
    CUT,
    ENDED,
    SAFETY,
    Stop("safety switch pressed for 0.3 s", _press_and_release),
    Stop("operator's stop", lambda trial: trial.command("stop"), mode="idle"),
)
GATE = (
    *ANY_WIRING,
    Stop("disarmed, armed by a ground station", _ordered(*DISARM), _ordered(*ARM)),
    Stop("disarmed and armed within 0.3 s", _disarm_and_arm),
    Stop("HOLD, then MANUAL by a ground station", _mode(HOLD), _mode(MANUAL)),
    REBOOT,
    SCRIPT,
    Stop("script stopped and started in one go", _ordered(*SCRIPTS_RESTART)),
)
POSITIONED = (
    Stop("GUIDED, then MANUAL by a ground station", _mode(GUIDED), _mode(MANUAL), before_s=20.0),
    Stop("ACRO, then MANUAL by a ground station", _mode(ACRO), _mode(MANUAL), before_s=20.0),
)
"""Modes that an autopilot enters armed only with a position, which it has from 18 s after arming on (observed)."""


def _battery(trial: Trial) -> None:
    trial.station.parameter("SIM_BATT_VOLTAGE", 14.5)


def _hand(trial: Trial) -> None:
    trial.watched.world.receiver_us = (*STICKS_US[:5], 1900, *STICKS_US[6:])


def _hand_off(trial: Trial) -> None:
    trial.watched.world.receiver_us = STICKS_US


STICKS_US = (1500,) * 16
"""A receiver of 16 channels, sticks in the middle; those of the thrusters as docs/autopilot.md asks for."""
BATTERY = {"BATT_LOW_VOLT": 15.0, "BATT_LOW_TIMER": 1.0, "BATT_FS_LOW_ACT": 2.0}
"""The autopilot's own battery fail-safe: HOLD a second after the pack is below 15 V; the companion's limit is lower."""


class StopSet(NamedTuple):
    """Stops with one configuration. `simulated`: the simulated autopilot has all of it, too."""

    stops: tuple[Stop, ...]
    wiring: str = "gate"
    gps: bool = False
    receiver_us: tuple[int, ...] = ()
    parameters: Mapping[str, float] = MappingProxyType({})
    simulated: bool = True


ALL: Mapping[str, StopSet] = MappingProxyType(
    {
        "gate": StopSet(GATE),
        "scaled": StopSet(ANY_WIRING, wiring="scaled", parameters={"SERVO8_FUNCTION": 94.0}),
        "gate with a receiver": StopSet(
            (KILLED, CUT, SAFETY, SCRIPT, Stop("a hand on the transmitter", _hand, _hand_off)), receiver_us=STICKS_US
        ),
        "gate with GPS": StopSet(POSITIONED, gps=True, simulated=False),
        "battery": StopSet(
            (Stop("battery fail-safe of the autopilot, 1 s after", _battery, neutral_s=1.0 + NEUTRAL_S),),
            parameters=BATTERY,
            simulated=False,
        ),
    }
)
"""Sets by name. `scaled`: arming wants a scripting output on 4.6, which function 94 is."""
