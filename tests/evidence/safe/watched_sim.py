"""`aritra sim` with a pen and hands, for the kill matrix.

SIM_PEN=FILE python -m tests.evidence.safe.watched_sim sim ...

The pen writes every step of 10 ms what leaves the simulated autopilot (16 outputs, the speed controllers' inputs among
them), and every override that reaches it. The hands do what a line on standard input says: a fault of a sensor, a
stick, a reboot, a current. Both are put around `World` in this process alone; the program itself has no such hooks.
"""

from __future__ import annotations

import os
import queue
import sys
import threading
from collections.abc import Callable, Mapping
from dataclasses import replace

import msgspec

from companion.__main__ import main
from sim.world import loopback
from sim.world.autopilot.rc import RcInput
from sim.world.world import Outgoing, World

FLUSH_STEPS = 10


class Watched(World):
    """A World that writes down what leaves it and does what `_orders` say."""

    def __init__(self, setup, seed: int):
        super().__init__(setup, seed)
        self._pen = open(os.environ["SIM_PEN"], "w", encoding="ascii")  # noqa: SIM115 - open until the process ends
        self._orders: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._steps = 0
        threading.Thread(target=self._listen, daemon=True).start()
        self._watch_overrides()

    def step(self) -> Outgoing:
        """One step on, noted."""
        while not self._orders.empty():
            name, *words = self._orders.get().split()
            HANDS[name](self, *words)
        outgoing = super().step()
        modes, x = self.rover.vehicle.modes, self.plant.motion.x
        pulses = " ".join(map(str, self.rover.outputs_us))
        self._pen.write(f"s {self.t_ns} {pulses} {int(modes.armed)} {int(modes.mode)} {x[0]:.3f} {x[1]:.3f}\n")
        self._steps += 1
        if self._steps % FLUSH_STEPS == 0:
            self._pen.flush()
        return outgoing

    def _listen(self) -> None:
        for line in sys.stdin:
            if line.strip():
                self._orders.put(line)

    def _watch_overrides(self) -> None:
        taken, pen = RcInput.override, self._pen

        def override(rc: RcInput, values_us, t_ns: int) -> None:
            pen.write(f"o {t_ns} {' '.join(map(str, values_us))}\n")
            taken(rc, values_us, t_ns)

        RcInput.override = override


def _silence(world: Watched) -> None:
    world.silent_uwb = True


def _ranges(change: Callable[[dict[str, float | None]], dict[str, float | None]], world: Watched) -> None:
    measure = world.uwb_sensor.measure
    world.uwb_sensor.measure = lambda motion: change(measure(motion))


def _no_anchors(world: Watched) -> None:
    _ranges(dict.fromkeys, world)


def _far(world: Watched, metres: str, *anchors: str) -> None:
    """Ranges of these anchors read so much too far."""

    def change(ranges: dict[str, float | None]) -> dict[str, float | None]:
        return {a: r + float(metres) if r is not None and a in anchors else r for a, r in ranges.items()}

    _ranges(change, world)


def _freeze_imu(world: Watched) -> None:
    """The same readings for ever, with stamps that go on."""
    frame = world._frame
    world._sense = lambda moment: msgspec.structs.replace(frame, receiver_us=world.receiver_us)


def _volts(world: Watched, volts: str) -> None:
    world.plant._open_v = float(volts)


def _clock(world: Watched, seconds: str) -> None:
    """The autopilot's own clock jumps."""
    world.rover.vehicle._boot_ns -= round(float(seconds) * 1e9)


def _reboot(world: Watched) -> None:
    """As by a brown-out: armed or not."""
    world.rover._up_ns = world.t_ns + 4_000_000_000


def _sticks(world: Watched, *pulses: str) -> None:
    world.receiver_us = tuple(map(int, pulses))


def _current(world: Watched, speed: str, towards: str) -> None:
    sky = world._environment
    sky._weather = replace(sky._weather, V_c_m_s=float(speed), beta_c_deg=float(towards))


HANDS: Mapping[str, Callable[..., None]] = {
    "uwb_silent": _silence,
    "no_anchors": _no_anchors,
    "far": _far,
    "imu_frozen": _freeze_imu,
    "volts": _volts,
    "clock": _clock,
    "reboot": _reboot,
    "sticks": _sticks,
    "current": _current,
}

if __name__ == "__main__":
    loopback.World = Watched
    sys.exit(main(sys.argv[1:]))
