"""Rules of what notices that the companion is gone, and of whether its overrides are taken."""

from __future__ import annotations

from collections.abc import Iterator

from companion.core.constants import NEUTRAL_US
from companion.core.preflight.rows import Level, ParameterSet, Row, number
from companion.core.preflight.rules.making import PROVISION, row
from companion.core.preflight.wiring import Companion, Wiring

IGNORE_OVERRIDES, ONLY_GCS = 2, 1
"""Bits of RC_OPTIONS and of MAV_OPTIONS (reference)."""
TIMEOUTS_S = {"FS_TIMEOUT": (1.5, 5.0), "FS_GCS_TIMEOUT": (5.0, 10.0)}
"""What the parameter files set (ArduPilot's defaults: 1.5 and 5 by its source), and what is long; assumed."""
LONGEST_OVERRIDE_S, GOOD_OVERRIDE_S = 3.0, 0.7
"""RC_OVERRIDE_TIME: ArduPilot's default, and what is worth having (assumed: the boat is neutral within 0.7 s)."""


def failsafes(p: ParameterSet, w: Wiring, companion: Companion) -> Iterator[Row]:
    """What notices that the companion is gone."""
    value = p.get("FS_THR_ENABLE")
    why = "1 notices 0.5 s after the last override; 0 BELIEVES THE LAST OVERRIDE FOR EVER, gate and mixer pass it on"
    yield row("FS_THR_ENABLE", "ok" if value in (1, 2) else "refuse", number(value), "1", why, "set it to 1")
    value = p.get("FS_THR_VALUE")
    fine, never = value is not None and 900 <= value <= 1100, value is not None and value > NEUTRAL_US
    why = "throttle (channel 3, held at 1500 us) below it is a lost radio"
    why += ": it REFUSES TO ARM, and the boat never drives" if never else "; above 1500 the boat never drives"
    level: Level = "ok" if fine else "refuse" if never else "warning"
    yield row("FS_THR_VALUE", level, number(value), "910", why, "set it to 910")
    good = 5 if w.of("scaled") else 2
    value, acts = p.get("FS_ACTION"), {2: "HOLD", 5: "disarm"}[good]
    fine = value == good or (good == 2 and value in (1, 3, 4, 5))
    why = f"{good} ({acts}) stays until a person acts; 0 lets a companion that comes back drive off"
    yield row("FS_ACTION", "ok" if fine else "warning", number(value), f"{good} ({acts})", why,
               "" if fine else f"set it to {good}")  # fmt: skip
    value = p.get("FS_GCS_ENABLE")
    why = "the second line: it acts when system SYSID_MYGCS, the companion, has been silent for FS_GCS_TIMEOUT"
    yield row("FS_GCS_ENABLE", "ok" if value else "warning", number(value), "1", why, "" if value else "set it to 1")
    for name, (recommended_s, longest_s) in TIMEOUTS_S.items():
        if (value := p.get(name)) is not None:
            late = not 0 < value <= longest_s
            why = "so long [s] a companion that comes back drives on as if nothing had been: FS_ACTION waits for it"
            fix = f"set it to {recommended_s:g}" if late else ""
            yield row(name, "warning" if late else "ok", number(value), f"{recommended_s:g}", why, fix)


def overrides(p: ParameterSet, w: Wiring, companion: Companion) -> Iterator[Row]:
    """Whether overrides are taken at all, and for how long."""
    name, value, highest = p.spelled("SYSID_MYGCS"), p.get("SYSID_MYGCS"), p.whole("MAV_GCS_SYSID_HI")
    mine = companion.system_id
    if value is not None and value < highest:
        why = f"systems {value:g} to {highest} may override (reference), and each hides that the companion is silent"
        yield row("MAV_GCS_SYSID_HI", "warning", str(highest), "0", why, "set it to 0")
    why = "overrides of any other system are dropped without a word (the run file's mavlink.system_id)"
    if value == mine == 255:
        why, level = (
            "ground stations are 255 too: they may override, and they hide that the companion is silent",
            "warning",
        )
        yield row(name, level, "255", "1", why, f"set it to 1, and mavlink.system_id to 1; or {PROVISION}")
    else:
        taken = value is not None and value <= mine <= max(value, highest)
        yield row(name, "ok" if taken else "refuse", number(value), str(mine), why, f"set it to {mine}")
    yield _override_time(p, companion)
    options = p.whole("RC_OPTIONS")
    if options & IGNORE_OVERRIDES:
        why = "bit 1 makes the autopilot ignore overrides (reference): the boat would not follow"
        yield row("RC_OPTIONS", "refuse", str(options), "bit 1 clear", why, f"set it to {options & ~IGNORE_OVERRIDES}")
    for name, bits in (("MAV_OPTIONS", ONLY_GCS), ("SYSID_ENFORCE", ~0)):
        if p.whole(name) & bits:
            why = "messages of any other system are refused (reference): a ground station could not disarm or HOLD"
            yield row(name, "warning", number(p.get(name)), "bit 0 clear", why, "set it to 0")


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
    return row("RC_OVERRIDE_TIME", level, number(value), f"{companion.lease_s:g} to {GOOD_OVERRIDE_S:g} s", why, fix)
