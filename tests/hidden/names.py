"""The vocabulary: ids of effects, what an unknown effect may depend on, kinds of cases. README.md documents them."""

from __future__ import annotations

ENVIRONMENT = ("current", "turning_current", "wind", "gusty_wind", "waves", "tether", "shallow_zone")
PROPULSION = (
    "thruster_gain", "swapped_pair", "thruster_fouling", "common_loss", "astern_asymmetry", "voltage_exponent",
    "dead_band", "lag", "dead_time", "rate_limit", "advance_loss", "wash",
)  # fmt: skip
HULL = (
    "hull_fouling", "payload", "added_mass", "yaw_inertia", "cg_shift", "cross_flow", "yaw_sway_coupling",
    "munk_moment",
)  # fmt: skip
SENSORS = (
    "accel_bias", "gyro_bias", "gyro_scale", "heading_offset", "hard_iron", "imu_misalignment", "imu_lever_arm",
    "uwb_latency", "uwb_lever_arm", "uwb_scale", "nlos", "clock_drift",
)  # fmt: skip
FAMILIES = ENVIRONMENT + PROPULSION + HULL + SENSORS

PER_THRUSTER = ("thruster_gain", "thruster_fouling")
"""Their id carries a thruster: thruster_gain:front_port. swapped_pair carries two: swapped_pair:A+B."""

ALIASES = {"uwb_rotation": "heading_offset", "tilt": "accel_bias", "mass_damping_scale": "common_loss"}
"""Same signature, one class: whoever names the other member names the class."""

DEPENDENCIES = ("time", "position", "heading", "speed", "thruster", "voltage", "load")
"""First word of an entry of depends_on; `thruster:NAME` where one is meant."""

KINDS = ("none", "small", "medium", "two", "three", "outside", "variant")
VERDICTS = ("none", "named", "partial", "ambiguous", "unknown")


def family(name: str) -> str:
    """Family of an id: thruster_gain of thruster_gain:front_port."""
    return name.split(":", 1)[0]


def canonical(name: str) -> str:
    """The id under which a class is scored: aliases resolved, the two of a swapped pair in order of the alphabet."""
    head, _, tail = name.partition(":")
    head = ALIASES.get(head, head)
    if head == "swapped_pair":
        tail = "+".join(sorted(tail.split("+")))
    return f"{head}:{tail}" if tail else head
