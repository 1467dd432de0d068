"""Which autopilot `aritra sim` simulates: its wiring, parameters, RC receiver, firmware and port."""

from __future__ import annotations

import argparse
from typing import Any

from companion.boat.load_run import EXAMPLES
from companion.cli.options.values import whole
from companion.core.configuration.tables import ConfigError
from companion.core.configuration.vessel_file import VesselFile
from companion.core.constants import NEUTRAL_US
from companion.core.preflight.parameter_file import parse_parameters

FOLDER = EXAMPLES / "ardupilot"
"""Parameter files, one a wiring, and the Lua gate."""
WIRED_CHANNELS = (9, 10, 11, 12)
"""The thrusters' RC channels in those files."""


def wirings() -> dict[str, str]:
    """Texts of the parameter files by wiring."""
    return {path.stem: path.read_text(encoding="utf-8") for path in sorted(FOLDER.glob("*.param"))}


def add_autopilot_arguments(p: argparse.ArgumentParser) -> None:
    """What autopilot to simulate."""
    a = p.add_argument_group("autopilot", "docs/autopilot.md says what each wiring does when the companion dies")
    a.add_argument("--wiring", choices=list(wirings()), help="parameter file in deploy/ardupilot (default: gate)")
    a.add_argument("--param", action="append", default=[], metavar="NAME=VALUE", help="parameter on top; repeatable")
    a.add_argument(
        "--receiver",
        type=whole(4, 16, "a number of channels"),
        metavar="N",
        help="an RC receiver of N channels, all at 1500 us",
    )
    a.add_argument("--firmware", choices=("4.6", "4.7"), default="4.6")
    a.add_argument("--serial", type=int, choices=(0, 1), default=0, help="port of the MAVLink peers (0: USB)")


def autopilot(args: argparse.Namespace, vessel: VesselFile) -> dict[str, Any]:
    """The autopilot's fields of a WorldSetup. Raises ConfigError."""
    from sim.world.autopilot.parameter_table import BOARD_PARAMETERS, BOAT_PARAMETERS
    from sim.world.autopilot.parameters import ParameterStore

    parameters = BOAT_PARAMETERS
    if args.wiring:
        channels = tuple(control.channel for control in vessel.controls)
        if channels != WIRED_CHANNELS:
            raise ConfigError(f"--wiring: for thrusters on channels {WIRED_CHANNELS}, the vessel's are on {channels}")
        parameters = {**BOARD_PARAMETERS, **parse_parameters(wirings()[args.wiring], name=f"{args.wiring}.param")}
    for pair in args.param:
        parameters = {**parameters, **parse_parameters(pair, name=f"--param {pair}")}
    try:
        ParameterStore(parameters)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    receiver_us = (NEUTRAL_US,) * (args.receiver or 0)
    return {
        "parameters": parameters,
        "receiver_us": receiver_us,
        "firmware": args.firmware,
        "serial": args.serial,
    }
