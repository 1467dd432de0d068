"""Does the boat stop? Every parameter of the autopilot that decides it, judged. Pure.

    names = wanted(companion)                       # what to ask the autopilot for
    rows = parameter_rows(Parameters(told), companion)

`refuse` where a thruster would keep its pulse, or start by itself, or not follow commands at all. Sources:
docs/autopilot.md (observed on ArduPilot Rover 4.6 and 4.7); what was only read in ArduPilot's parameter
reference says "(reference)".
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from companion.core.constants import NEUTRAL_US
from companion.core.preflight.rows import RENAMED, Level, ParameterSet, Row, number, numbers
from companion.core.preflight.wiring import (
    BAND_US,
    DRIVING,
    MORE_OUTPUTS,
    OUTPUTS,
    Companion,
    Output,
    Wiring,
    output_names,
    scaled_us,
    wiring,
)

AREA = "autopilot"
IGNORE_OVERRIDES, ONLY_GCS = 2, 1
"""Bits of RC_OPTIONS and of MAV_OPTIONS (reference)."""
LONGEST_OVERRIDE_S, GOOD_OVERRIDE_S = 3.0, 0.7
"""RC_OVERRIDE_TIME: ArduPilot's default, and what is worth having (assumed: the boat is neutral within 0.7 s)."""
SCRIPT_S, LATENCY_SLACK_S = 0.022, 0.015
"""What a script adds to the latency (measured at 50 Hz), and how far off the run file's latency may be (assumed)."""
GOOD_LOOP_HZ = 63
"""80 % of it is 50 Hz, the rate of the streams."""
VISION = {"VISO_TYPE": 1, "EK3_SRC1_POSXY": 6, "EK3_SRC1_VELXY": 0, "GPS1_TYPE": 0}
"""With these the autopilot follows VISION_POSITION_ESTIMATE (observed)."""
PROVISION = "`aritra provision --wiring gate`, then reboot the autopilot"

_SINGLE = (
    "SYSID_MYGCS", "RC_OVERRIDE_TIME", "RC_OPTIONS", "FS_THR_ENABLE", "FS_THR_VALUE", "FS_ACTION", "FS_TIMEOUT",
    "FS_GCS_ENABLE", "FS_GCS_TIMEOUT", "SERVO_RC_FS_MSK", "SCR_ENABLE", "ARMING_RUDDER", "ARMING_REQUIRE",
    "ARMING_CHECK", "BRD_SAFETY_DEFLT", "MODE_CH", "RCMAP_ROLL", "RCMAP_PITCH", "RCMAP_THROTTLE", "RCMAP_YAW",
    "FRAME_CLASS", "FRAME_TYPE", "MOT_SLEWRATE", "SCHED_LOOP_RATE", "SERVO_32_ENABLE", "SERVO_AUTO_TRIM",
    "MAV_OPTIONS", "SYSID_ENFORCE",
)  # fmt: skip
_SERVO, _RC = ("FUNCTION", "MIN", "TRIM", "MAX", "REVERSED"), ("MIN", "TRIM", "MAX", "DZ", "REVERSED", "OPTION")


def wanted(companion: Companion) -> tuple[str, ...]:
    """Names to ask an autopilot for, in either spelling; it is silent on those that it does not have."""
    servos = [f"SERVO{n}_{key}" for n in range(1, OUTPUTS + 1) for key in _SERVO]
    channels = [f"RC{n}_{key}" for n in sorted(companion.channels) for key in _RC]
    return (*_SINGLE, *RENAMED.values(), *servos, *channels, *(VISION if companion.vision else ()))


def wanted_more(p: ParameterSet) -> tuple[str, ...]:
    """What else to ask for, now that these are known: outputs 17 to 32 where they are in use."""
    if not p.whole("SERVO_32_ENABLE"):
        return ()
    return tuple(f"SERVO{n}_{key}" for n in range(OUTPUTS + 1, MORE_OUTPUTS + 1) for key in _SERVO)


def parameter_rows(p: ParameterSet, companion: Companion) -> list[Row]:
    """All rows. Where next to nothing was told there is one row, which refuses."""
    if p.get("SERVO1_FUNCTION") is None:
        why = "without its parameters nobody can say whether the boat stops when the companion dies"
        fix = "check the link; signed MAVLink drops our questions: use the autopilot's USB port, or remove the key"
        return [_row("parameters", "refuse", "none told", "the autopilot's answer", why, fix)]
    w = wiring(p, companion)
    return [row for rule in _RULES for row in rule(p, w, companion)]


# --- outputs ---------------------------------------------------------------------------------------


def _thrusters(p: ParameterSet, w: Wiring, companion: Companion) -> Iterator[Row]:
    """Which outputs carry the thrusters."""
    if plain := w.of("plain"):
        yield _functions(
            p, plain, "refuse", "94 to 97 (script) or 140 to 155 (scaled)",
            "plain pass-through: when the companion dies the LAST PULSE STAYS ON THE THRUSTERS FOR EVER; disarming, "
            "HOLD and emergency stop do not change it, only the safety switch does", PROVISION,
        )  # fmt: skip
    if spare := tuple(o for o in w.outputs if o.kind == "plain" and o.thruster is None):
        why = "plain pass-through of a channel that is no thruster's: it follows no arming and no fail-safe"
        yield _functions(p, spare, "warning", "nothing that moves the boat", why, "make sure no thruster hangs there")
    if scaled := w.of("scaled"):
        why = "scaled pass-through: DISARMING AND HOLD DO NOT STOP THE THRUSTERS, only the end of the overrides does"
        yield _functions(p, scaled, "warning", "94 to 97 (script)", why, PROVISION)
    if script := w.of("script"):
        why = "the Lua gate: neutral when the companion dies, on disarming and on HOLD"
        yield _functions(p, script, "ok", "94 to 97 (script)", why, "")
    if w.omni:
        why = "the autopilot's own mixer: everything cuts it, but Aritra commands thrusters one by one and DOES NOT "
        why += "DRIVE THIS WIRING; it is for driving by hand"
        yield _row("SERVOn_FUNCTION", "warning", "33 to 36 (Omni-X mixer)", "94 to 97 (script)", why, PROVISION)
    elif w.missing:
        names = ", ".join(f"{name} (channel {channel})" for name, channel in w.missing)
        why = "no output of the autopilot carries it: the thruster would not follow its commands"
        yield _row("SERVOn_FUNCTION", "refuse", f"nothing for {names}", "an output for each thruster", why, PROVISION)
    functions = {p.whole(f"SERVO{n}_FUNCTION") for n in output_names(p)}
    if not functions & DRIVING and p.get("ARMING_CHECK") != 0:
        why = "the autopilot refuses to arm while no output has a motor's or script's function"
        yield _row("SERVOn_FUNCTION", "refuse", "only pass-through", "94 to 109 on some output", why,
                   "set SERVO8_FUNCTION to 109 (an unused pin as Script16)")  # fmt: skip


def _trims(p: ParameterSet, w: Wiring, companion: Companion) -> Iterator[Row]:
    """Where an output falls when it is cut."""
    cut = [o for o in w.outputs if o.kind in ("scaled", "script") and o.thruster is not None]
    cut += [o for o in w.outputs if o.kind == "motor"] if w.omni else []
    if not cut:
        return
    values = {o.number: p.whole(f"SERVO{o.number}_TRIM") for o in cut}
    bad = [n for n, us in values.items() if abs(us - NEUTRAL_US) > BAND_US]
    level: Level = "refuse" if bad else "ok" if set(values.values()) == {NEUTRAL_US} else "warning"
    why = "the pulse that the thrusters fall to when they are cut: off 1500 us they would turn, for ever"
    yield _each("SERVO", "TRIM", values, bad, level, "1500", why, "set it to 1500")


def _scaled(p: ParameterSet, w: Wiring, companion: Companion) -> Iterator[Row]:
    """What scaled outputs need beyond that."""
    if not (scaled := w.of("scaled")):
        return
    mask = p.get("SERVO_RC_FS_MSK")
    open_ = [o.channel for o in scaled if o.channel and not (p.whole("SERVO_RC_FS_MSK") >> (o.channel - 1)) & 1]
    needed = sum(1 << (o.channel - 1) for o in scaled if o.channel)
    why = f"a channel without its bit keeps its LAST PULSE when overrides end: {numbers(c for c in open_ if c)}"
    why = why if open_ else "channels whose bit is set go to their trim when overrides end"
    fix = f"set it to {needed | p.whole('SERVO_RC_FS_MSK')}"
    level: Level = "refuse" if open_ else "ok"
    yield _row("SERVO_RC_FS_MSK", level, number(mask), f"the bits of {needed}", why, fix)
    for o in scaled:
        still = scaled_us(p, o, NEUTRAL_US)
        ends = [round(scaled_us(p, o, us)) for us in (1100, 1300, 1700, 1900)]
        name = f"RC{o.channel}_*, SERVO{o.number}_*"
        if abs(still - NEUTRAL_US) > BAND_US:
            why = "neutral commands would turn the thruster: MIN, TRIM, MAX of channel or output are off"
            yield _row(
                name, "refuse", f"1500 us becomes {still:.0f}", "1500 us", why, "load deploy/ardupilot/scaled.param"
            )
        elif max(abs(a - b) for a, b in zip(ends, (1100, 1300, 1700, 1900), strict=True)) > 2:
            why = "forces would not be those that the controller asks for"
            found = f"1100 1300 1700 1900 us become {' '.join(map(str, ends))}"
            yield _row(name, "warning", found, "one to one", why, "load deploy/ardupilot/scaled.param")


def _script(p: ParameterSet, w: Wiring, companion: Companion) -> Iterator[Row]:
    """What the Lua gate needs."""
    if w.of("script"):
        level: Level = "ok" if p.get("SCR_ENABLE") == 1 else "refuse"
        why = "1 runs the Lua gate; without it the thrusters get no commands"
        yield _row("SCR_ENABLE", level, number(p.get("SCR_ENABLE")), "1", why, "set it to 1 and reboot")


def _omni(p: ParameterSet, w: Wiring, companion: Companion) -> Iterator[Row]:
    """What the mixer needs."""
    if w.omni:
        yield from _is(p, "FRAME_TYPE", 2, "warning", "2 is the Omni-X mixer; with another one nothing is put out")
        yield from _is(p, "MOT_SLEWRATE", 0, "warning", "100 lets the throttle follow within a second only")


# --- fail-safes ------------------------------------------------------------------------------------


def _failsafes(p: ParameterSet, w: Wiring, companion: Companion) -> Iterator[Row]:
    """What notices that the companion is gone."""
    value = p.get("FS_THR_ENABLE")
    why = "1 notices 0.5 s after the last override; 0 BELIEVES THE LAST OVERRIDE FOR EVER, gate and mixer pass it on"
    yield _row("FS_THR_ENABLE", "ok" if value in (1, 2) else "refuse", number(value), "1", why, "set it to 1")
    value = p.get("FS_THR_VALUE")
    fine = value is not None and 900 <= value <= 1100
    why = "throttle (channel 3, held at 1500 us) below it is a lost radio; far above it the boat never drives"
    yield _row("FS_THR_VALUE", "ok" if fine else "warning", number(value), "910", why, "" if fine else "set it to 910")
    good = 5 if w.of("scaled") else 2
    value, acts = p.get("FS_ACTION"), {2: "HOLD", 5: "disarm"}[good]
    fine = value == good or (good == 2 and value in (1, 3, 4, 5))
    why = f"{good} ({acts}) stays until a person acts; 0 lets a companion that comes back drive off"
    yield _row("FS_ACTION", "ok" if fine else "warning", number(value), f"{good} ({acts})", why,
               "" if fine else f"set it to {good}")  # fmt: skip
    value = p.get("FS_GCS_ENABLE")
    why = "the second line: it acts when system SYSID_MYGCS, the companion, has been silent for FS_GCS_TIMEOUT"
    yield _row("FS_GCS_ENABLE", "ok" if value else "warning", number(value), "1", why, "" if value else "set it to 1")


def _overrides(p: ParameterSet, w: Wiring, companion: Companion) -> Iterator[Row]:
    """Whether overrides are taken at all, and for how long."""
    name, value = p.spelled("SYSID_MYGCS"), p.get("SYSID_MYGCS")
    mine = companion.system_id
    why = "overrides of any other system are dropped without a word (the run file's mavlink.system_id)"
    if value == mine == 255:
        why, level = (
            "ground stations are 255 too: they may override, and they hide that the companion is silent",
            "warning",
        )
        yield _row(name, level, "255", "1", why, f"set it to 1, and mavlink.system_id to 1; or {PROVISION}")
    else:
        level = "ok" if value == mine else "refuse"
        yield _row(name, level, number(value), str(mine), why, f"set it to {mine}" if value != mine else "")
    yield _override_time(p, companion)
    options = p.whole("RC_OPTIONS")
    if options & IGNORE_OVERRIDES:
        why = "bit 1 makes the autopilot ignore overrides (reference): the boat would not follow"
        yield _row("RC_OPTIONS", "refuse", str(options), "bit 1 clear", why, f"set it to {options & ~IGNORE_OVERRIDES}")
    for name, told in (("MAV_OPTIONS", p.whole("MAV_OPTIONS") & ONLY_GCS), ("SYSID_ENFORCE", p.whole("SYSID_ENFORCE"))):
        if told:
            why = "messages of any other system are refused (reference): a ground station could not disarm or HOLD"
            yield _row(name, "warning", number(p.get(name)), "bit 0 clear", why, "set it to 0")


def _override_time(p: ParameterSet, companion: Companion) -> Row:
    value = p.get("RC_OVERRIDE_TIME")
    why = "with an RC receiver the companion's last pulses stay so long [s] after it died"
    level: Level = "ok"
    if value is None or value < 0 or value > LONGEST_OVERRIDE_S:
        why, level = (
            "with an RC receiver the companion's LAST PULSES STAY so long [s] after it died; -1: for ever",
            "refuse",
        )
    elif value == 0:
        why, level = "0 refuses overrides: the boat would not follow", "refuse"
    elif value > GOOD_OVERRIDE_S:
        level = "warning"
    elif value < companion.lease_s:
        why, level = "shorter than a lease (control.lease_s): with an RC receiver the sticks come in between", "warning"
    fix = "" if level == "ok" else "set it to 0.5"
    return _row("RC_OVERRIDE_TIME", level, number(value), f"{companion.lease_s:g} to {GOOD_OVERRIDE_S:g} s", why, fix)


# --- what channels do besides ----------------------------------------------------------------------


def _channels(p: ParameterSet, w: Wiring, companion: Companion) -> Iterator[Row]:
    """Overridden channels must not arm, change modes or throw switches."""
    thrusters = {channel for _, channel in companion.thrusters}
    rudder, roll = p.get("ARMING_RUDDER"), p.whole("RCMAP_ROLL", 1)
    level: Level = "ok" if rudder == 0 else "refuse" if roll in thrusters else "warning"
    why = f"else channel {roll} near its end with the throttle in neutral ARMS OR DISARMS after 2 s"
    yield _row("ARMING_RUDDER", level, number(rudder), "0", why, "" if rudder == 0 else "set it to 0")
    channel = p.get("MODE_CH")
    taken = channel in companion.channels
    why = f"the mode follows this channel{', which the companion overrides' if taken else ''}"
    level = "refuse" if taken else "ok" if channel is not None else "warning"
    free = "a channel that nobody overrides"
    yield _row("MODE_CH", level, number(channel), free, why, "set it to 8" if level != "ok" else "")
    for key in ("ROLL", "PITCH", "THROTTLE", "YAW"):
        name, told = f"RCMAP_{key}", p.get(f"RCMAP_{key}")
        if told in thrusters:
            why = f"channel {number(told)} is a thruster's and the pilot's {key.lower()} at once"
            yield _row(
                name, "warning", number(told), "1 to 4", why, "set RCMAP_* to 1, 2, 3, 4; thrusters are on 9 to 16"
            )
    throttle = p.whole("RCMAP_THROTTLE", 3)
    if throttle not in companion.channels:
        why = f"channel {throttle} is the throttle and nobody holds it at 1500 us: without a receiver a radio failure"
        fix = f"add {throttle} to control.neutral_channels of the run file, or set RCMAP_THROTTLE to 3"
        yield _row("RCMAP_THROTTLE", "warning", str(throttle), "a channel held in neutral", why, fix)
    options = {n: p.whole(f"RC{n}_OPTION") for n in sorted(companion.channels)}
    if bad := [n for n, option in options.items() if option]:
        why = "auxiliary functions on channels that the companion overrides: commands would throw switches (reference)"
        level = "refuse" if thrusters & set(bad) else "warning"
        yield _each("RC", "OPTION", options, bad, level, "0", why, "set it to 0")


def _rest(p: ParameterSet, w: Wiring, companion: Companion) -> Iterator[Row]:
    """What does not decide about stopping, but about a good day."""
    value = p.get("BRD_SAFETY_DEFLT")
    if value:
        why = "outputs are off until the safety button is pressed, and arming is refused"
        yield _row("BRD_SAFETY_DEFLT", "warning", number(value), "0 without a button", why, "press it, or set it to 0")
    if p.get("ARMING_REQUIRE") == 0:
        why = "always armed: disarming cannot stop the boat (reference)"
        yield _row("ARMING_REQUIRE", "warning", "0", "1", why, "set it to 1")
    if p.get("ARMING_CHECK") == 0:
        why = "the autopilot arms without checking anything"
        yield _row("ARMING_CHECK", "warning", "0", "1", why, "set it to 1")
    if p.whole("SERVO_AUTO_TRIM"):
        why = "the autopilot moves SERVOn_TRIM, the pulse that the thrusters fall to (reference)"
        yield _row("SERVO_AUTO_TRIM", "warning", number(p.get("SERVO_AUTO_TRIM")), "0", why, "set it to 0")
    yield from _is(p, "FRAME_CLASS", 2, "warning", "2 is a boat")
    yield from _loop(p, w, companion)


def _loop(p: ParameterSet, w: Wiring, companion: Companion) -> Iterator[Row]:
    rate = p.get("SCHED_LOOP_RATE")
    fine = rate is not None and rate >= GOOD_LOOP_HZ
    why = "messages come at 80 % of it at most, and the estimator wants 50 Hz"
    fix = "" if fine else "set it to 200 and reboot"
    yield _row("SCHED_LOOP_RATE", "ok" if fine else "warning", number(rate), "200", why, fix)
    if rate and w.kinds & {"script", "scaled"}:
        latency_s = max(0.0, 2.0 / rate - 0.003) + (SCRIPT_S if w.of("script") else 0.0)
        fine = abs(latency_s - companion.latency_s) <= LATENCY_SLACK_S
        why = "the controller plans from where the boat will be when a command acts"
        fix = "" if fine else f"set control.latency_s of the run file to {latency_s:.3f}"
        needed, found = f"about {latency_s:.3f} s at this loop rate", f"{companion.latency_s:g} s"
        yield _row("control.latency_s", "ok" if fine else "warning", found, needed, why, fix)


def _vision(p: ParameterSet, w: Wiring, companion: Companion) -> Iterator[Row]:
    """What the autopilot needs to make use of our position."""
    if companion.vision:
        why = "the autopilot's own filter then follows the position that we send ([vision] of the run file)"
        for name, value in VISION.items():
            yield from _is(p, name, value, "warning", why)


# --- making rows -----------------------------------------------------------------------------------


def _row(name: str, level: Level, found: str, needed: str, why: str, fix: str) -> Row:
    return Row(area=AREA, name=name, level=level, found=found, needed=needed, why=why, fix="" if level == "ok" else fix)


def _is(p: ParameterSet, name: str, value: float, otherwise: Level, why: str) -> Iterator[Row]:
    """A parameter that should have one value."""
    told = p.get(name)
    yield _row(name, "ok" if told == value else otherwise, number(told), f"{value:g}", why, f"set it to {value:g}")


def _each(
    stem: str, key: str, values: dict[int, int], bad: list[int], level: Level, needed: str, why: str, fix: str
) -> Row:
    """One row for a parameter of several outputs or channels."""
    shown = {n: values[n] for n in bad} or values
    found = " ".join(map(str, shown.values())) if len(set(shown.values())) > 1 else str(next(iter(shown.values())))
    return _row(f"{stem}{numbers(shown)}_{key}", level, found, needed, why, fix)


def _functions(p: ParameterSet, outputs: tuple[Output, ...], level: Level, needed: str, why: str, fix: str) -> Row:
    values = {o.number: o.function for o in outputs}
    name, found = f"SERVO{numbers(values)}_FUNCTION", numbers(values.values())
    return _row(name, level, f"{found} ({outputs[0].kind})", needed, why, fix)


_RULES: tuple[Callable[[ParameterSet, Wiring, Companion], Iterator[Row]], ...] = (
    _thrusters, _trims, _scaled, _script, _omni, _failsafes, _overrides, _channels, _rest, _vision,
)  # fmt: skip
