"""Whether the autopilot obeys: RC_CHANNELS and SERVO_OUTPUT_RAW against the leases of the recent past.

RC_CHANNELS shows which pulses the autopilot believes to receive: ours, or overrides are not taken. SERVO_OUTPUT_RAW
shows what leaves it, on the outputs that `sent_pulses` names. An echo, either of the two, agrees if it is what was sent
at any instant of the half second before it (neutral where a lease had run out). A disagreement counts after
`PERSISTS_NS`; its alert names the parameters to look at. Overrides that are not taken are a condition of the mode
table, channels that only the pilot's transmitter moves are an event of it. Outputs that are dead, or still though the
thrusters are to turn, are `output_monitor`'s.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from msgspec.structs import replace

from companion.core.constants import NEUTRAL_US
from companion.core.messages import Alert, OverrideLease, ParamValue, RcChannels, ServoOutput
from companion.core.pilot.modes import Event
from companion.core.pilot.monitors.monitor import NOTHING, Monitor, MonitorReport, TickView
from companion.core.pilot.monitors.override_hints import rc_hint, servo_hint
from companion.core.pilot.monitors.sent_pulses import (
    SentPulses,
    at_lease,
    at_parameter,
    expected_pulses,
    nothing_turns,
    outputs_of,
)

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


class OverrideState(SentPulses, frozen=True):
    """`base_us`: channels as the transmitter had them.

    `rc_ns`, `servo_ns`: latest echoes; `rc_bad_ns`, `servo_bad_ns`: since when they disagree; `episodes`: begins of
    recent disagreements of RC_CHANNELS; `agreed_us`: our channels when they last agreed; `rc_why`, `servo_fault`,
    `silent`: what the latest alerts are about.
    """

    base_us: tuple[int, ...] = ()
    rc_ns: int | None = None
    servo_ns: int | None = None
    rc_bad_ns: int | None = None
    agreed_us: tuple[int, ...] = ()
    rc_why: str = ""
    episodes: tuple[int, ...] = ()
    rc_ignored: bool = False
    servo_bad_ns: int | None = None
    servo_fault: str = ""
    silent: frozenset[str] = frozenset()


NOTHING_SENT = OverrideState()


class OverrideMonitor(Monitor[OverrideState]):
    """Condition `override_ignored`, event `rc_takeover`, and alerts.

    `channels`: RC channels as in the lease, those of the `thrusters` first; `system_id`: ours.
    """

    hears = (OverrideLease, RcChannels, ServoOutput, ParamValue)
    initial = NOTHING_SENT

    def __init__(self, channels: tuple[int, ...], thrusters: int, system_id: int):
        self._channels, self._thrusters, self._system_id = channels, thrusters, system_id

    def on_message(self, state: OverrideState, message: Any, t_ns: int) -> tuple[OverrideState, MonitorReport]:
        """What was sent, an echo, or a parameter."""
        if isinstance(message, OverrideLease):
            return at_lease(state, message), NOTHING
        if isinstance(message, ParamValue):
            return at_parameter(state, message, self._channels[: self._thrusters]), NOTHING
        if isinstance(message, RcChannels):
            state, events = at_rc(state, message, self._channels, self._system_id)
            return state, MonitorReport(events)
        state, alerts = at_servo(state, message, self._thrusters)
        return state, MonitorReport(alerts=tuple(alerts))

    def on_tick(self, state: OverrideState, view: TickView) -> tuple[OverrideState, MonitorReport]:
        """Overrides that are ignored, and echoes that do not come from an autopilot that is alive."""
        if not view.autopilot_alive:
            return replace(state, rc_ns=None, servo_ns=None), NOTHING
        conditions: dict[Event, str] = {"override_ignored": state.rc_why} if state.rc_ignored else {}
        if not state.sent:
            return replace(state, rc_ns=None, servo_ns=None), MonitorReport(conditions)
        state, alerts = _silent_echoes(state, view.t_ns)
        return state, MonitorReport(conditions, alerts)


def at_rc(
    state: OverrideState, message: RcChannels, channels: Sequence[int], system_id: int
) -> tuple[OverrideState, dict[Event, str]]:
    """What an RC_CHANNELS says of our overrides, and of the pilot's hands. `channels`: ours, as in the lease."""
    t_ns = message.t_ns
    state, events = _hands(replace(state, rc_ns=t_ns), message, channels)
    shown = expected_pulses(state, t_ns)
    wrong = _wrong(message.pwm_us, [c - 1 for c in channels], shown)
    ours = tuple(message.pwm_us[c - 1] for c in channels if c <= len(message.pwm_us))
    if not shown:
        return state, events
    begun = () if not wrong or state.rc_bad_ns is not None else (t_ns,)
    state = replace(state, episodes=(*(e for e in state.episodes if t_ns - e < EPISODES_NS), *begun))
    in_turns = len(state.episodes) >= EPISODES
    if not wrong:
        return replace(state, rc_bad_ns=None, rc_ignored=in_turns, agreed_us=ours), events
    earlier = ours == state.agreed_us or any(ours == pwm_us for _, _, pwm_us in state.sent)
    since_ns = t_ns if state.rc_bad_ns is None else state.rc_bad_ns
    ignored = in_turns or t_ns - since_ns >= PERSISTS_NS
    why = rc_hint([channels[i] for i in wrong], len(channels), message.pwm_us, system_id, earlier=earlier)
    return replace(state, rc_bad_ns=since_ns, rc_ignored=ignored, rc_why=why), events


def at_servo(state: OverrideState, message: ServoOutput, thrusters: int) -> tuple[OverrideState, list[Alert]]:
    """What a SERVO_OUTPUT_RAW says of the `thrusters`' outputs."""
    t_ns = message.t_ns
    state = replace(state, servo_ns=t_ns)
    shown = [pwm_us[:thrusters] for pwm_us in expected_pulses(state, t_ns)]
    at_rest = bool(shown) and all(set(pwm_us) == {NEUTRAL_US} for pwm_us in shown)
    if at_rest:
        shown = [*shown, (0,) * thrusters]  # no pulse is neutral, too
    numbers = outputs_of(state, thrusters)
    wrong = _wrong(message.pwm_us, [n - 1 for n in numbers], shown) if shown else []
    pulses = {n: message.pwm_us[n - 1] if n <= len(message.pwm_us) else 0 for n in numbers}
    if wrong and not at_rest and nothing_turns(pulses.values()):
        return replace(state, servo_bad_ns=None), []
    if not wrong:
        text = "the autopilot's outputs follow again" if state.servo_fault else ""
        alerts = [Alert(t_ns=t_ns, level="info", text=text)] if text else []
        return replace(state, servo_bad_ns=None, servo_fault=""), alerts
    since_ns = t_ns if state.servo_bad_ns is None else state.servo_bad_ns
    state = replace(state, servo_bad_ns=since_ns)
    if t_ns - since_ns < PERSISTS_NS or state.rc_bad_ns is not None:  # overrides that are not taken: reported already
        return state, []
    kind, why = servo_hint([numbers[k] for k in wrong], pulses, at_rest)
    if kind == state.servo_fault:
        return state, []
    return replace(state, servo_fault=kind), [Alert(t_ns=t_ns, level="error", text=why)]


def _silent_echoes(state: OverrideState, t_ns: int) -> tuple[OverrideState, tuple[Alert, ...]]:
    """Alert, once each, of echoes that have not come for `SILENT_NS`."""
    rc_ns = t_ns if state.rc_ns is None else state.rc_ns
    servo_ns = t_ns if state.servo_ns is None else state.servo_ns
    latest_ns = {"RC_CHANNELS": rc_ns, "SERVO_OUTPUT_RAW": servo_ns}
    silent = frozenset(name for name, last_ns in latest_ns.items() if t_ns - last_ns > SILENT_NS)
    alerts = tuple(
        Alert(
            t_ns=t_ns,
            level="warning",
            text=f"no {name} for {SILENT_NS * 1e-9:g} s: whether the autopilot does what it is told cannot be seen; "
            "look at SRn_RC_CHAN (4.7: MAVn_RC_CHAN) and SCHED_LOOP_RATE, and at the rate of the link",
        )
        for name in sorted(silent - state.silent)
    )
    return replace(state, rc_ns=rc_ns, servo_ns=servo_ns, silent=silent), alerts


def _hands(state: OverrideState, message: RcChannels, ours: Sequence[int]) -> tuple[OverrideState, dict[Event, str]]:
    """Channels that only a transmitter moves."""
    base = state.base_us or message.pwm_us
    moved = [
        i + 1
        for i, (was, now) in enumerate(zip(base, message.pwm_us, strict=False))
        if i + 1 not in ours and was in _PULSE and now in _PULSE and abs(now - was) >= MOVED_US
    ]
    if moved:
        positions = ", ".join(f"{c} from {base[c - 1]} to {message.pwm_us[c - 1]} us" for c in moved)
        return replace(state, base_us=message.pwm_us), {"rc_takeover": f"the pilot moved RC channel {positions}"}
    kept = tuple(now if was not in _PULSE else was for was, now in zip(base, message.pwm_us, strict=False))
    return replace(state, base_us=kept), {}


def _wrong(pulses: Sequence[int], places: Sequence[int], shown: Sequence[tuple[int, ...]]) -> list[int]:
    """Which of `places` (by position) show none of the pulses that were sent."""
    return [
        k
        for k, place in enumerate(places)
        if place >= len(pulses) or all(abs(pulses[place] - pwm_us[k]) > TOLERANCE_US for pwm_us in shown)
    ]
