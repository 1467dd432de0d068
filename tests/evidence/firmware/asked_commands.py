"""Questions about commands, modes and arming. A family is asked in a world of its own, from its start."""

from __future__ import annotations

from collections.abc import Iterator

from pymavlink.dialects.v20 import ardupilotmega as wire

from tests.evidence.firmware.dialogue import COMPANION, GROUND, NEUTRAL, Dialogue, command, command_int

Answers = Iterator[tuple[str, str]]

COMMANDS = """
    16 17 20 21 22 92 112 115:90,5,1,1 176:0,4 177:1,0 178:0,1.5 178:0,-1 179:1 179:0,0,0,0,12.99,80.23,0
    179:0,0,0,0,91,0,0 180 181:0,1 181:99,1 182:0,1,1 183:8,1500 183:1,1500 183:99,1500 184:8,1500,1,1 185:0 189
    192:-1,0,0,0,0,0,0 194:1 195:0,0,0,0,12.99,80.23,0 197 201:1 203 205 206:1 207:1 207:0 208 209:1,0,10,0.1
    211:1,0 212:1 213:45,1,0 218:0,0 218:999,0 222 223 224:0 224:5 241 242 243 245:0 245:1 246:0 246:2 252 300
    400:2 401 410 420:7 420 500:0 510:30 510:31000 510:70000 511:30,-1 511:31000,100000 512:31000 512:148 519:1
    520:1 520:0 521:1 522:1 525:1 527:1 530:1 600:1 601:1 1000 2000 2003 2500 2510 2511 2520 2600:0 3000 4000
    5000 5001 5300:2 30001 31000:1 31010 42000 42001 42002 42003 42004 42005 42006 42007:1 42007:9 42425 42426
    42428 42429 42501 42600 42650 42651:0 42700 42702 42703 43000 43001 43003
"""
"""MAV_CMD numbers, with parameters behind a colon: what Rover handles, and much that it does not. Left out is what
ends the autopilot or empties its memory (PREFLIGHT_STORAGE 2, REBOOT 42), and what it does not come back from without
a reboot (calibration of the compass)."""
OUTPUT_FUNCTIONS = (
    (), (109,), (95,), (94,), (33,), (51,), (140,), (26,), (70,), (26, 70), (73,), (73, 74), (89, 26),
)  # fmt: skip
"""SERVO1_FUNCTION, SERVO2_FUNCTION, ... that arming is tried with."""
IN_FLOAT_AND_INT = (16, 92, 179, 192, 195, 400, 512, 520, 31000)


def commands(d: Dialogue) -> Answers:
    """Every command of interest, as COMMAND_LONG; some as COMMAND_INT."""
    d.settle()
    for token in COMMANDS.split():
        number, _, params = token.partition(":")
        said = d.command(int(number), *map(float, params.split(",") if params else ()), seconds=0.4)
        yield f"command {number} ({params})", said
        d.command(wire.MAV_CMD_DO_SET_MODE, 1, 4)
    for number in IN_FLOAT_AND_INT:
        yield f"command {number} as COMMAND_INT", d.ask(command_int(number, 1.0))
    yield "state after all commands", d.state()


def modes(d: Dialogue) -> Answers:
    """Every mode by DO_SET_MODE, disarmed and armed, and SET_MODE."""
    d.settle()
    for number in [*range(18), 20, 26, 99]:
        said = d.command(wire.MAV_CMD_DO_SET_MODE, 1, number)
        yield f"mode {number} disarmed", f"{said} -> {d.state()}"
        d.command(wire.MAV_CMD_DO_SET_MODE, 1, 4)
    for target, base, number in [(1, 1, 0), (1, 1, 4), (1, 1, 99), (0, 1, 0), (2, 1, 0), (1, 0, 0), (1, 129, 0)]:
        said = d.ask(wire.MAVLink_set_mode_message(target, base, number))
        yield f"SET_MODE {target} {base} {number}", f"{said} -> {d.state()}"
        d.command(wire.MAV_CMD_DO_SET_MODE, 1, 4)
    for number in [0, 4, 5, 15, 1, 3, 10, 11, 16]:
        d.command(wire.MAV_CMD_DO_SET_MODE, 1, number)
        said = d.command(wire.MAV_CMD_COMPONENT_ARM_DISARM, 1, seconds=0.6)
        yield f"arming in mode {number}", f"{said} -> {d.state()}"
        d.command(wire.MAV_CMD_COMPONENT_ARM_DISARM, 0, 21196)
        d.command(wire.MAV_CMD_DO_SET_MODE, 1, 4)
    d.command(wire.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    for number in [*range(13), 15, 16, 99]:
        said = d.command(wire.MAV_CMD_DO_SET_MODE, 1, number)
        yield f"mode {number} armed", f"{said} -> {d.state()}"
        d.command(wire.MAV_CMD_DO_SET_MODE, 1, 4)


def arming(d: Dialogue) -> Answers:
    """Arming: what it asks for and what it says."""
    d.settle()
    arm, disarm = (command(wire.MAV_CMD_COMPONENT_ARM_DISARM, value) for value in (1, 0))

    def attempt(sender: tuple[int, int] = COMPANION) -> str:
        said = d.ask(arm, sender, seconds=0.6)
        said = f"{said} -> {d.state()}"
        d.ask(disarm)
        return said

    d.command(wire.MAV_CMD_DO_SET_MODE, 1, 0)
    yield "arming with overrides", attempt()
    yield "arming by a ground station", attempt(GROUND)
    yield "arming while armed", f"{d.ask(arm)} {d.ask(arm)} {d.ask(disarm)}"
    yield "disarming while disarmed", d.ask(disarm)
    yield "arming with param1 0.5", d.command(400, 0.5)
    for name, channel in (("roll", 0), ("pitch", 1), ("throttle", 2), ("yaw", 3)):
        d.override = [*NEUTRAL[:channel], 1700, *NEUTRAL[channel + 1 :]]
        d.wait(0.5)
        yield f"arming with {name} away from neutral", attempt()
    d.override = NEUTRAL
    yield "safety switch on", d.command(5300, 0)
    d.wait(6.0)  # it says so by itself within that time
    yield "arming with the safety switch on", attempt()
    yield "pre-arm checks with the safety switch on", d.command(401, seconds=0.6)
    d.command(5300, 1)
    d.wait(1.0)
    for functions in OUTPUT_FUNCTIONS:
        for n in range(1, 5):
            put(d, f"SERVO{n}_FUNCTION", functions[n - 1] if n <= len(functions) else 0)
        d.wait(1.5)
        yield f"arming with output functions {functions}", attempt()
    for n in range(1, 5):
        put(d, f"SERVO{n}_FUNCTION", 93 + n)
    put(d, "FRAME_TYPE", 2)
    put(d, "ARMING_CHECK", 0)
    d.wait(1.5)
    put(d, "FRAME_TYPE", 0)
    d.command(5300, 0)
    d.wait(1.0)
    yield "arming with ARMING_CHECK 0 and the safety switch on", attempt()
    d.command(5300, 1)
    put(d, "ARMING_CHECK", 1)
    d.override = None
    d.wait(3.0)
    yield "arming without receiver and overrides", attempt()
    yield "arming by force without receiver and overrides", f"{d.command(400, 1, 2989)} -> {d.state()}"
    d.ask(disarm)
    yield "pre-arm checks without receiver and overrides", d.command(401, seconds=0.6)


def put(d: Dialogue, name: str, value: float) -> str:
    """PARAM_SET as a real number; the answer."""
    return d.ask(wire.MAVLink_param_set_message(1, 1, name.encode(), value, wire.MAV_PARAM_TYPE_REAL32))
