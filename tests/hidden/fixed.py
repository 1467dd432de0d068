"""A small fixed set for the tests: one medium cause of a family each, nothing, something outside."""

from __future__ import annotations

from tests.hidden.draw import Case, draw

NONCE = "fixed-1"
FAMILIES = (
    "current",
    "thruster_gain",
    "lag",
    "hull_fouling",
    "cg_shift",
    "heading_offset",
    "uwb_lever_arm",
    "gyro_bias",
)
TRAIN_S = 300.0


def fixed_cases(train_s: float = TRAIN_S) -> dict[str, Case]:
    """Cases by name, UWB at 5 Hz. The same on every machine and at every time."""
    cases = {
        family: draw(NONCE, i, kind="medium", family=family, uwb_hz=5, train_s=train_s)
        for i, family in enumerate(FAMILIES)
    }
    cases["none"] = draw(NONCE, 100, kind="none", uwb_hz=5, train_s=train_s)
    cases["outside"] = draw(NONCE, 101, kind="outside", family="skeg_lift", uwb_hz=5, train_s=train_s)
    return cases
