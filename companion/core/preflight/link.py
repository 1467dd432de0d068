"""Rows of the autopilot's link: streams, clocks, its outputs at rest, its RC receiver. Pure.

Thresholds without a source are assumed.
"""

from __future__ import annotations

import re
import statistics
from collections.abc import Iterable, Iterator, Mapping

from companion.core.constants import NEUTRAL_US
from companion.core.messages import StatusText
from companion.core.preflight.observations import Observations
from companion.core.preflight.rows import Level, ParameterSet, Row, numbers
from companion.core.preflight.wiring import BAND_US, Companion, Output, wiring

ROVER, BOAT = 10, 11
"""MAV_TYPE_GROUND_ROVER, MAV_TYPE_SURFACE_BOAT: what Rover firmware is. Mode 0 of any other is not MANUAL."""
STEERS = "the autopilot's own idea of what it steers"
VEHICLES: Mapping[int, tuple[Level, str, str]] = {
    BOAT: ("ok", STEERS, ""),
    ROVER: ("warning", STEERS, "set FRAME_CLASS to 2"),
}
"""Type of a heartbeat -> level, why, what to do."""
NO_ROVER: tuple[Level, str, str] = (
    "refuse", "no Rover firmware: its modes and fail-safes are others", "ArduPilot Rover on it, or our own wire",
)  # fmt: skip
MODES = {0: "MANUAL", 4: "HOLD", 5: "LOITER", 15: "GUIDED", 16: "INITIALISING"}
KNOWN_MINORS = (6, 7)
ENOUGH = 0.65
"""Share of a wanted rate that is good enough (as in the link's own watch)."""
VITAL = ("ATTITUDE", "RAW_IMU")
LOST_SHARE = 0.01
JITTER_S, ROUND_TRIP_S = 0.005, 0.05
LATE_NS = 500_000_000
"""A median round trip above is late: the override monitor looks back half a second, and cannot tell later pulses
from older ones. Assumed."""
PRE_ARM = "PreArm: "
WITHOUT_OVERRIDES = frozenset({"PreArm: Radio failsafe on"})
"""Complaints that end with the first override of a run (observed, without a receiver)."""
OLD_WALL_S = 1_735_689_600.0
"""2025-01-01: a date before it is a clock that was never set."""
_GATE = re.compile(r"gate: thrusters on channels ([\d ]+)")


def link_rows(observed: Observations, companion: Companion) -> Iterator[Row]:
    """The autopilot's heartbeat and firmware, lost frames, rates of its streams, clocks."""
    beat = observed.heartbeat
    if beat is None:
        yield _no_heartbeat(observed)
        return
    level, why, fix = VEHICLES.get(beat.vehicle_type, NO_ROVER)
    called = "boat" if beat.vehicle_type == BOAT else f"type {beat.vehicle_type}"
    yield Row(
        area="link", name="heartbeat", level=level,
        found=f"system {beat.system}, component {beat.component}, {called}",
        needed="a boat (type 11)", why=why, fix=fix,
    )  # fmt: skip
    if observed.strangers:
        named = observed.autopilot is not None
        yield Row(
            area="link", name="autopilots", level="ok" if named else "refuse",
            found=f"systems {beat.system}, {numbers(observed.strangers)}", needed="one, or ours named",
            why=f"{beat.system} is ours by the run file; nothing is taken from the others" if named
            else f"a run keeps to the one that speaks first, now {beat.system}, and would arm it",
            fix="" if named else "mavlink.autopilot_system_id of the run file = our SYSID_THISMAV (4.7: MAV_SYSID)",
        )  # fmt: skip
    if observed.deaf:
        yield Row(
            area="link", name="signing", level="refuse", found="the autopilot signs, and we have no key",
            needed="its key", why="it takes nothing unsigned on this port: no command, no override, no question",
            fix="name the key in the run file (mavlink.signing_key), or use the autopilot's USB port",
        )  # fmt: skip
    yield _firmware(observed)
    share = observed.lost / max(1, observed.received + observed.lost)
    level: Level = "ok" if share <= LOST_SHARE else "warning"
    yield Row(
        area="link", name="lost frames", level=level, found=f"{observed.lost} of {observed.received + observed.lost}",
        needed="at most 1 %", why="commands are lost as often as messages",
        fix="" if level == "ok" else "shorter cable, higher baud rate, fewer streams to others",
    )  # fmt: skip
    yield from _streams(observed)
    yield from _clocks(observed)


def _no_heartbeat(observed: Observations) -> Row:
    if observed.strangers:
        return Row(
            area="link", name="heartbeat", level="refuse", found=f"only of systems {numbers(observed.strangers)}",
            needed=f"of system {observed.autopilot}", why="another vehicle's autopilot is none of ours",
            fix="our autopilot's power and cable; mavlink.autopilot_system_id of the run file",
        )  # fmt: skip
    return Row(
        area="link", name="heartbeat", level="refuse",
        found=observed.mavlink.reason if observed.mavlink else "nothing was opened",
        needed="an autopilot's heartbeat at 1 Hz", why="nothing can be said about a boat that does not answer",
        fix="cable, baud rate, SERIALn_PROTOCOL 2; mavlink.url of the run file, or --mavlink",
    )  # fmt: skip


def _firmware(observed: Observations) -> Row:
    version = observed.info.flight_sw_version if observed.info else 0
    major, minor, patch = version >> 24, version >> 16 & 255, version >> 8 & 255
    known = major == 4 and minor in KNOWN_MINORS
    return Row(
        area="link", name="firmware", level="ok" if known else "warning",
        found=f"{major}.{minor}.{patch}" if observed.info else "version not told", needed="ArduPilot Rover 4.6 or 4.7",
        why="what these checks say was observed on those",
        fix="" if known else "check the fail-safes by hand, docs/autopilot.md",
    )  # fmt: skip


def _streams(observed: Observations) -> Iterator[Row]:
    denies = observed.info is not None and (observed.info.flight_sw_version >> 16 & 0xFFFF) >= 0x0407
    how = "4.7 denies" if denies else "4.6 silently caps"
    for name, wanted in observed.wanted_hz.items():
        rate = observed.rates_hz.get(name, 0.0)
        level: Level = "ok" if rate >= ENOUGH * wanted else "refuse" if name in VITAL and rate == 0 else "warning"
        yield Row(
            area="streams", name=name, level=level, found=f"{rate:.1f} Hz", needed=f"{wanted:g} Hz",
            why=f"{'the estimator lives on it' if name in VITAL else 'the companion watches it'}; {how} rates above "
            "80 % of SCHED_LOOP_RATE",
            fix="" if level == "ok" else "set SCHED_LOOP_RATE to 200 and reboot; a faster link",
        )  # fmt: skip


def _clocks(observed: Observations) -> Iterator[Row]:
    trips = observed.round_trips
    if trips:
        quick_s = 1.5 * min(t.took_s for t in trips) + 0.001
        offsets = [t.offset_s for t in trips if t.took_s <= quick_s]
        spread_s, took_s = statistics.pstdev(offsets), statistics.median(t.took_s for t in trips)
        fine = spread_s <= JITTER_S and took_s <= ROUND_TRIP_S
        found = f"round trip {1e3 * took_s:.1f} ms, offset known to {1e3 * spread_s:.1f} ms"
        level: Level = "refuse" if took_s > 1e-9 * LATE_NS else "ok" if fine else "warning"
        why = "sensor messages are put at the instant of their measurement by it"
        if level == "refuse":
            why = "what is sent arrives so late that the boat would be stopped as soon as it drives (docs/modes.md)"
        fix = "" if fine else "a faster link, or a less busy computer"
    else:
        found, level = "no answer to TIMESYNC", "warning"
        why = "an old firmware: a link that is late CANNOT BE SEEN under way, and does not stop the boat"
        fix = "newer firmware; until then a wire, not a radio, between companion and autopilot"
    yield Row(
        area="clock", name="autopilot", level=level, found=found,
        needed=f"round trip {1e3 * ROUND_TRIP_S:.0f} ms, offset to {1e3 * JITTER_S:.0f} ms", why=why, fix=fix,
    )  # fmt: skip
    newest_s = observed.disk.newest_s
    back = newest_s is not None and observed.wall_s < newest_s - 60.0
    fine = observed.wall_s >= OLD_WALL_S and not back
    yield Row(
        area="clock", name="boat's date", level="ok" if fine else "warning",
        found="earlier than the newest log" if back else "set" if fine else "never set", needed="the date",
        why="names of logs, and which of them are old; nothing that drives the boat uses it",
        fix="" if fine else "connect to a network with time servers, or set it by hand",
    )  # fmt: skip


def arming_complaints(texts: Iterable[StatusText]) -> list[str]:
    """What the autopilot says against arming, each once, but for what ends with a run's first override."""
    told = dict.fromkeys(text.text for text in texts if text.text.startswith(PRE_ARM))
    return [text for text in told if text not in WITHOUT_OVERRIDES]


# --- at rest ---------------------------------------------------------------------------------------


def rest_rows(observed: Observations, p: ParameterSet, companion: Companion) -> Iterator[Row]:
    """Armed, mode, arming checks, pulses of the outputs at rest, and a pilot's receiver."""
    beat = observed.heartbeat
    if beat is None:
        return
    yield Row(
        area="state", name="armed", level="refuse" if beat.armed else "ok", found="ARMED" if beat.armed else "disarmed",
        needed="disarmed", why="a check is made while nothing can turn", fix="disarm it" if beat.armed else "",
    )  # fmt: skip
    mode = MODES.get(beat.custom_mode, f"mode {beat.custom_mode}")
    calm = mode in ("MANUAL", "HOLD")
    yield Row(
        area="state", name="mode", level="ok" if calm else "warning", found=mode, needed="MANUAL or HOLD",
        why="`aritra run` asks for MANUAL when it starts", fix="" if calm else "wait, or set HOLD",
    )  # fmt: skip
    complaints = arming_complaints(observed.texts)
    if complaints:
        level, found = "refuse", "; ".join(complaints)
        fix = "mend what it says; sensors may need a minute after it was switched on: check again"
    elif observed.arming_told:
        level, found, fix = "ok", "no complaint", ""
    else:
        level, found, fix = "warning", "no answer", "check again; a better link"
    yield Row(
        area="state", name="arming checks", level=level, found=found, needed="no complaint",
        why="the autopilot refuses to arm while it complains", fix=fix,
    )  # fmt: skip
    yield from _gate_texts(observed, companion)
    if observed.servo and not beat.armed:
        yield from _resting(observed.servo.pwm_us, p, companion)
    if observed.rc:
        yield from _receiver(observed.rc.pwm_us, p, companion)


def _gate_texts(observed: Observations, companion: Companion) -> Iterator[Row]:
    mine = [channel for _, channel in companion.thrusters]
    for text in observed.texts:
        if not text.text.startswith("gate: "):
            continue
        found = _GATE.match(text.text)
        wrong = found is not None and list(map(int, found[1].split()))[: len(mine)] != mine
        if wrong or (found is None and text.severity <= 3):
            yield Row(
                area="state", name="gate.lua", level="refuse", found=text.text,
                needed=f"thrusters on channels {' '.join(map(str, mine))}",
                why="what the gate does not pass, does not drive",
                fix="edit the lists in gate.lua on the SD card (APM/scripts), reboot",
            )  # fmt: skip


def _resting(pulses_us: tuple[int, ...], p: ParameterSet, companion: Companion) -> Iterator[Row]:
    """Pulses of the thrusters' outputs while disarmed."""
    w = wiring(p, companion)
    motors = tuple(o for o in w.outputs if o.kind == "motor") if w.omni else ()
    for kind, outputs in (*((kind, w.of(kind)) for kind in ("script", "scaled", "plain")), ("motor", motors)):
        here = [o for o in outputs if o.number <= len(pulses_us)]
        if here:
            yield _resting_row(kind, here, [pulses_us[o.number - 1] for o in here])


def _resting_row(kind: str, outputs: list[Output], pulses: list[int]) -> Row:
    turning = any(us and abs(us - NEUTRAL_US) > BAND_US for us in pulses)
    silent = kind == "script" and not all(pulses)
    why, fix = "disarmed, so the thrusters must stand still", ""
    if turning:
        why = "a pulse that turns the thruster is on it NOW, disarmed as it is"
        fix = "take the thrusters' power away; safety switch; then mend the wiring"
    elif silent:
        why = "no pulse: the gate script does not run, or the safety switch is on; the boat would not move"
        fix = "copy gate.lua to APM/scripts (`aritra provision --wiring gate`), reboot; press the safety button"
    elif not any(pulses):
        why = "no pulse yet: speed controllers want 1500 us; the safety switch may be on"
    found = " ".join(map(str, pulses)) if len(set(pulses)) > 1 else str(pulses[0])
    return Row(
        area="state", name=f"output {numbers(o.number for o in outputs)}",
        level="refuse" if turning or silent else "ok",
        found=f"{found} us" if any(pulses) else "no pulse", needed="1500 us", why=why, fix=fix,
    )  # fmt: skip


def receiver_seen(pulses_us: tuple[int, ...], companion: Companion) -> bool:
    """Whether RC_CHANNELS comes from a receiver: channels that the companion never overrides have pulses, or its
    neutral ones have while its thrusters' have none (an earlier run would have left both).
    """
    pulses = {n: us for n, us in enumerate(pulses_us, start=1) if us}
    if set(pulses) - companion.channels:
        return True
    return bool(pulses) and not any(channel in pulses for _, channel in companion.thrusters)


def _receiver(pulses_us: tuple[int, ...], p: ParameterSet, companion: Companion) -> Iterator[Row]:
    """A pilot's receiver has the thrusters' channels once the companion is silent."""
    w = wiring(p, companion)
    if not receiver_seen(pulses_us, companion):
        throttle = p.whole("RCMAP_THROTTLE", 3)
        if throttle not in companion.channels and p.get("FS_THR_ENABLE"):
            yield Row(
                area="state", name="RC receiver", level="refuse", found="none",
                needed=f"one, or channel {throttle} held",
                why=f"channel {throttle}, the throttle, then says nothing: a lost radio, and the boat never arms",
                fix=f"add {throttle} to control.neutral_channels of the run file",
            )  # fmt: skip
            return
        yield Row(
            area="state", name="RC receiver", level="ok", found="none",
            needed="none, or thrusters' channels at 1500 us",
            why="without one, nobody but the companion and a ground station can act",
        )  # fmt: skip
        return
    at = {channel: pulses_us[channel - 1] for _, channel in companion.thrusters if channel <= len(pulses_us)}
    absent = [channel for channel, us in at.items() if us == 0]
    off = [channel for channel, us in at.items() if us and abs(us - NEUTRAL_US) > BAND_US]
    found, level, why, fix = "there", "ok", "its channels reach the thrusters when the companion is silent", ""
    if w.omni:
        why = "the pilot drives by channels 1, 3 and 4"
    elif absent and w.of("scaled"):
        found, level = f"there, without channels {numbers(absent)}", "refuse"
        why = "a channel that is not there reads 0: FULL REVERSE as soon as the companion is silent (source)"
        fix = "use the gate, or no receiver"
    elif off:
        found, level = f"channels {numbers(off)} at {' '.join(str(at[c]) for c in off)} us", "refuse"
        why = "these pulses DRIVE THE THRUSTERS as soon as the companion is silent"
        fix = "set them to 1500 us in the transmitter, or use a receiver of 8 channels"
    yield Row(
        area="state", name="RC receiver", level=level, found=found, needed="thrusters' channels at 1500 us", why=why,
        fix=fix
    )  # fmt: skip
