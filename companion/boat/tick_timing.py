"""When control ticks fall due: a period apart, moved little by little to shortly after an IMU sample."""

from __future__ import annotations

from collections.abc import Iterable

from companion.core.messages import ImuSample, LoopTiming, Message, OverrideLease, Tick

IMU_AGE_NS, NUDGE_NS = 4_000_000, 1_000_000
"""Age of the newest IMU bytes that a tick aims at, and how far it moves for that at a time; assumed."""


class TickTiming:
    """One loop of `period_ns` [ns]."""

    def __init__(self, period_ns: int) -> None:
        self._period_ns, self._late_ns = period_ns, 0
        self._tick = Tick(t_ns=0, index=-1)
        self._imu_rx_ns: int | None = None
        self._tick_imu_ns: int | None = None

    def hear(self, messages: Iterable[Message]) -> None:
        """Messages of the autopilot: the newest IMU sample counts."""
        for message in messages:
            if isinstance(message, ImuSample):
                self._imu_rx_ns = message.t_rx_ns

    def begin(self, index: int, due_ns: int, now_ns: int) -> Tick:
        """The tick that was due at `due_ns` and begins now."""
        lateness_ns, self._tick_imu_ns = now_ns - due_ns + self._late_ns, self._imu_rx_ns
        self._tick = Tick(t_ns=now_ns, index=index, lateness_ns=lateness_ns)
        return self._tick

    def next_due_ns(self, due_ns: int, now_ns: int) -> int:
        """When the tick after the one due at `due_ns` is due, so that it plans from a fresh IMU sample.

        At once where this one took longer than a period; by how much counts as lateness of the next.
        """
        nudge_ns = 0
        if self._tick_imu_ns is not None:
            off_ns = IMU_AGE_NS - (self._tick.t_ns - self._tick_imu_ns)
            nudge_ns = max(-NUDGE_NS, min(NUDGE_NS, off_ns))
        self._late_ns = max(0, now_ns - self._tick.t_ns - self._period_ns)
        return max(due_ns + self._period_ns + nudge_ns, now_ns)

    def of_lease(self, lease: OverrideLease, now_ns: int, *, sent: bool) -> LoopTiming:
        """Lateness of the tick, and age of its IMU sample as the lease leaves."""
        age_ms = None if self._tick_imu_ns is None else (now_ns - self._tick_imu_ns) * 1e-6
        lateness_ms = self._tick.lateness_ns * 1e-6
        return LoopTiming(t_ns=now_ns, index=lease.index, lateness_ms=lateness_ms, imu_to_override_ms=age_ms, sent=sent)
