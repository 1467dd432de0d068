"""`aritra run`: the boat's program, on real or simulated wires."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import gc
import os
import random
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Literal

from companion.boat.app import App
from companion.boat.clock import BoatClock
from companion.boat.gcs_forward import GcsForward
from companion.boat.load_run import RunSetup, load_setup, warnings
from companion.boat.log_quota import MB, Swept, alerts, keep_within, new_log, sweep
from companion.boat.recorder import Recorder
from companion.boat.signing_key import STAMP_FILE, keep_timestamp
from companion.boat.start_interlock import SWITCH_ON_S, StartInterlock, companion_of
from companion.boat.systemd.notify import SdNotify
from companion.boat.systemd.status import Service
from companion.boat.uplink.uplink import Shore, shore_of
from companion.cli.boat.progress import Progress
from companion.cli.boat.run_console import RunConsole
from companion.cli.boat.run_end import RunEnd
from companion.cli.boat.terminal_writer import TerminalWriter
from companion.cli.boat.wires import add_config, add_wires, devices_of_run, port_of, signing_of
from companion.cli.interrupts import call_when_asked_to_end
from companion.cli.options.files import excitation_file, mission_file
from companion.cli.options.outputs import output, reason
from companion.cli.options.values import seconds
from companion.core.configuration.tables import ConfigError
from companion.core.control.nmpc import Actuation, Nmpc
from companion.core.messages import Alert, Message, OperatorCommand
from companion.core.model.manoeuvring import StructuredModel
from companion.core.pilot.pilot import Pilot
from companion.jit import CodeStore, compile_loops
from companion.logs.metadata import log_metadata
from drivers.devices import DeviceCodec
from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.gcs_firewall import GcsFirewall
from drivers.mavlink.signing import Signing
from drivers.ports.port import Port
from drivers.ports.url import PortUrlError, open_port_from_url

RUN_FILES = Path()
"""`--excite` without a file."""
REFUSED = 1
"""Exit code of a run on an autopilot that the check refuses, or that ended because the boat was stopped or never began.
"""
UNCHECKED = "UNCHECKED: nobody knows whether the thrusters stop when this program dies (--unchecked)"
PRIORITY = -10
"""Nice value: the control loop has priority over a ground station or a build on the same machine; assumed."""
GIL_S = 0.0001
"""Python's thread switch interval [s]: at the default of 5 ms the solver waits for the filter."""


def add_parser(commands) -> None:
    """Add `run` to the command line."""
    p = commands.add_parser(
        "run",
        help="drive the boat: sensors in, RC override out",
        description="Estimate, guide and control at 10 Hz until interrupted; Ctrl-C ends in neutral and disarm. "
        "Exit code 0 after an orderly end, 1 after a failure, 2 for bad configuration.",
        example="aritra run --config deploy/aritra.toml --mission deploy/missions/square.plan --start",
    )
    add_config(p)
    p.add_argument(
        "--mission",
        type=mission_file,
        metavar="FILE",
        help="mission instead of the run file's (.plan .waypoints .geojson .toml)",
    )
    add_wires(p)
    p.add_argument(
        "--log", type=output, metavar="LOG", help="MCAP log to write (default: aritra-DATE.mcap in log.folder)"
    )
    p.add_argument(
        "--excite",
        nargs="?",
        type=excitation_file,
        const=RUN_FILES,
        metavar="FILE",
        help="fly an excitation instead of the mission: FILE, or without one the run file's",
    )
    p.add_argument("--start", action="store_true", help="begin by itself, without an operator")
    p.add_argument("--unchecked", action="store_true", help="DANGER: do not check how the autopilot is wired")
    p.add_argument(
        "--end-after",
        type=seconds(0.0, 86_400.0),
        metavar="S",
        help="end S seconds after mission or excitation is done, or the boat has stopped itself; or a minute "
        "after an operator has stopped it; or at once where the order of --start has expired (these: exit code 1)",
    )
    p.set_defaults(function=run)


def run(args: argparse.Namespace, desk: RunConsole | None = None) -> int:
    """Run until interrupted or done; the exit code. `desk`: a person who drives by hand."""
    excitation = None if args.excite == RUN_FILES else args.excite
    setup = load_setup(args.config, mission=args.mission, excitation=excitation)
    if args.excite and setup.pilot.excitation is None:
        raise ConfigError(f"{args.config}: excitation: missing key: --excite needs one, or a FILE")
    mavlink = port_of(args, "mavlink", setup.run.mavlink.url)
    devices = devices_of_run(args, setup)
    station = _station(args, setup)
    shore = shore_of(setup, args.config)
    folder = args.config.parent / setup.run.log.folder if setup.run.log.folder else Path()
    log, look = _log(args, setup, folder)
    signing = signing_of(args, setup, log.parent / STAMP_FILE)
    vessel = setup.pilot.vessel.name
    print(f"configuration {setup.digest}: vessel {vessel}, site {setup.pilot.site.name}, log {log}", flush=True)
    for text in warnings(setup):
        print(f"warning: {text}", flush=True)
    try:
        recorder = Recorder(
            log,
            log_metadata(vessel, setup.files),
            time.monotonic_ns,
            wall_offset_ns=time.time_ns() - time.monotonic_ns(),
            attachments={name: text.encode() for name, text in setup.files.items()},
            folder=None if args.log else folder,
        )
    except OSError as error:
        key = "" if args.log else f"{args.config}: log.folder: "
        print(f"aritra run: {key}{reason(error, log)}", file=sys.stderr)
        return 2
    if desk:
        desk.begins(log)
    if recorder.problem:
        print(f"error: {recorder.problem}; it runs without a recording until then", flush=True)
    with recorder, Service(SdNotify(os.environ, os.getpid())) as service:
        service.starting(f"building the controller of {vessel}")
        code = asyncio.run(
            _drive(setup, mavlink, devices, station, shore, signing, recorder, service, look, args, desk)
        )
    print(f"log: {log}", flush=True)
    return code


def _log(args: argparse.Namespace, setup: RunSetup, folder: Path) -> tuple[Path, Callable[[], Swept] | None]:
    """Path of the log, the `folder` of logs within its quota; and the function that checks the quota again."""
    settings = setup.run.log
    log = args.log or new_log(folder, time.localtime())
    if settings.quota_MB is None:
        return log, None
    running = log.name if log.parent.resolve() == folder.resolve() else ""
    quota_bytes = settings.quota_MB * MB

    def look() -> Swept:
        return sweep(folder, quota_bytes=quota_bytes, running=running, now_s=time.time())

    for alert in alerts(look(), None, 0):
        print(f"{alert.level}: {alert.text}", flush=True)
    return log, look


def _station(args: argparse.Namespace, setup: RunSetup) -> Port | None:
    """The port of the ground station, if the run file has one. Raises ConfigError."""
    if setup.run.forward is None:
        return None
    try:
        return open_port_from_url(setup.run.forward.url)
    except PortUrlError as error:
        raise ConfigError(f"{args.config}: forward.url: {error}") from None


async def _drive(
    setup: RunSetup,
    mavlink: Port,
    devices: dict[str, tuple[Port, DeviceCodec]],
    station: Port | None,
    shore: Shore,
    signing: Signing | None,
    recorder: Recorder,
    service: Service,
    look: Callable[[], Swept] | None,
    args: argparse.Namespace,
    desk: RunConsole | None,
) -> int:
    clock = BoatClock()
    screen = TerminalWriter(sys.stdout)
    progress = desk or Progress(len(setup.pilot.mission.path.waypoints), screen)
    finish = RunEnd(args.end_after, _order(args) if args.start else "")

    def watch(message: Message) -> None:
        progress.see(message)
        service.see(message)
        shore.see(message)
        if finish.see(message) or (args.start and guard and guard.turns_away):
            end()

    def end() -> None:
        app.stop()  # before what may fail
        service.stopping()
        progress.ends()
        shore.end()

    def tell(alert: Alert) -> None:
        recorder.record(alert)
        progress.see(alert)
        shore.see(alert)

    forward, link = setup.run.forward, setup.run.mavlink
    codec = MavlinkCodec(link.system_id, link.component_id, target_system=link.autopilot_system_id, signing=signing)
    guard = None if args.unchecked else StartInterlock(codec, companion_of(setup))
    if not guard:
        tell(Alert(t_ns=clock.now_ns(), level="warning", text=UNCHECKED))
    gate = GcsFirewall(link.system_id) if forward and forward.writable else None
    app = App(
        Pilot(setup.pilot),
        _controller(setup, tell),
        mavlink=(mavlink, codec),
        devices=devices,
        clock=clock,
        recorder=recorder,
        rng=random.Random(),
        watch=watch,
        forward=GcsForward(station, gate, clock, codec.encoder.statustext) if station else None,
        vision_hz=setup.run.vision.rate_Hz if setup.run.vision else None,
        guard=guard,
    )
    call_when_asked_to_end(asyncio.get_running_loop(), end)
    if args.start:
        app.command(OperatorCommand(t_ns=clock.now_ns(), command=_order(args)), SWITCH_ON_S)
    _hurry()
    gc.collect()
    gc.freeze()  # what has been built so far stays: later collections need not look at it
    chores = [asyncio.create_task(keep_within(look, clock, tell))] if look else []
    if signing:
        stamps = recorder.path.parent / STAMP_FILE
        chores.append(asyncio.create_task(keep_timestamp(stamps, signing, clock, tell)))
    shore.open(app, guard, clock, tell)
    if desk:
        chores.append(asyncio.create_task(desk.run(app, setup, clock, tell, end)))
    try:
        await app.run()
    finally:
        for chore in chores:
            chore.cancel()
        ended = await asyncio.gather(*chores, return_exceptions=True)
        shore.close()
        progress.close()
        screen.close()
    for error in ended:
        if isinstance(error, Exception):
            raise error
    return REFUSED if finish.stopped or (args.start and guard and guard.turns_away) else 0


def _order(args: argparse.Namespace) -> Literal["excite", "start"]:
    """By which the run begins by itself."""
    return "excite" if args.excite else "start"


def _controller(setup: RunSetup, tell: Callable[[Alert], None]) -> Nmpc:
    """The controller, with machine code from the cache of the last run if it has any."""

    def say(text: str) -> None:
        tell(Alert(t_ns=time.monotonic_ns(), level="info", text=text))

    pilot = setup.pilot
    nmpc = Nmpc(
        StructuredModel.of(pilot.vessel), Actuation.of(pilot.vessel), pilot.nmpc,
        time.perf_counter, pilot.fence, partial(compile_loops, store=CodeStore.of(tell=say)),
    )  # fmt: skip
    if nmpc.why_not_compiled:
        say(f"the controller runs without machine code: {nmpc.why_not_compiled}")
    return nmpc


def _hurry() -> None:
    """Raise the priority where the system permits it; shorten the thread switch interval."""
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, PRIORITY)
    sys.setswitchinterval(GIL_S)
