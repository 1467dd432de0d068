"""Orders from shore: from zenoh's thread through the gate to the pilot, and the answer back.

    zenoh's thread   OrderGate.judge (signature, run, counter, age), the mission's text parsed; refused at once, or
    loop thread      call_soon_threadsafe: App.command / App.load, what the boat does now as an OrderOutcome
    answer thread    query.reply, which may wait for a bad network

So a stop reaches the pilot as soon as the loop is free, nothing that the shore sends costs the loop time before it is
accepted, and no reply can delay the next order. Refusals are counted; the 1st, 2nd, 4th, 8th of them is an alert.
Answers to who has the key are signed, and have room that strangers cannot take.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import queue
import threading
from collections import Counter
from collections.abc import Callable
from typing import NamedTuple

import msgspec
import zenoh

from companion.boat.app import App
from companion.boat.clock import Clock
from companion.core.geometry.frames import Origin
from companion.core.guidance.missions.fitness import unfit_waypoints
from companion.core.guidance.missions.mission import Mission, MissionErrors, kind_of, parse
from companion.core.messages import Alert, NewMission, OperatorCommand
from companion.core.pilot.state import PilotSettings
from companion.core.telemetry import structs as shore
from companion.core.telemetry.order_gate import (
    MAX_BYTES,
    MissionFile,
    Order,
    OrderGate,
    OrderOutcome,
    OrderRefused,
    Repeated,
)
from companion.core.telemetry.topics import points_of

PENDING = 8
"""Orders on their way to the loop; more are refused as busy, but for a stop."""
ANSWERS, TO_STRANGERS = 64, 16
"""Answers on their way back, all in all, and when a stranger is still given one; more are not given."""


class Asked(NamedTuple):
    """A query, its payload, and whether that is signed as it must be."""

    query: zenoh.Query
    order: bytes
    proven: bool


class ShoreCommands:
    """Takes orders from shore. `refused`: number of orders, by code; `obeyed`: those handed to the pilot.

    `meet(run, where)` is told, on a thread of zenoh's, of other runs that a sender heard under this boat's name;
    `taken(order)`, on the loop's, of each order that the pilot has or will have after the check.
    """

    def __init__(
        self,
        app: App,
        settings: PilotSettings,
        gate: OrderGate,
        clock: Clock,
        tell: Callable[[Alert], None],
        meet: Callable[[str, str], None] = lambda run, where: None,
        taken: Callable[[Order], None] = lambda order: None,
    ) -> None:
        self.refused: Counter[str] = Counter()
        self.obeyed = 0
        self._app, self._settings, self._gate = app, settings, gate
        self._key, self._clock, self._tell, self._meet = shore.command_key(gate.boat), clock, tell, meet
        self._taken = taken
        self._loop = asyncio.get_running_loop()
        self._lock = threading.Lock()
        self._pending = 0
        self._ended = False
        self._answers: queue.Queue[tuple[Asked, OrderOutcome] | None] = queue.Queue(ANSWERS)
        self._thread = threading.Thread(target=self._reply, name="shore-answers", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """From now on nothing is obeyed: the run ends, in neutral."""
        self._ended = True

    def close(self) -> None:
        """End the thread; what was not answered by then is not."""
        self.end()
        with contextlib.suppress(queue.Full):
            self._answers.put_nowait(None)
        self._thread.join(1.0)

    # --- zenoh's thread ----------------------------------------------------------------------------

    def __call__(self, query: zenoh.Query) -> None:
        """One query on the command key."""
        asked = Asked(query, b"", proven=False)
        try:
            asked, attachment = self._open(query)
            self._judge(asked, attachment)
        except OrderRefused as no:
            self._refuse(asked, no.code, no.text)
        except Repeated as again:
            self._again(asked, again.outcome)
        except Exception as error:  # bytes of anybody must not end the listening
            self._refuse(asked, "malformed", f"not an order: {type(error).__name__}")

    def _open(self, query: zenoh.Query) -> tuple[Asked, bytes | None]:
        payload, attachment = query.payload, query.attachment
        if payload is None:
            raise OrderRefused("malformed", "not an order: no payload")
        if len(payload) > MAX_BYTES or (attachment is not None and len(attachment) > MAX_BYTES):
            raise OrderRefused("too_long", f"longer than {MAX_BYTES} bytes")
        data, signed = bytes(payload), None if attachment is None else bytes(attachment)
        return Asked(query, data, self._gate.proves(data, signed)), signed

    def _judge(self, asked: Asked, attachment: bytes | None) -> None:
        with self._lock:
            order = self._gate.judge(asked.order, attachment, self._clock.now_ns())
            if self._pending >= PENDING and order.command not in ("stop", "hello"):
                raise OrderRefused("busy", f"{PENDING} orders wait already")
            self._pending += order.command != "hello"
        for run in order.heard:
            self._meet(run, f"by {order.sender}, on shore")
        if order.command == "hello":
            return self._send(asked, self._outcome("done", "ok", "here"))
        try:
            mission = self._mission(order.mission) if order.mission else None
            self._loop.call_soon_threadsafe(self._obey, asked, order, mission)
        except Exception as error:  # whatever it is, the order waits no longer
            with self._lock:
                self._pending -= 1
            if isinstance(error, OrderRefused):
                self._finish(order, self._outcome("refused", error.code, error.text))
            if not isinstance(error, RuntimeError):
                raise
            asked.query.drop()  # the loop is gone, and the run with it

    def _mission(self, file: MissionFile) -> Mission:
        """The mission in a file. Raises OrderRefused with everything that is wrong with it."""
        site, fence = self._settings.site, self._settings.fence
        origin = Origin(site.lat_deg, site.lon_deg, math.radians(site.rotation_deg))
        try:
            mission = parse(file.text, kind_of(file.name), origin=origin, name=file.name.rsplit(".", 1)[0])
        except MissionErrors as errors:
            raise OrderRefused("bad_mission", "; ".join(f"{file.name}: {e}" for e in errors.errors)[:1000]) from None
        if any(f not in self._settings.mission.fences for f in mission.fences):
            text = "its fences are not those that this run was started with: put it into the run file and start anew"
            raise OrderRefused("bad_mission", f"{file.name}: {text}")
        for i, what in unfit_waypoints(mission, fence, self._settings.guidance):
            raise OrderRefused("bad_mission", f"{file.name}: waypoint {i + 1} {what}")
        return mission

    def _refuse(self, asked: Asked, code, text: str) -> None:
        with self._lock:
            self.refused[code] += 1
            times = self.refused[code]
        if times & (times - 1) == 0:
            so_far = f" ({times} so far)" if times > 1 else ""
            alert = Alert(t_ns=self._clock.now_ns(), level="warning", text=f"order from shore refused: {text}{so_far}")
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self._tell, alert)
        self._send(asked, self._outcome("refused", code, text))

    def _again(self, asked: Asked, outcome: OrderOutcome | None) -> None:
        if outcome is None:
            outcome = self._outcome("waiting", "busy", "the same order is on its way to the pilot")
        self._send(asked, msgspec.structs.replace(outcome, repeated=True))

    # --- the loop's thread -------------------------------------------------------------------------

    def _obey(self, asked: Asked, order: Order, mission: Mission | None) -> None:
        """Give an accepted order to the App, and answer with its outcome."""
        with self._lock:
            self._pending -= 1
        try:
            outcome = self._given(order, mission)
        except Exception as error:  # the App looks after its own; this is ours, and no reason to stop the boat
            outcome = self._outcome("refused", "not_now", f"{order.command}: {error}")
        self._finish(order, outcome)
        text = f"shore ({order.sender}): {order.command}: {outcome.status}: {outcome.text}"
        self._tell(Alert(t_ns=self._clock.now_ns(), level="info", text=text))
        self._send(asked, outcome)

    def _given(self, order: Order, mission: Mission | None) -> OrderOutcome:
        if self._ended:
            return self._outcome("refused", "not_now", "the run ends: thrusters are neutral")
        now = self._clock.now_ns()
        if order.command in ("start", "hold", "stop", "manual"):
            self.obeyed += 1
            done = self._app.command(OperatorCommand(t_ns=now, command=order.command))
            if not done and (why := self._app.refusal):
                return self._with_mode("refused", "not_now", f"{order.command}: {why}")
            self._taken(order)
            if done:
                return self._with_mode("done", "ok", f"{order.command}: the pilot has it")
            return self._with_mode("waiting", "waiting", f"{order.command} waits for the check of the autopilot")
        assert mission is not None
        self.obeyed += 1
        new = NewMission(
            t_ns=now, name=mission.name, waypoints=points_of(mission), end_heading_rad=mission.end_heading_rad
        )
        if self._app.load(new):
            n = len(new.waypoints)
            return self._with_mode("done", "ok", f"mission {new.name} with {n} waypoints loaded: start begins it")
        return self._with_mode("refused", "not_now", "a mission is being driven: hold or stop first")

    def _with_mode(self, status, code, text: str) -> OrderOutcome:
        helm = self._app.state.helm
        return msgspec.structs.replace(self._outcome(status, code, text), mode=helm.mode, why=helm.why)

    def _outcome(self, status, code, text: str) -> OrderOutcome:
        return OrderOutcome(run=self._gate.run, t_ns=self._clock.now_ns(), status=status, code=code, text=text)

    def _finish(self, order: Order, outcome: OrderOutcome) -> None:
        with self._lock:
            self._gate.finish(order, outcome)

    # --- the answer thread -------------------------------------------------------------------------

    def _send(self, asked: Asked, outcome: OrderOutcome) -> None:
        try:
            if not asked.proven and self._answers.qsize() >= TO_STRANGERS:
                raise queue.Full
            self._answers.put_nowait((asked, outcome))
        except queue.Full:
            asked.query.drop()

    def _reply(self) -> None:
        while (answer := self._answers.get()) is not None:
            asked, outcome = answer
            data = msgspec.json.encode(outcome)
            signed = self._gate.answer_seal(asked.order, data) if asked.proven else None
            with contextlib.suppress(zenoh.ZError), asked.query as query:
                query.reply(
                    self._key,
                    data,
                    encoding=zenoh.Encoding.APPLICATION_JSON,
                    attachment=signed,
                    congestion_control=zenoh.CongestionControl.DROP,  # who asks again gets it again
                    priority=zenoh.Priority.REAL_TIME if asked.proven else zenoh.Priority.DATA_LOW,
                    express=asked.proven,
                )
