"""Rules that do not decide whether the boat stops: arming, loop rate and latency, our position as a source."""

from __future__ import annotations

from collections.abc import Iterator

from companion.core.configuration.override_latency import override_latency_s
from companion.core.preflight.rows import ParameterSet, Row, number
from companion.core.preflight.rules.arming import arming_is_checked
from companion.core.preflight.rules.making import expected, row
from companion.core.preflight.wiring import Companion, Wiring

LATENCY_SLACK_S = 0.01
"""How far off the run file's latency may be; assumed."""
GOOD_LOOP_HZ = 63
"""80 % of it is 50 Hz, the rate of the streams."""
VISION = {"VISO_TYPE": 1, "EK3_SRC1_POSXY": 6, "EK3_SRC1_VELXY": 0, "EK3_SRC1_VELZ": 0, "GPS1_TYPE": 0}
"""With these the autopilot follows VISION_POSITION_ESTIMATE; without the 0 of VELZ it refuses to arm in modes that need
a position, "EK3 sources require GPS" (observed)."""


def arming_and_rates(p: ParameterSet, w: Wiring, companion: Companion) -> Iterator[Row]:
    """Arming, trim learning, frame and loop rate."""
    value = p.get("BRD_SAFETY_DEFLT")
    if value:
        why = "outputs are off until the safety button is pressed, and arming is refused"
        yield row("BRD_SAFETY_DEFLT", "warning", number(value), "0 without a button", why, "press it, or set it to 0")
    if p.get("ARMING_REQUIRE") == 0:
        why = "always armed: disarming cannot stop the boat (reference)"
        yield row("ARMING_REQUIRE", "warning", "0", "1", why, "set it to 1")
    if not arming_is_checked(p):
        name, needed = ("ARMING_CHECK", "1") if p.get("ARMING_CHECK") == 0 else ("ARMING_SKIPCHK", "0")
        why = "the autopilot arms without checking anything"
        yield row(name, "warning", number(p.get(name)), needed, why, f"set it to {needed}")
    if p.whole("SERVO_AUTO_TRIM"):
        why = "the autopilot moves SERVOn_TRIM, the pulse that the thrusters fall to (reference)"
        yield row("SERVO_AUTO_TRIM", "warning", number(p.get("SERVO_AUTO_TRIM")), "0", why, "set it to 0")
    yield from expected(p, "FRAME_CLASS", 2, "warning", "2 is a boat")
    yield from _loop(p, w, companion)


def _loop(p: ParameterSet, w: Wiring, companion: Companion) -> Iterator[Row]:
    rate = p.get("SCHED_LOOP_RATE")
    fine = rate is not None and rate >= GOOD_LOOP_HZ
    why = "messages come at 80 % of it at most, and the estimator wants 50 Hz"
    fix = "" if fine else "set it to 200 and reboot"
    yield row("SCHED_LOOP_RATE", "ok" if fine else "warning", number(rate), "200", why, fix)
    if rate and w.kinds & {"script", "scaled"}:
        latency_s = override_latency_s(rate, script=bool(w.of("script")))
        fine = abs(latency_s - companion.latency_s) <= LATENCY_SLACK_S
        why = "the controller plans from where the boat will be when a command acts"
        fix = "" if fine else f"set control.latency_s of the run file to {latency_s:.3f}"
        needed, found = f"about {latency_s:.3f} s at this loop rate", f"{companion.latency_s:g} s"
        yield row("control.latency_s", "ok" if fine else "warning", found, needed, why, fix)


def vision_source(p: ParameterSet, w: Wiring, companion: Companion) -> Iterator[Row]:
    """What the autopilot needs to make use of our position."""
    if companion.vision:
        why = "the autopilot's own filter then follows the position that we send ([vision] of the run file)"
        for name, value in VISION.items():
            yield from expected(p, name, value, "warning", why)
