"""A boat with one of the parameter files in deploy/ardupilot: driven, then something happens to it.

    outcome("gate", 0, "companion dies")   ->  Outcome(((1500, 0.52),))

`python tests/sim/world/wirings/wiring_fixture.py` prints the table of docs/autopilot.md.
"""

from __future__ import annotations

from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as wire

from companion.cli.simulator.autopilot_options import wirings
from companion.core.preflight.parameter_file import parse_parameters
from sim.world.autopilot.parameter_table import BOARD_PARAMETERS
from tests.sim.world.autopilot.autopilot_fixture import Bench, S, command

DRIVEN_US = 1700
PILOT_US = 1450
CASES = [(wiring, receiver) for wiring in ("gate", "scaled", "omni", "unsafe_plain") for receiver in (0, 8, 16)]
EVENTS = ("companion dies", "disarmed", "HOLD")
PATIENCE_S = 10.0


class Outcome(NamedTuple):
    """What output 1 did: (pulse [us], seconds after the event) of each value that lasted; empty: nothing changed."""

    changes: tuple[tuple[int, float], ...]

    @property
    def text(self) -> str:
        """As the table says it."""
        words = {1500: "neutral", 0: "no pulse", PILOT_US: "the pilot's", 1100: "FULL REVERSE"}
        said = [f"{words.get(us, f'{us} us')} after {after_s:.2f} s" for us, after_s in self.changes]
        return ", ".join(said) or f"STAYS AT {DRIVEN_US} us"


def load(wiring: str) -> dict[str, float]:
    """The file's parameters."""
    return parse_parameters(wirings()[wiring], name=wiring)


def driven(wiring: str, receiver: int = 0, **rover) -> tuple[Bench, wire.MAVLink_message]:
    """A boat under way at `DRIVEN_US` on all thrusters, and the override that does it."""
    bench = Bench(base={**BOARD_PARAMETERS, **load(wiring)}, dt_s=0.002, **rover)
    if receiver:  # sticks in the middle, the channels of the thrusters where the pilot wants them
        bench.receiver(*([1500] * 8 + [PILOT_US] * 4 + [1500] * 4)[:receiver])
    bench.run(1.5, every=_drive(wiring, 1500))
    bench.send(command(176, 1, 0))
    bench.send(command(400, 1))
    override = _drive(wiring, DRIVEN_US)
    bench.run(0.5, every=override)
    assert bench.rover.outputs_us[:4] == (DRIVEN_US,) * 4
    return bench, override


def outcome(wiring: str, receiver: int, event: str) -> Outcome:
    """Drive, let it happen, and wait for `PATIENCE_S`."""
    bench, override = driven(wiring, receiver)
    bench.send(override)
    start_ns, changes = bench.t_ns, []
    if event != "companion dies":
        bench.join("gcs", system=255)
        bench.send(command(400, 0) if event == "disarmed" else command(176, 1, 4), "gcs")
    before, due_s = DRIVEN_US, 0.0
    while (after_s := (bench.t_ns - start_ns) / S) < (PATIENCE_S if event == "companion dies" else 3.0):
        if event != "companion dies" and after_s >= due_s:
            bench.send(override)
            due_s += 0.1
        bench.run(0.002)
        if bench.out(1) != before:
            before = bench.out(1)
            changes.append((before, (bench.t_ns - start_ns) / S))
    assert bench.rover.outputs_us[:4] == (before,) * 4
    return Outcome(tuple(changes))


def table() -> list[str]:
    """Rows of the table in the documents."""
    return [
        f"| `{wiring}` | {receiver or 'none'} | " + " | ".join(outcome(wiring, receiver, e).text for e in EVENTS) + " |"
        for wiring, receiver in CASES
    ]


def _drive(wiring: str, us: int) -> wire.MAVLink_message:
    """Omni-X by its throttle, the others by channels 9-12 with 1-4 in neutral."""
    low = [1500, 1500, us, 1500] if wiring == "omni" else [1500] * 4
    high = [0] * 4 if wiring == "omni" else [us] * 4
    return wire.MAVLink_rc_channels_override_message(0, 0, *low, *[65535] * 4, *high, *[0] * 6)


if __name__ == "__main__":
    print("\n".join(table()))
