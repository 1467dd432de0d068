"""Sticks from shore: from zenoh's thread through the gate to the pilot.

    zenoh's thread   StickGate.judge (signature, run, whose, counter, age); refused: counted, told at powers of two
    loop thread      call_soon_threadsafe: App.manual, and the pilot's dead man

Samples that come faster than the loop takes them are dropped: the next one says more.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections import Counter
from collections.abc import Callable

import zenoh

from companion.boat.app import App
from companion.boat.clock import Clock
from companion.core.messages import Alert, ManualInput
from companion.core.telemetry.order_gate import Order, OrderRefused
from companion.core.telemetry.sticks import MAX_BYTES, StickGate

PENDING = 4
"""Samples on their way to the loop (assumed: a fifth of a second of them)."""


class ShoreSticks:
    """Call it with each sample; create it on the loop. `refused`: number of samples, by code."""

    def __init__(self, app: App, gate: StickGate, clock: Clock, tell: Callable[[Alert], None]) -> None:
        self.refused: Counter[str] = Counter()
        self._app, self._gate, self._clock, self._tell = app, gate, clock, tell
        self._loop = asyncio.get_running_loop()
        self._lock = threading.Lock()
        self._pending = 0
        self._ended = False

    def take(self, order: Order) -> None:
        """An order that the pilot has: `StickGate.take`."""
        with self._lock:
            self._gate.take(order)

    def end(self) -> None:
        """From now on nothing steers: the run ends, in neutral."""
        self._ended = True

    def __call__(self, sample: zenoh.Sample) -> None:
        """One sample on the boat's key. While nobody was given the sticks it is not even looked at."""
        if self._ended or not self._gate.is_taken:
            return
        try:
            moved = self._judge(sample)
        except OrderRefused as no:
            return self._refuse(no)
        except Exception as error:  # bytes of anybody must not end the listening
            return self._refuse(OrderRefused("malformed", f"not sticks: {type(error).__name__}"))
        if moved is not None:
            with contextlib.suppress(RuntimeError):  # the loop is gone, and the run with it
                self._loop.call_soon_threadsafe(self._steer, moved)

    def _judge(self, sample: zenoh.Sample) -> ManualInput | None:
        """What the pilot is told; None: there is no room for it."""
        attachment = sample.attachment
        if len(sample.payload) > MAX_BYTES or (attachment is not None and len(attachment) > MAX_BYTES):
            raise OrderRefused("too_long", f"sticks longer than {MAX_BYTES} bytes")
        signed = None if attachment is None else bytes(attachment)
        with self._lock:
            moved = self._gate.judge(bytes(sample.payload), signed, self._clock.now_ns())
            if self._pending >= PENDING:
                return None
            self._pending += 1
        return moved

    def _steer(self, moved: ManualInput) -> None:
        with self._lock:
            self._pending -= 1
        if not self._ended:
            self._app.manual(moved)

    def _refuse(self, no: OrderRefused) -> None:
        self.refused[no.code] += 1
        times = self.refused[no.code]
        if times & (times - 1) == 0:
            so_far = f" ({times} so far)" if times > 1 else ""
            alert = Alert(t_ns=self._clock.now_ns(), level="warning", text=f"sticks from shore ignored: {no}{so_far}")
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self._tell, alert)
