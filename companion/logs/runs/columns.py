"""Names and physical limits of a run's columns. Reference: docs/run-format.md."""

from __future__ import annotations

import difflib
import math
import re
from collections import Counter
from collections.abc import Sequence

REQUIRED = ("t_s", "battery_v", "psi_rad", "r_rad_s", "ax_m_s2", "ay_m_s2", "north_m", "east_m")
"""Columns of every run, blank where unknown; beside at least one pwm_<thruster>."""
OPTIONAL = (
    "phi_rad", "theta_rad", "u_m_s", "v_m_s", "V_w_m_s", "beta_w_deg",
    "true_north_m", "true_east_m", "true_psi_rad", "true_u_m_s", "true_v_m_s", "true_r_rad_s",
)  # fmt: skip
HELD = ("pwm_", "battery_v", "setting_")
"""Beginnings of the names of held columns."""
INERTIAL = ("psi_rad", "r_rad_s", "ax_m_s2", "ay_m_s2", "phi_rad", "theta_rad")
"""What an autopilot tells of its inertial sensors, many times a second."""
_GLOBAL = re.compile(r"(gps_?|gnss_?)?(lat|lon|lng|long|latitude|longitude)(_?(deg|degrees|e7))?", re.IGNORECASE)
_FAMILIES = re.compile(r"pwm_\w+|setting_\w+|range_\w+_m|true_f_\w+_n|extra_\w+")

MOST_ANGLE_RAD = math.pi + 1e-6
"""Largest angle [rad]; the millionth is rounding of single-precision numbers."""
LIMITS: tuple[tuple[re.Pattern[str], tuple[float, float, str]], ...] = tuple(
    (re.compile(pattern), limits)
    for pattern, limits in (
        (r"pwm_\w+", (800.0, 2200.0, "pulse width [us], 1500 neutral")),
        (r"battery_v", (0.0, 100.0, "[V]")),
        (r"setting_\w+", (0.0, 1e6, "a setting of the boat, 0 is off")),
        (r"(true_)?psi_rad|phi_rad|theta_rad", (-MOST_ANGLE_RAD, MOST_ANGLE_RAD, "radians, wrapped to -pi..pi")),
        (r"(true_)?r_rad_s", (-35.0, 35.0, "[rad/s]; a gyroscope of 2000 deg/s ends there")),
        (r"a[xy]_m_s2", (-160.0, 160.0, "[m/s^2]; an accelerometer of 16 g ends there")),
        (r"(true_)?(north|east)_m", (-1e5, 1e5, "[m] from the site's origin")),
        (r"range_\w+_m", (0.0, 1e4, "[m]")),
        (r"(true_)?[uv]_m_s", (-50.0, 50.0, "[m/s]")),
        (r"V_w_m_s", (0.0, 100.0, "[m/s]")),
        (r"beta_w_deg", (-360.0, 360.0, "[deg] from, clockwise from the site's north")),
    )
)
"""Pattern of a name -> least and largest value, and unit. Beyond them a value has another unit, or another column."""


def column_error(columns: Sequence[str]) -> str | None:
    """The first error in these names, as text; None where there is none."""
    if twice := [name for name, count in Counter(columns).items() if count > 1]:
        return f"column {twice[0]}: is there twice"
    known = (*REQUIRED, *OPTIONAL)
    unknown = [name for name in columns if name not in known and not _FAMILIES.fullmatch(name)]
    missing = [name for name in REQUIRED if name not in columns]
    if not any(name.startswith("pwm_") for name in columns):
        missing.append("pwm_<thruster>")
    if missing:
        places = [name for name in unknown if _GLOBAL.fullmatch(name)]
        if places and {"north_m", "east_m"} & set(missing):
            return (
                f"column {', '.join(missing)}: missing; {', '.join(places)}: metres north and east of an origin are"
                " needed (an autopilot's .bin is read as it is, with its GPS)"
            )
        like = difflib.get_close_matches(missing[0], unknown, 1, 0.6)
        hint = f"; is it {like[0]!r}?" if like else ""
        return f"column {', '.join(missing)}: missing{hint} (a column may be blank, but must be there)"
    if unknown:
        like = difflib.get_close_matches(unknown[0], known, 1, 0.6)
        hint = f"is it {like[0]}?" if like else "columns beyond the form begin with extra_"
        return f"column {unknown[0]!r}: unknown; {hint}"
    return None


def other_unit(name: str, least: float, largest: float) -> str:
    """What a column's unit looks like where its values, `least` to `largest`, are beyond its limits, and the remedy.

    Empty where they look like none that is known.
    """
    beyond = max(abs(least), abs(largest))
    if re.fullmatch(r"(true_)?psi_rad|phi_rad|theta_rad", name) and 2 * MOST_ANGLE_RAD < beyond <= 360.0:
        return "; is it in degrees? Write radians: degrees * pi / 180"
    if name.startswith("pwm_") and beyond <= 1.01:
        return "; is it a share of full thrust? Write pulses in us: 1500 + 400 x"
    if name.startswith("pwm_") and beyond <= 101.0:
        return "; is it in percent? Write pulses in us: 1500 + 400 x, where x = percent / 100"
    return ""
