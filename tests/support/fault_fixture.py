"""The whole App on the stepped clock, and a world in which everything may go wrong at its wires.

Nothing of the App is replaced but what it is given: ports of memory, a clock that is stepped, a solver. What the
boat sends and what it was able to hear is kept as pymavlink decodes it, for `fault_oracle`.
"""

from __future__ import annotations

import asyncio
import random
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as wire

from companion.core.messages import ManualInput, OperatorCommand
from drivers.mavlink.codec import MavlinkCodec
from sim.world.sensors import UwbFaults
from sim.world.world import STEP_NS
from tests.companion.boat.app_fixture import Bench, S, received
from tests.support.drive_fixture import nmpc
from tests.support.fault_solver import Brain, mind
from tests.support.fault_wires import Heard, frame_parser, whole
from tests.support.faults import Fault, Sequence

STICKS_US = (1500,) * 4 + (1000,) + (1500,) * 11
HAND_CHANNEL = 5
BROKEN_SHARE = 0.3
"""Of the frames on a wire that corrupts."""
STICK_STEPS = 5
"""20 Hz."""
LASTING = ("cable", "down", "up", "uwb", "imu", "battery", "solver", "hand", "laggy")
_IMU = frozenset({"RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3", "ATTITUDE"})
_STAMPS = ("time_boot_ms", "time_usec")
_SHARES = {"rest": (0.0, 0.0, 0.0), "moved": (0.6, 0.0, 0.2), "nan": (float("nan"),) * 3, "wild": (3.0, 0.0, 0.0)}
_GCS = {"disarm": (400, 0), "arm": (400, 1), "hold": (176, 1, 4), "loiter": (176, 1, 5), "manual": (176, 1, 0)}


class FaultBench(Bench):
    """`play` it once. Afterwards: `sent` (by the boat), `seen` (its watcher), `heard`, `stopped_ns`, `raised`."""

    def __init__(self, path, told: Sequence, seed=21):
        self.brain = Brain(nmpc() if told.real else None)
        # 16 channels: thrusters' channels at rest, too, when overrides end
        super().__init__(path, self.brain, seed, mind(), MavlinkCodec(), receiver_us=STICKS_US if told.receiver else ())
        self.heard, self.stopped_ns, self.raised = Heard(), 1 << 62, None
        self._told, self._dice = told, random.Random(seed)
        self.noisy = any(f.kind == "down" and f.how in ("corrupt", "garbage") for f in told.faults)
        self._on: dict[str, tuple[str, int]] = {}
        self._steps, self._stall_end_ns, self._solve_due_ns, self._stick = 0, None, None, "gone"
        self._late: list[tuple[int, int, bytes, list]] = []
        self._last_imu: dict[str, Any] = {}
        self._at_rover, self._pack = frame_parser(), frame_parser()
        self._gcs = wire.MAVLink(None, srcSystem=255, srcComponent=190)

    def play(self):
        """The whole story; returns itself."""
        self.raised = self.scene(lambda _: self._story())
        return self

    async def _story(self):
        await self.run(1.5)
        await self._begin(self._told.beginning)
        for fault in self._told.faults:
            await self.run(fault.after_s)
            await self._happen(fault)
        ends_ns = max((until for _, until in self._on.values()), default=0)
        await self.run(max(0.0, (ends_ns - self.clock.now_ns()) / S) + 3.0)
        self.stopped_ns = self.clock.now_ns()

    async def _begin(self, beginning):
        if beginning == "idle":
            return
        self._command({"auto": "start", "excitation": "excite"}.get(beginning, beginning))
        if beginning == "manual":
            self._stick = "rest"
        moving = lambda: self.mode == beginning  # noqa: E731
        await self.run(12.0, until=moving)
        assert moving(), f"never began: {self.app.state.helm}"
        self._stick = "moved" if beginning == "manual" else "gone"
        await self.run(0.5)

    async def _happen(self, fault: Fault):
        while self._stall_end_ns is not None:
            await self.run(0.01)
        now = self.clock.now_ns()
        if fault.kind in LASTING:
            self._on[fault.kind] = fault.how, now + round(fault.lasts_s * S)
        elif fault.kind == "lag":
            self._stall(float(fault.how))
        elif fault.kind == "operator":
            self._command(fault.how)
        elif fault.kind == "sticks":
            self._stick = fault.how
        elif fault.kind == "gcs":
            command, *params = _GCS[fault.how]
            frame = self._gcs.command_long_encode(1, 1, command, 0, *params, *[0] * (7 - len(params)))
            self.world.mavlink(bytes(frame.pack(self._gcs)), "gcs")
        else:
            self.world.rover.vehicle.reboot_asked = True  # as after a dip of its supply; taken at the next bytes

    def _command(self, name):
        self.heard.commands.append((self.clock.now_ns(), name))
        self.app.command(OperatorCommand(t_ns=self.clock.now_ns(), command=name))

    # --- time --------------------------------------------------------------------------------------

    async def run(self, seconds, until=lambda: False):
        """Advance world and clock; whether `until` became true."""
        for _ in range(round(seconds * S / STEP_NS)):
            await self._step()
            if until():
                return True
        return False

    async def _step(self):
        self._steps += 1
        self._faults()
        outgoing = self.world.step()
        t_ns = self.world.t_ns
        modes = self.world.rover.vehicle.modes
        self.heard.esc.append((t_ns, self.world.rover.outputs_us[:4], modes.armed and modes.mode == 0))
        if not self.near_open:
            self.heard.shut_ns.append(t_ns)
        self._from_rover(b"".join(data for peer, data in outgoing.mavlink if peer == "boat"))
        self._from_tag(outgoing.uwb)
        if self._stall_end_ns is not None:
            if t_ns < self._stall_end_ns:
                return
            self._wake(t_ns)
        self._deliver(t_ns)
        await self.clock.advance(t_ns - self.clock.now_ns())
        self._move_sticks(t_ns)
        await self._solve(t_ns)

    @property
    def near_open(self):
        return self.far.other.is_open

    def _stall(self, seconds):
        if self._stall_end_ns is None:
            self._stall_end_ns = self.world.t_ns + round(seconds * S)
            self.heard.stalls.append((self.world.t_ns, self._stall_end_ns))

    def _wake(self, t_ns):
        """Everybody who slept through the stall wakes now, none at the instant that was meant."""
        self.clock.stall(t_ns)
        self._stall_end_ns = None

    async def _solve(self, t_ns):
        """The solver's thread gets on at the ends of steps alone: the same story, the same run."""
        late = self.brain.fault.removeprefix("late ") if self.brain.fault.startswith("late") else "0"
        self.brain.open = self.stopped_ns <= t_ns
        for _ in range(20000):
            if self.brain.open:
                self.brain.let_go()
            if not self.app.solving or self.running.done():
                return
            if self.brain.waiting:
                if self._solve_due_ns is None:
                    self._solve_due_ns = t_ns + round(float(late) * S)
                if self.brain.fault == "never" or t_ns < self._solve_due_ns:
                    return
                self._solve_due_ns = None
                self.brain.let_go()
            await asyncio.sleep(0.0002)
        raise AssertionError("the solver's thread does not come back")

    def _faults(self):
        """End what is over; apply what lasts."""
        t_ns = self.world.t_ns
        self._on = {kind: (how, until) for kind, (how, until) in self._on.items() if until > t_ns}
        on = self._fault
        self.world.silent_uwb = on("uwb") == "silent"
        self.world.uwb_sensor.faults = UwbFaults(nlos=0.6) if on("uwb") == "nlos" else UwbFaults()
        self.brain.fault = on("solver")
        if self._told.receiver:
            moved = {HAND_CHANNEL - 1: 1900} if on("hand") else {}
            self.world.receiver_us = tuple(moved.get(i, pulse) for i, pulse in enumerate(STICKS_US))
        if (gap := on("laggy")) and self._stall_end_ns is None and self._steps % 30 == 0:
            self._stall(float(gap))

    def _fault(self, kind):
        return self._on.get(kind, ("", 0))[0]

    def _move_sticks(self, t_ns):
        if self._stick != "gone" and self._steps % STICK_STEPS == 0:
            shares = _SHARES[self._stick]
            self.heard.sticks.append((t_ns, shares))
            surge, sway, yaw = shares
            self.app.manual(ManualInput(t_ns=t_ns, source="pad", surge=surge, sway=sway, yaw=yaw))

    # --- wires -------------------------------------------------------------------------------------

    async def _autopilot(self):
        async for data in received(self.far):
            t_ns = self.clock.now_ns()
            self.sent += [(t_ns, m) for m in whole(self._parser, data)]
            how = "silent" if self._fault("cable") else self._fault("up")
            if how == "silent":
                continue
            arrived = self._corrupt(data) if how == "corrupt" else data
            for _ in range(2 if how == "duplicate" else 1):
                self.heard.rover += [
                    (t_ns, m) for m in whole(self._at_rover, arrived) if m.get_type() == "RC_CHANNELS_OVERRIDE"
                ]
                self._from_rover(self.world.mavlink(arrived, "boat"))

    async def _tag(self):
        async for data in received(self.far_tag):
            if self._fault("uwb") not in ("silent", "garbage"):
                self._late.append((self.world.t_ns, 1, self.world.uwb(data), []))

    def _from_rover(self, data):
        """Frame by frame: a broken parser of ours would not know what the boat could hear."""
        how = "silent" if self._fault("cable") else self._fault("down")
        sent, intact = b"", []
        for m in whole(self._pack, data):
            if not self._fault("imu") and m.get_type() in _IMU:
                self._last_imu[m.get_type()] = m
            frame = self._tampered(m)
            spoilt = self._corrupt(frame) if how == "corrupt" and self._dice.random() < BROKEN_SHARE else frame
            if frame and spoilt == frame:
                intact += whole(frame_parser(), frame)
            sent += spoilt
        if how == "silent":
            return
        if how == "garbage":
            sent += self._dice.randbytes(self._dice.randrange(40))
        delay_s = float(how.removeprefix("delay ")) if how.startswith("delay") else 0.0
        for _ in range(2 if how == "duplicate" else 1):
            self._late.append((self.world.t_ns + round(delay_s * S), 0, sent, intact))

    def _from_tag(self, data):
        how = self._fault("uwb")
        if how == "garbage":
            self._late.append((self.world.t_ns, 2, self._dice.randbytes(self._dice.randrange(8)), []))
        elif data:
            delay_s = 1.2 if how.startswith("delay") else 0.0
            for _ in range(2 if how == "duplicate" else 1):
                self._late.append((self.world.t_ns + round(delay_s * S), 1, data, []))

    def _deliver(self, t_ns):
        due = [late for late in self._late if late[0] <= t_ns]
        self._late = [late for late in self._late if late[0] > t_ns]
        for _, kind, data, intact in due:
            if kind == 0:
                if self.near_open:
                    self.heard.boat += [(t_ns, m) for m in intact]
                self._give(self.far, data)
            else:
                if data and kind == 1 and self.far_tag.other.is_open:
                    self.heard.uwb_ns.append(t_ns)
                self._give(self.far_tag, data)

    def _corrupt(self, data):
        spoilt = bytearray(data)
        for _ in range(1 + len(data) // 40 if data else 0):
            spoilt[self._dice.randrange(len(spoilt))] ^= 1 << self._dice.randrange(8)
        return bytes(spoilt)

    def _tampered(self, m):
        """One frame of the autopilot, as the fault has it."""
        kind, imu, battery = m.get_type(), self._fault("imu"), self._fault("battery")
        if kind in _IMU and imu:
            return self._broken_imu(m, self._last_imu.get(kind, m), imu)
        if kind == "SYS_STATUS" and battery:
            return self._repacked(m, voltage_battery=round(float(battery) * 1000))
        if kind == "BATTERY_STATUS" and battery:
            return self._repacked(m, voltages=[round(float(battery) * 1000)] + [65535] * 9)
        return bytes(m.get_msgbuf())

    def _broken_imu(self, m, last, how):
        if how == "silent":
            return b""
        if how == "stuck":
            return self._repacked(last, **{n: getattr(m, n) for n in _STAMPS if hasattr(m, n)})
        if how == "nan" and m.get_type() == "ATTITUDE":
            return self._repacked(m, yaw=float("nan"), yawspeed=float("nan"))
        return bytes((last if how == "frozen" else m).get_msgbuf())

    def _repacked(self, m, **fields):
        mav = wire.MAVLink(None, srcSystem=m.get_srcSystem(), srcComponent=m.get_srcComponent())
        mav.seq = m.get_seq()
        values = {name: getattr(m, name) for name in m.fieldnames} | fields
        return bytes(type(m)(**values).pack(mav))
