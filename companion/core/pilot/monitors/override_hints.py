"""Texts for overrides and outputs that do not follow: what is wrong, and which parameters to look at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence


def rc_hint(wrong: list[int], ours: int, pulses: Sequence[int], system_id: int, *, earlier: bool) -> str:
    """Text for RC channels that show other pulses than ours. `wrong`: their numbers; `ours`: how many are ours;
    `earlier`: the pulses of all of ours are those of a lease further back.
    """
    shows = ", ".join(f"{c} shows {pulses[c - 1]} us" for c in wrong[:4] if c <= len(pulses))
    if earlier:
        return (
            f"RC channel {shows}, as was sent earlier: what we send to the autopilot comes late or not at all. Look at "
            "the wire from us to it (TX, baud rate, radio), and whether the autopilot, or its simulation, is too slow"
        )
    if len(wrong) < ours:
        return (
            f"RC channel {shows}, which was not sent: somebody else overrides it too, or the receiver has it back; "
            "look for a second ground station with our system id, and at RC_OVERRIDE_TIME"
        )
    return (
        f"the autopilot does not take our overrides (RC channel {shows}): look at SYSID_MYGCS (4.7: MAV_GCS_SYSID), "
        f"which must be {system_id}, RC_OVERRIDE_TIME, which must not be 0, RC_OPTIONS, which must not have bit 1 "
        "(ignore overrides), at a switch with RCn_OPTION 46, and at MAVLink signing: without its key nothing is taken"
    )


def servo_hint(wrong: list[int], pulses: Mapping[int, int], at_rest: bool) -> tuple[str, str]:
    """Kind of fault, and its text. `wrong`: numbers of outputs; `pulses` [us]: of all thrusters' outputs."""
    positions = ", ".join(f"output {n} at {pulses[n]} us" for n in wrong)
    if at_rest:
        return "turning", (
            f"{positions} though neutral is sent: the thruster may turn. Look at its SERVOn_FUNCTION, SERVOn_TRIM and "
            "SERVO_RC_FS_MSK, and at who else drives it (docs/autopilot.md)"
        )
    return "other", (
        f"{positions}, which was not sent: look at SERVOn_FUNCTION (94 to 97 with our gate), RCn_MIN, RCn_MAX, RCn_DZ, "
        "SERVOn_MIN, SERVOn_MAX and SERVOn_REVERSED; the mixers 33 to 36 cannot be driven"
    )


def dead_hint(pulses: Mapping[int, int]) -> str:
    """Text for outputs without a pulse. `pulses` [us]: of all thrusters' outputs."""
    numbers = ", ".join(map(str, pulses))
    return (
        f"no pulse leaves the autopilot (output {numbers}): look at its safety switch (BRD_SAFETY_DEFLT), at "
        "SERVOn_FUNCTION, and with our gate at SCR_ENABLE and gate.lua"
    )


def still_hint(pulses: Mapping[int, int]) -> str:
    """Text for outputs that stay at rest though the thrusters are to turn. `pulses` [us]: of all thrusters' outputs."""
    positions = ", ".join(f"output {n} at {pulse} us" for n, pulse in pulses.items())
    return (
        f"{positions} though the thrusters are to turn: the gate is shut, its script has stopped, or our overrides are "
        "not taken. Look at SCR_ENABLE and gate.lua, at the autopilot's radio failsafe (FS_THR_ENABLE, channel 3), at "
        "arming, mode and RC_OVERRIDE_TIME; the mixers 33 to 36 cannot be driven"
    )
