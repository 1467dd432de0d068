"""Random sequences of faults for the whole boat: what may go wrong, when, and for how long (hypothesis)."""

from __future__ import annotations

from dataclasses import dataclass

from hypothesis import strategies as st

BEGINNINGS = ("auto", "hold", "manual", "excitation", "idle")
KINDS: dict[str, tuple[str, ...]] = {
    "cable": ("silent",),
    "down": ("silent", "corrupt", "duplicate", "garbage", "delay 0.3", "delay 1.2", "delay 2.5"),
    "up": ("silent", "corrupt", "duplicate"),
    "uwb": ("silent", "garbage", "nlos", "duplicate", "delay 1.2"),
    "imu": ("silent", "frozen", "stuck", "nan"),
    "battery": ("12.5", "13.8", "0"),
    "solver": ("failed", "raises", "nan", "huge", "empty", "late 0.07", "late 0.4", "never"),
    "hand": ("moved",),
    "gcs": ("disarm", "hold", "loiter", "manual", "arm"),
    "autopilot": ("reboot",),
    "operator": ("stop", "start", "hold", "manual", "excite"),
    "sticks": ("gone", "rest", "moved", "nan", "wild"),
    "lag": ("0.15", "0.6", "2.0"),
    "laggy": ("0.15", "0.25"),
}
"""What may go wrong -> how. down: autopilot to boat, up: boat to autopilot; numbers in s, of the battery in V.

imu: `frozen` repeats the last bytes, `stuck` the last values with new stamps. lag: the event loop stands once;
laggy: again and again. gcs, autopilot, operator, sticks and lag happen at an instant, the others last.
"""


@dataclass(frozen=True)
class Fault:
    """`after_s` after the one before; `lasts_s`, where it lasts."""

    kind: str
    how: str
    after_s: float
    lasts_s: float


@dataclass(frozen=True)
class Sequence:
    """One story. `receiver`: the autopilot has an RC receiver; `real`: the real controller plans."""

    beginning: str
    receiver: bool
    real: bool
    faults: tuple[Fault, ...]


def _fault(after_s: tuple[float, ...], lasts_s: tuple[float, ...]) -> st.SearchStrategy[Fault]:
    which = st.sampled_from([(kind, how) for kind, ways in KINDS.items() for how in ways])
    return st.builds(
        lambda which, after, lasts: Fault(which[0], which[1], after, lasts),
        which,
        st.sampled_from(after_s),
        st.sampled_from(lasts_s),
    )


def sequences(
    most: int = 8, lasts_s: tuple[float, ...] = (0.2, 1.0, 3.6, 6.0, 6.0, 22.0)
) -> st.SearchStrategy[Sequence]:
    """Stories of 1 to `most` faults, which overlap; every tenth or so with the real controller."""
    return st.builds(
        Sequence,
        beginning=st.sampled_from(BEGINNINGS),
        receiver=st.booleans(),
        real=st.sampled_from([False] * 9 + [True]),
        faults=st.lists(_fault((0.0, 0.05, 0.3, 1.0, 2.5), lasts_s), min_size=1, max_size=most).map(tuple),
    )
