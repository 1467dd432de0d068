"""One stop on the stepped clock: the boat on its mission, something stops it, what took it is given back, and a minute.

The same on a real firmware (`FirmwareWorld`) and on the simulated autopilot (`World`), judged by what leaves the
autopilot's outputs: at every frame of the firmware (2.5 ms), at every step of the simulated one (10 ms).
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import NamedTuple

from companion.boat.devices.autopilot_commands import NEUTRAL_PERIOD_S, NEUTRAL_REPEATS
from companion.core.messages import GroundTruth, Heartbeat, OperatorCommand, ServoOutput
from drivers.mavlink.encode import MavlinkEncoder
from sim.world.stepped import PEER, SteppedRun
from sim.world.world import STEP_NS, Outgoing, World
from tests.evidence.main_job.parts import reference_boat
from tests.support.autopilots.firmware_world import FirmwareWorld
from tests.support.autopilots.ground_station import GroundStation

THRUSTERS = 4
REST_US = 25
"""Within 1475 to 1525 us a speed controller stands still (Blue Robotics Basic ESC); no pulse is rest, too."""
NEUTRAL_S = 0.7
"""Neutral at the latest so long after whatever stopped the boat (docs/autopilot.md)."""
TAKEN_S, AFTER_S = 4.0, 60.0
"""How long it stays taken; how long nothing may move after it is given back."""
BEGIN_S, UNDER_WAY_S = 90.0, 3.0


class WatchedWorld:
    """A world whose outputs are recorded, and whose wires can be cut. `turned_ns`: when a thruster last turned.

    `largest_us`: largest distance from neutral since `forget`; `held`: the autopilot's bytes wait (a stopped process).
    """

    def __init__(self, world: World | FirmwareWorld):
        self.world = world
        self.cut = self.held = False
        self.turned_ns = self.largest_us = self._seen = 0
        self._waiting: list[tuple[Hashable, bytes]] = []

    @property
    def t_ns(self) -> int:
        """Simulated time [ns]."""
        return self.world.t_ns

    def forget(self) -> None:
        """From here on `largest_us` counts anew."""
        self.largest_us = 0

    def step(self) -> Outgoing:
        """One step on."""
        outgoing = self.world.step()
        for t_ns, pulses_us in self._outputs():
            away = max(abs(pulse - 1500) if pulse else 0 for pulse in pulses_us[:THRUSTERS])
            self.largest_us = max(self.largest_us, away)
            self.turned_ns = t_ns if away > REST_US else self.turned_ns
        if self.cut:
            return Outgoing([], outgoing.uwb)
        due, self._waiting = [*self._waiting, *outgoing.mavlink], []
        if self.held:
            due, self._waiting = [], due
        return Outgoing(due, outgoing.uwb)

    def _outputs(self) -> list[tuple[int, tuple[int, ...]]]:
        """Outputs since the last step, that which still stands included."""
        if isinstance(self.world, World):
            return [(self.t_ns, self.world.rover.outputs_us)]
        changes = self.world.pulses[self._seen :]
        self._seen = len(self.world.pulses)
        return [*changes, (self.t_ns, self.world.pulses[-1][1])]

    def add_peer(self, peer: Hashable) -> None:
        """A MAVLink peer is there."""
        self.world.add_peer(peer)

    def mavlink(self, data: bytes, peer: Hashable) -> bytes:
        """Bytes to the autopilot; nothing of the companion's while its cable is cut."""
        return b"" if self.cut and peer == PEER else self.world.mavlink(data, peer)

    def uwb(self, data: bytes) -> bytes:
        """Bytes to the UWB tag."""
        return self.world.uwb(data)

    def truth(self) -> GroundTruth:
        """What really is."""
        return self.world.truth()


class Trial:
    """A mission under way in `world`, with a ground station beside it."""

    def __init__(self, world: World | FirmwareWorld):
        _, pilot, nmpc = reference_boat()
        self.watched = WatchedWorld(world)
        self.run = SteppedRun(self.watched, pilot, nmpc.solve)
        self.station = GroundStation(world)
        self.encoder = MavlinkEncoder(1, 191, 1, 1)
        driving = lambda run: run.state.helm.mode == "auto" and self.watched.largest_us > REST_US  # noqa: E731
        if not self.run.run(driving, BEGIN_S):
            raise AssertionError(f"never began: {self.run.state.helm}")
        self.go(UNDER_WAY_S)

    @property
    def mode(self) -> str:
        """The boat's mode."""
        return self.run.state.helm.mode

    @property
    def channels(self) -> tuple[int, ...]:
        """The channels that the boat overrides."""
        return self.run.pilot.channels

    def go(self, seconds: float, *, alive: bool = True) -> None:
        """Time passes; `alive`: the companion runs."""
        end_ns = self.watched.t_ns + round(seconds * 1e9)
        while self.watched.t_ns < end_ns - STEP_NS // 2:
            (self.run if alive else self.watched).step()

    def command(self, name: str) -> None:
        """The operator's command."""
        self.run.feed([OperatorCommand(t_ns=self.watched.t_ns, command=name)])  # pyright: ignore[reportArgumentType]

    def send(self, frame: bytes) -> None:
        """A frame of the companion's."""
        self.watched.mavlink(frame, PEER)

    def end_of_the_run(self) -> None:
        """SIGINT, SIGTERM: what `App` does then. Neutral for a second, disarm, release; nothing more."""
        self.command("stop")
        for _ in range(NEUTRAL_REPEATS):
            self.send(self.encoder.neutral(self.channels))
            self.go(NEUTRAL_PERIOD_S, alive=False)
        self.send(self.encoder.disarm())
        self.send(self.encoder.release(self.channels))

    def latest(self, kind: type[Heartbeat] | type[ServoOutput]) -> Heartbeat | ServoOutput:
        """Newest message of a kind."""
        return self.run.of(kind)[-1]


Act = Callable[[Trial], None]


class Stop(NamedTuple):
    """`take` stops the boat; then `TAKEN_S` pass; `give` gives back what was taken. `alive`: the companion runs on.

    `mode`: the boat's mode at the end; `neutral_s`: goal; `before_s`: the boat drives on so long before.
    """

    name: str
    take: Act
    give: Act = lambda trial: None
    alive: bool = True
    mode: str = "safe"
    neutral_s: float = NEUTRAL_S
    before_s: float = 0.0


class Stopped(NamedTuple):
    """What came of it: `neutral_s` after it a thruster turned for the last time; `away_us`: largest distance of a pulse
    from neutral in the minute after it was given back; `mode`: the boat's, in the end.
    """

    neutral_s: float
    away_us: int
    mode: str


def try_stop(trial: Trial, stop: Stop, after_s: float = AFTER_S) -> Stopped:
    """Bring the stop about, give back, and wait."""
    watched = trial.watched
    trial.go(stop.before_s)
    if watched.turned_ns < watched.t_ns - 1_000_000_000:
        raise AssertionError(f"no thruster has turned for a second: {trial.run.state.helm}")
    taken_ns = watched.t_ns
    stop.take(trial)
    trial.go(TAKEN_S, alive=stop.alive)
    watched.forget()
    stop.give(trial)
    trial.go(after_s, alive=stop.alive)
    neutral_s = max(0, watched.turned_ns - taken_ns) * 1e-9
    return Stopped(neutral_s, watched.largest_us, trial.mode if stop.alive else stop.mode)
