"""What world `aritra sim`, `demo` and `excite fly` simulate, from the command line: the start, weather, errors."""

from __future__ import annotations

import argparse
import math
from typing import TYPE_CHECKING, Any

from companion.boat.load_run import RunSetup
from companion.cli.options.values import Each, angle_deg, number, seed, share
from companion.core.configuration.tables import ConfigError
from sim.world_limits import CURRENT_M_S, FARTHEST_M, MISMATCH, WAVES_M, WIND_M_S

if TYPE_CHECKING:
    from sim.world.world import WorldSetup

START = (8.0, 8.0, 20.0)
"""Where a simulated boat begins: north, east [m], heading [deg]."""
NOT_STATED = "left out: the vessel file's, or none"
place_m = number(-FARTHEST_M, FARTHEST_M, "a place [m]")


def add_world_arguments(p: argparse.ArgumentParser, start: tuple[float, float, float] | None = START) -> None:
    """What world to simulate; shared with `demo`. `start`: where the boat begins; None: in the middle of the water."""
    w = p.add_argument_group("world")
    w.add_argument("--seed", type=seed, default=1, metavar="N", help="of noise, biases, weather and mismatch")
    where = " ".join(f"{value:g}" for value in start) if start else "the middle, heading north"
    begins = f"place [m] and heading (default: {where})"
    _each(w, "--start", start, ("N", "E", "DEG"), (place_m, place_m, angle_deg), begins)
    flow, air = number(0.0, CURRENT_M_S, "a current [m/s]"), number(0.0, WIND_M_S, "a wind [m/s]")
    _each(w, "--current", None, ("M/S", "DEG"), (flow, angle_deg), f"towards; {NOT_STATED}")
    _each(w, "--wind", None, ("M/S", "DEG"), (air, angle_deg), f"from; {NOT_STATED}")
    w.add_argument("--gusts", type=share, default=0.2, metavar="SHARE", help="standard deviation of wind speed, share")
    height = number(0.0, WAVES_M, "a height [m]")
    w.add_argument("--waves", type=height, metavar="M", help=f"significant height; {NOT_STATED}")
    off = number(0.0, MISMATCH, "a share")
    w.add_argument("--mismatch", type=off, default=0.0, metavar="SHARE", help="plant off its vessel file by up to")
    w.add_argument("--nlos", type=share, default=0.0, metavar="SHARE", help="of UWB ranges that read far")
    w.add_argument("--dropout", type=share, default=0.0, metavar="SHARE", help="of UWB ranges that are missing")


def _each(group: Any, name: str, default: tuple | None, metavar: tuple, kinds: tuple, text: str) -> None:
    group.add_argument(name, action=Each, kinds=kinds, default=default, metavar=metavar, help=text)


def given_of_world(args: argparse.Namespace) -> list[str]:
    """Options of the world that are not as they are where nothing is given."""
    p = argparse.ArgumentParser()
    add_world_arguments(p)
    names = (name for name, value in vars(p.parse_args([])).items() if getattr(args, name) not in (value, None))
    return [f"--{name}" for name in names]


def world_arguments(args: argparse.Namespace) -> list[str]:
    """The world's options as a command line, to hand them on to a process of its own."""
    arguments: list[str] = ["--seed", str(args.seed)]
    for name in ("start", "current", "wind", "gusts", "waves", "mismatch", "nlos", "dropout"):
        value = getattr(args, name)
        if value is not None:
            arguments += [f"--{name}", *map(str, value if isinstance(value, tuple) else (value,))]
    return arguments


def world_setup(args: argparse.Namespace, setup: RunSetup) -> WorldSetup:
    """The world that the command line asks for, with the run file's boat and site. Raises ConfigError."""
    check_start(args, setup)
    from sim.world.environment import Weather
    from sim.world.sensors import UwbFaults
    from sim.world.world import WorldSetup

    north_m, east_m, heading_deg = args.start
    V_c_m_s, beta_c_deg = args.current or (None, 0.0)
    V_w_m_s, beta_w_deg = args.wind or (None, 0.0)
    return WorldSetup(
        setup.pilot.vessel,
        setup.pilot.site,
        start=(north_m, east_m, math.radians(heading_deg)),
        weather=Weather(
            V_c_m_s=V_c_m_s,
            beta_c_deg=beta_c_deg,
            V_w_m_s=V_w_m_s,
            beta_w_deg=beta_w_deg,
            gustiness=args.gusts,
            H_s_m=args.waves,
        ),
        mismatch=args.mismatch,
        faults=UwbFaults(dropout=args.dropout, nlos=args.nlos),
    )


def check_start(args: argparse.Namespace, setup: RunSetup) -> None:
    """Raise ConfigError for a start beyond the fence."""
    north_m, east_m, _ = args.start
    if not setup.pilot.site.inside(north_m, east_m):
        given = "" if args.start != START else " (what is taken where no --start is given)"
        where = f"north {north_m:g}, east {east_m:g} m{given} lies beyond the fence of site {setup.pilot.site.name}"
        raise ConfigError(f"--start: {where}")
