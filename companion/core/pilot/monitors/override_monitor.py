"""Does the autopilot do what it is told? RC_CHANNELS and SERVO_OUTPUT_RAW against the leases of the recent past.

RC_CHANNELS shows which pulses the autopilot believes to receive: ours, or overrides are not taken. SERVO_OUTPUT_RAW
shows what leaves it: each thruster's pulse on the output that carries it by SERVOn_FUNCTION, and until the autopilot
has told that, on outputs 1 to n in the vessel file's order, as our parameter files wire them. An echo agrees if it is
what was sent at any instant of the half second before it (neutral where a lease had run out). A disagreement counts
after `PERSISTS_NS` and is told with the parameters to look at; overrides that are not taken are a condition of the mode
table, and so are channels that only the pilot's transmitter moves.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from companion.core.messages import Alert, OverrideLease, ParamValue, RcChannels, ServoOutput
from companion.core.model.thrusters import NEUTRAL_US
from companion.core.pilot.modes import Event
from companion.core.preflight.wiring import output

WINDOW_NS = 500_000_000
"""How far back a lease may explain an echo: 0.1 s a tick, 64 ms of the gate at 50 Hz (observed), stamps; assumed."""
SLACK_NS = 50_000_000
"""An echo's stamp may run ahead of the lease it shows, by the error of the clock offset; assumed."""
TOLERANCE_US = 1
"""Rounding of RCnScaled, 1:1 as in our parameter file."""
PERSISTS_NS = 1_500_000_000
"""Ten RC_CHANNELS at 6.5 Hz in a row; assumed: a few lost overrides are no fault of the wiring."""
EPISODES, EPISODES_NS = 3, 5_000_000_000
"""So often within so long right channels became wrong ones: two senders take turns. Assumed: where every second frame
is broken, overrides are missing for half a second once in twelve seconds. One whose pulses hold for less than some
15 ms of each tenth of a second stays unseen."""
SILENT_NS = 5_000_000_000
"""Both echoes come at 6.5 and 10 Hz, slower while parameters are downloaded; assumed."""
MOVED_US = 200
"""A channel that is not ours and moved so far was moved by a hand; assumed: half of a stick's half travel."""
_PULSE = range(800, 2201)
_FUNCTION = re.compile(r"SERVO([1-9]\d?)_FUNCTION\Z")
_REMEMBERED = 50
"""Leases: at 50 Hz, the quickest period, the window and half a second of delay on the way."""


@dataclass(frozen=True)
class OverrideState:
    """`sent`: (from, until [ns], pulses [us]) of the latest leases; `base_us`: channels as the transmitter had them;
    `rc_bad_ns`, `servo_bad_ns`: since when they disagree; `episodes`: when channels began to, of late; `told`: what is
    known to be wrong, by echo; `carries`: output (from 1) -> thruster (from 0), as the autopilot told.
    """

    sent: tuple[tuple[int, int, tuple[int, ...]], ...] = ()
    base_us: tuple[int, ...] = ()
    rc_ns: int | None = None
    servo_ns: int | None = None
    rc_bad_ns: int | None = None
    rc_why: str = ""
    episodes: tuple[int, ...] = ()
    rc_ignored: bool = False
    servo_bad_ns: int | None = None
    servo_told: str = ""
    silent_told: frozenset[str] = frozenset()
    carries: Mapping[int, int] = field(default_factory=dict)


NOTHING_SENT = OverrideState()


def at_lease(echo: OverrideState, lease: OverrideLease) -> OverrideState:
    """Remember what was sent."""
    until_ns = lease.t_ns + round(lease.valid_for_s * 1e9)
    return replace(echo, sent=(*echo.sent, (lease.t_ns, until_ns, lease.pwm_us))[-_REMEMBERED:])


def expected_pulses(echo: OverrideState, t_ns: int) -> list[tuple[int, ...]]:
    """Pulses that an echo of `t_ns` may show, in the order of the lease's channels; none: nothing was sent by then."""
    found: list[tuple[int, ...]] = []
    for k, (begin_ns, end_ns, pwm_us) in enumerate(echo.sent):
        if begin_ns > t_ns + SLACK_NS:
            break
        after_ns = min(t_ns + SLACK_NS, echo.sent[k + 1][0] if k + 1 < len(echo.sent) else t_ns + SLACK_NS)
        if min(end_ns, after_ns) >= t_ns - WINDOW_NS:
            found.append(pwm_us)
        if end_ns < after_ns and after_ns >= t_ns - WINDOW_NS:
            found.append((NEUTRAL_US,) * len(pwm_us))
    return found


def at_rc(
    echo: OverrideState, message: RcChannels, channels: Sequence[int], system_id: int
) -> tuple[OverrideState, list[tuple[Event, str]]]:
    """What an RC_CHANNELS says of our overrides, and of the pilot's hands. `channels`: ours, as in the lease."""
    t_ns = message.t_ns
    echo, taken = _hands(replace(echo, rc_ns=t_ns), message, channels)
    shown = expected_pulses(echo, t_ns)
    wrong = _wrong(message.pwm_us, [c - 1 for c in channels], shown)
    if not shown:
        return echo, taken
    begun = () if not wrong or echo.rc_bad_ns is not None else (t_ns,)
    echo = replace(echo, episodes=(*(e for e in echo.episodes if t_ns - e < EPISODES_NS), *begun))
    in_turns = len(echo.episodes) >= EPISODES
    if not wrong:
        return replace(echo, rc_bad_ns=None, rc_ignored=in_turns), taken
    since_ns = t_ns if echo.rc_bad_ns is None else echo.rc_bad_ns
    ignored = in_turns or t_ns - since_ns >= PERSISTS_NS
    why = _rc_why([channels[i] for i in wrong], len(channels), message.pwm_us, system_id)
    return replace(echo, rc_bad_ns=since_ns, rc_ignored=ignored, rc_why=why), taken


def at_parameter(echo: OverrideState, message: ParamValue, channels: Sequence[int]) -> OverrideState:
    """A SERVOn_FUNCTION tells which thruster output n carries; other parameters nothing. `channels`: the thrusters'."""
    if not (found := _FUNCTION.match(message.name)) or not math.isfinite(message.value):
        return echo
    number = int(found[1])
    carries = {n: thruster for n, thruster in echo.carries.items() if n != number}
    told = output(number, round(message.value), channels)
    return replace(echo, carries=carries if told.thruster is None else {**carries, number: told.thruster})


def outputs_of(echo: OverrideState, thrusters: int) -> list[int]:
    """The output (from 1) of each thruster: the lowest that carries it; its own number where none is known to."""
    carried = {thruster: number for number, thruster in sorted(echo.carries.items(), reverse=True)}
    return [carried.get(thruster, thruster + 1) for thruster in range(thrusters)]


def at_servo(echo: OverrideState, message: ServoOutput, thrusters: int) -> tuple[OverrideState, list[Alert]]:
    """What a SERVO_OUTPUT_RAW says of the `thrusters`' outputs."""
    t_ns = message.t_ns
    echo = replace(echo, servo_ns=t_ns)
    shown = [pwm_us[:thrusters] for pwm_us in expected_pulses(echo, t_ns)]
    at_rest = bool(shown) and all(set(pwm_us) == {NEUTRAL_US} for pwm_us in shown)
    if at_rest:
        shown = [*shown, (0,) * thrusters]  # no pulse is neutral, too
    numbers = outputs_of(echo, thrusters)
    wrong = _wrong(message.pwm_us, [n - 1 for n in numbers], shown) if shown else []
    if not wrong:
        text = "the autopilot's outputs follow again" if echo.servo_told else ""
        alerts = [Alert(t_ns=t_ns, level="info", text=text)] if text else []
        return replace(echo, servo_bad_ns=None, servo_told=""), alerts
    since_ns = t_ns if echo.servo_bad_ns is None else echo.servo_bad_ns
    echo = replace(echo, servo_bad_ns=since_ns)
    if t_ns - since_ns < PERSISTS_NS or echo.rc_bad_ns is not None:  # overrides that are not taken: told already
        return echo, []
    pulses = {n: message.pwm_us[n - 1] if n <= len(message.pwm_us) else 0 for n in numbers}
    kind, why = _servo_why([numbers[k] for k in wrong], pulses, at_rest)
    if kind == echo.servo_told:
        return echo, []
    return replace(echo, servo_told=kind), [Alert(t_ns=t_ns, level="error", text=why)]


def at_tick(echo: OverrideState, t_ns: int, *, heard: bool) -> tuple[OverrideState, dict[Event, str], list[Alert]]:
    """Conditions, and echoes that do not come. `heard`: heartbeats do."""
    found: dict[Event, str] = {"override_ignored": echo.rc_why} if echo.rc_ignored and heard else {}
    if not heard or not echo.sent:
        return replace(echo, rc_ns=None, servo_ns=None), found, []
    rc_ns = t_ns if echo.rc_ns is None else echo.rc_ns
    servo_ns = t_ns if echo.servo_ns is None else echo.servo_ns
    echo, told = replace(echo, rc_ns=rc_ns, servo_ns=servo_ns), list[Alert]()
    silent = {name for name, last_ns in (("RC_CHANNELS", rc_ns), ("SERVO_OUTPUT_RAW", servo_ns))
              if t_ns - last_ns > SILENT_NS}  # fmt: skip
    for name in sorted(silent - echo.silent_told):
        text = (
            f"no {name} for {SILENT_NS * 1e-9:g} s: whether the autopilot does what it is told cannot be seen; "
            "look at SRn_RC_CHAN and SCHED_LOOP_RATE, and at the rate of the link"
        )
        told.append(Alert(t_ns=t_ns, level="warning", text=text))
    return replace(echo, silent_told=frozenset(silent)), found, told


def _hands(
    echo: OverrideState, message: RcChannels, ours: Sequence[int]
) -> tuple[OverrideState, list[tuple[Event, str]]]:
    """Channels that only a transmitter moves."""
    base = echo.base_us or message.pwm_us
    moved = [
        i + 1
        for i, (was, now) in enumerate(zip(base, message.pwm_us, strict=False))
        if i + 1 not in ours and was in _PULSE and now in _PULSE and abs(now - was) >= MOVED_US
    ]
    if moved:
        told = ", ".join(f"{c} from {base[c - 1]} to {message.pwm_us[c - 1]} us" for c in moved)
        return replace(echo, base_us=message.pwm_us), [("rc_takeover", f"the pilot moved RC channel {told}")]
    kept = tuple(now if was not in _PULSE else was for was, now in zip(base, message.pwm_us, strict=False))
    return replace(echo, base_us=kept), []


def _wrong(pulses: Sequence[int], places: Sequence[int], shown: Sequence[tuple[int, ...]]) -> list[int]:
    """Which of `places` (by position) show none of the pulses that were sent."""
    return [
        k
        for k, place in enumerate(places)
        if place >= len(pulses) or all(abs(pulses[place] - pwm_us[k]) > TOLERANCE_US for pwm_us in shown)
    ]


def _rc_why(wrong: list[int], ours: int, pulses: Sequence[int], system_id: int) -> str:
    shows = ", ".join(f"{c} shows {pulses[c - 1]} us" for c in wrong[:4] if c <= len(pulses))
    if len(wrong) < ours:
        return (
            f"RC channel {shows}, which was not sent: somebody else overrides it too, or the receiver has it back; "
            "look for a second ground station with our system id, and at RC_OVERRIDE_TIME"
        )
    return (
        f"the autopilot does not take our overrides (RC channel {shows}): look at SYSID_MYGCS (4.7: MAV_GCS_SYSID), "
        f"which must be {system_id}, RC_OVERRIDE_TIME, which must not be 0, RC_OPTIONS, which must not have bit 1 "
        "(ignore overrides), and at a switch with RCn_OPTION 46"
    )


def _servo_why(wrong: list[int], pulses: Mapping[int, int], at_rest: bool) -> tuple[str, str]:
    """Kind of fault, and what to say. `wrong`: numbers of outputs; `pulses`: of all thrusters' outputs."""
    told = ", ".join(f"output {n} at {pulses[n]} us" for n in wrong)
    if at_rest:
        return "turning", (
            f"{told} though neutral is sent: the thruster may turn. Look at its SERVOn_FUNCTION, SERVOn_TRIM and "
            "SERVO_RC_FS_MSK, and at who else drives it (docs/autopilot.md)"
        )
    if all(pulse == 0 for pulse in pulses.values()):
        return "no pulse", (
            f"{told}, so no pulse leaves the autopilot: look at the safety switch (BRD_SAFETY_DEFLT) "
            "and SERVOn_FUNCTION"
        )
    if all(pulse == NEUTRAL_US for pulse in pulses.values()):
        return "shut", (
            f"{told} though the thrusters are to turn: the gate is shut. Look at SCR_ENABLE and gate.lua, at the "
            "autopilot's radio failsafe (FS_THR_ENABLE, channel 3), and at arming and mode"
        )
    return "other", (
        f"{told}, which was not sent: look at SERVOn_FUNCTION (94 to 97 with our gate), RCn_MIN, RCn_MAX, RCn_DZ, "
        "SERVOn_MIN, SERVOn_MAX and SERVOn_REVERSED; the mixers 33 to 36 cannot be driven"
    )
