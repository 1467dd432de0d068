"""Rules of the outputs: which carry the thrusters, where they fall when cut, what each kind of wiring needs."""

from __future__ import annotations

from collections.abc import Iterator

from companion.core.constants import NEUTRAL_US
from companion.core.preflight.rows import Level, ParameterSet, Row, number, numbers
from companion.core.preflight.rules.making import PROVISION, expected, function_row, row, row_of_several
from companion.core.preflight.wiring import BAND_US, Companion, Wiring, output_names, scaled_us, untold_functions


def thruster_outputs(p: ParameterSet, w: Wiring, companion: Companion) -> Iterator[Row]:
    """Which outputs carry the thrusters."""
    if plain := w.of("plain"):
        yield function_row(
            p, plain, "refuse", "94 to 97 (script) or 140 to 155 (scaled)",
            "plain pass-through: when the companion dies the LAST PULSE STAYS ON THE THRUSTERS FOR EVER; disarming, "
            "HOLD and emergency stop do not change it, only the safety switch does", PROVISION,
        )  # fmt: skip
    if spare := tuple(o for o in w.outputs if o.kind == "plain" and o.thruster is None):
        why = "plain pass-through of a channel that is no thruster's: it follows no arming and no fail-safe"
        yield function_row(p, spare, "warning", "nothing that moves the boat", why, "make sure no thruster hangs there")
    if scaled := w.of("scaled"):
        why = "scaled pass-through: DISARMING AND HOLD DO NOT STOP THE THRUSTERS, only the end of the overrides does"
        yield function_row(p, scaled, "warning", "94 to 97 (script)", why, PROVISION)
    if script := w.of("script"):
        why = "the Lua gate: neutral when the companion dies, on disarming and on HOLD"
        yield function_row(p, script, "ok", "94 to 97 (script)", why, "")
    if w.omni:
        why = "the autopilot's own mixer: everything cuts it, but Aritra commands thrusters one by one and DOES NOT "
        why += "DRIVE THIS WIRING; it is for driving by hand"
        yield row("SERVOn_FUNCTION", "refuse", "33 to 36 (Omni-X mixer)", "94 to 97 (script)", why, PROVISION)
    elif w.missing:
        names = ", ".join(f"{name} (channel {channel})" for name, channel in w.missing)
        why = "no output of the autopilot carries it: the thruster would not follow its commands"
        yield row("SERVOn_FUNCTION", "refuse", f"nothing for {names}", "an output for each thruster", why, PROVISION)


def untold_outputs(p: ParameterSet, w: Wiring, companion: Companion) -> Iterator[Row]:
    """Outputs that may pass anything, for all that was heard."""
    if untold := untold_functions(p):
        which = numbers(n for n in output_names(p) if f"SERVO{n}_FUNCTION" in untold)
        why = "one of them may pass a thruster's channel plainly, whose LAST PULSE STAYS FOR EVER: nobody knows"
        fix = "check again; a faster link, or fewer streams to others"
        yield row(f"SERVO{which}_FUNCTION", "refuse", "not told", "the autopilot's answer", why, fix)


def trims(p: ParameterSet, w: Wiring, companion: Companion) -> Iterator[Row]:
    """Where an output falls when it is cut."""
    cut = [o for o in w.outputs if o.kind in ("scaled", "script") and o.thruster is not None]
    cut += [o for o in w.outputs if o.kind == "motor"] if w.omni else []
    if not cut:
        return
    values = {o.number: p.whole(f"SERVO{o.number}_TRIM") for o in cut}
    bad = [n for n, us in values.items() if abs(us - NEUTRAL_US) > BAND_US]
    level: Level = "refuse" if bad else "ok" if set(values.values()) == {NEUTRAL_US} else "warning"
    why = "the pulse that the thrusters fall to when they are cut: off 1500 us they would turn, for ever"
    yield row_of_several("SERVO", "TRIM", values, bad, level, "1500", why, "set it to 1500")


def scaled_outputs(p: ParameterSet, w: Wiring, companion: Companion) -> Iterator[Row]:
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
    yield row("SERVO_RC_FS_MSK", level, number(mask), f"the bits of {needed}", why, fix)
    for o in scaled:
        still = scaled_us(p, o, NEUTRAL_US)
        ends = [round(scaled_us(p, o, us)) for us in (1100, 1300, 1700, 1900)]
        name = f"RC{o.channel}_*, SERVO{o.number}_*"
        if abs(still - NEUTRAL_US) > BAND_US:
            why = "neutral commands would turn the thruster: MIN, TRIM, MAX of channel or output are off"
            yield row(
                name, "refuse", f"1500 us becomes {still:.0f}", "1500 us", why, "load deploy/ardupilot/scaled.param"
            )
        elif max(abs(a - b) for a, b in zip(ends, (1100, 1300, 1700, 1900), strict=True)) > 2:
            why = "forces would not be those that the controller asks for"
            found = f"1100 1300 1700 1900 us become {' '.join(map(str, ends))}"
            yield row(name, "warning", found, "one to one", why, "load deploy/ardupilot/scaled.param")


def script_outputs(p: ParameterSet, w: Wiring, companion: Companion) -> Iterator[Row]:
    """What the Lua gate needs."""
    if w.of("script"):
        level: Level = "ok" if p.get("SCR_ENABLE") == 1 else "refuse"
        why = "1 runs the Lua gate; without it the thrusters get no commands"
        yield row("SCR_ENABLE", level, number(p.get("SCR_ENABLE")), "1", why, "set it to 1 and reboot")


def omni_mixer(p: ParameterSet, w: Wiring, companion: Companion) -> Iterator[Row]:
    """What the mixer needs."""
    if w.omni:
        yield from expected(p, "FRAME_TYPE", 2, "warning", "2 is the Omni-X mixer; with another one nothing is put out")
        yield from expected(p, "MOT_SLEWRATE", 0, "warning", "100 lets the throttle follow within a second only")
