"""What `aritra provision` does, with MAVSDK: difference, question, writing, reading back; logs."""

from __future__ import annotations

import argparse
import asyncio
import filecmp
import re
import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from companion.boat.load_run import EXAMPLES, RunSetup, load_setup
from companion.boat.signing_key import STAMP_FILE
from companion.cli.analysis import progress_of
from companion.cli.boat.wires import port_of, signing_of
from companion.core.configuration.tables import ConfigError
from companion.core.preflight.parameter_diff import Change, changes, same, unknown
from companion.core.preflight.parameter_file import parse_parameters
from companion.core.preflight.rows import number
from drivers.mavlink.provision.provisioner import Provisioner, ProvisioningError, StoredLog
from drivers.mavlink.signing import Signing
from drivers.ports.port import Port

DONE, FAILED = 0, 1
FOLDER = EXAMPLES / "ardupilot"
SCRIPT = FOLDER / "gate.lua"
SCRIPTS = "/APM/scripts"
"""Where ArduPilot looks for scripts on its SD card."""
UNDATED = "1970"
"""Year of a log whose autopilot had no clock (LOG_ENTRY: time_utc is 0 where it is not known)."""


def provision(args: argparse.Namespace, console: Console | None = None) -> int:
    """Connect and do it; the exit code."""
    setup = load_setup(args.config)
    if args.wiring == "gate":
        _refuse_other_channels(setup)
    port = port_of(args, "mavlink", setup.run.mavlink.url)
    logs = args.config.parent / setup.run.log.folder if setup.run.log.folder else Path()
    signing = None if args.unsigned else signing_of(args, setup, logs / STAMP_FILE)
    console = console or Console()
    try:
        return asyncio.run(_work(args, port, signing, console))
    except ProvisioningError as error:
        print(f"aritra provision: {error}", file=sys.stderr)
        return FAILED
    except OSError as error:
        print(f"aritra provision: {error.filename}: {error.strerror}", file=sys.stderr)
        return FAILED


def _refuse_other_channels(setup: RunSetup) -> None:
    """Raise ConfigError where the gate's script passes other channels than the boat's, or in another order."""
    lists = re.search(r"^local CHANNELS = \{([\d, ]+)\}", SCRIPT.read_text(encoding="utf-8"), re.MULTILINE)
    passed = [int(channel) for channel in lists[1].split(",")] if lists else []
    ours = [one.channel for one in setup.pilot.vessel.controls]
    if ours != passed[: len(ours)]:
        names = f"{SCRIPT.name} passes channels {' '.join(map(str, passed))} to Script1-{len(passed)}"
        boat = f"thrusters and servos of {setup.pilot.vessel.name} are on {' '.join(map(str, ours))}, in this order"
        todo = "change its two lists, copy it to APM/scripts by hand, and load gate.param with your outputs"
        raise ConfigError(f"--wiring gate: {names}, but {boat}: {todo}; or change the channels of the vessel file")


async def _work(args: argparse.Namespace, port: Port, signing: Signing | None, console: Console) -> int:
    console.print(f"waiting for the autopilot on {port.name}{', signed' if signing else ''}", highlight=False)
    async with Provisioner.connect(port, signing=signing) as autopilot:
        if args.logs:
            return await _fetch_logs(args, autopilot, console)
        return await _wire(args, autopilot, console)


# --- a wiring --------------------------------------------------------------------------------------


async def _wire(args: argparse.Namespace, autopilot: Provisioner, console: Console) -> int:
    name = f"{args.wiring}.param"
    wanted = parse_parameters((FOLDER / name).read_text(encoding="utf-8"), name=name)
    console.print("reading the autopilot's parameters")
    stored = await autopilot.parameters()
    differences = changes(stored, wanted)
    if missing := unknown(differences):
        raise ProvisioningError(f"the autopilot does not have {', '.join(missing)}: is it ArduPilot Rover 4.6 or 4.7?")
    unchanged = Text(f"all {len(wanted)} parameters are as {name} has them")
    console.print(_difference(differences) if differences else unchanged)
    script = args.wiring == "gate"
    if args.dry_run:
        console.print(Text("dry run: nothing was changed"))
        return DONE
    if differences or script:
        await _refuse_armed(autopilot)
        if not args.yes and not _agreed(console, differences, script):
            return FAILED
        await _refuse_armed(autopilot)  # somebody may have armed it while the table was read
    if failed := await _write(autopilot, differences, console):
        console.print(Text(f"NOT DONE: {', '.join(failed)}; run it again", style="bold red"))
        return FAILED
    if script and not await _upload(autopilot, console):
        return FAILED
    await _end(autopilot, differences, script, args.reboot, console)
    return DONE


async def _refuse_armed(autopilot: Provisioner) -> None:
    if await autopilot.armed():
        raise ProvisioningError("the autopilot is armed: nothing was changed; disarm it first")


def _difference(differences: list[Change]) -> Table:
    table = Table(box=None, pad_edge=False)
    for head in ("parameter", "now", "will be", ""):
        table.add_column(head, justify="left" if head in ("parameter", "") else "right")
    for c in differences:
        table.add_row(
            c.name, number(c.found), Text(number(c.wanted), style="bold"), "after a reboot" if c.reboot else ""
        )
    return table


def _agreed(console: Console, differences: list[Change], script: bool) -> bool:
    """Ask the user; without a terminal the answer is no."""
    what = " and ".join([f"{len(differences)} parameters"] * bool(differences) + ["gate.lua"] * script)
    try:
        answer = console.input(f"write {what} to the autopilot? (y/N) ")
    except EOFError:
        answer = ""
    if answer.strip().lower() in ("y", "yes"):
        return True
    console.print("nothing was changed")
    return False


async def _write(autopilot: Provisioner, differences: list[Change], console: Console) -> list[str]:
    """Write and read back; names of those that do not read back as wanted."""
    failed, written = [], 0
    for c in differences:
        try:
            now = await autopilot.write(c.name, c.wanted)
        except ProvisioningError as error:
            console.print(Text(f"{error}", style="red"))
            failed.append(c.name)
            break  # it has fallen silent
        if not same(now, c.wanted):
            console.print(Text(f"{c.name}: is {number(now)} after writing {number(c.wanted)}", style="red"))
            failed.append(c.name)
            continue
        written += 1
    if differences:
        console.print(f"wrote and read back {written} of {len(differences)} parameters")
    return failed


async def _upload(autopilot: Provisioner, console: Console) -> bool:
    try:
        await autopilot.upload(SCRIPT, SCRIPTS)
    except ProvisioningError as error:
        console.print(Text(f"the script could not be sent: {error}", style="yellow"))
        console.print(
            Text(f"by hand: copy {SCRIPT} to {SCRIPTS[1:]}/ on the autopilot's SD card. Without it nothing moves."),
            soft_wrap=True,
        )
        console.print(
            Text("NOT DONE, and not restarted: REBOOT the autopilot once the script is there", style="bold red")
        )
        return False
    console.print(f"gate.lua is in {SCRIPTS} and reads back the same")
    return True


async def _end(autopilot: Provisioner, differences: list[Change], script: bool, reboot: bool, console: Console) -> None:
    late = [c.name for c in differences if c.reboot]
    if reboot and (late or script):
        await _refuse_armed(autopilot)
        await autopilot.reboot()
        console.print("the autopilot restarts; then: aritra check", highlight=False)
    elif late or script:
        what = ", ".join([*late, *["gate.lua"] * script])
        console.print(Text(f"REBOOT the autopilot now, for: {what}; then: aritra check", style="bold"))
    else:
        console.print("then: aritra check")


# --- logs ------------------------------------------------------------------------------------------


async def _fetch_logs(args: argparse.Namespace, autopilot: Provisioner, console: Console) -> int:
    logs = await autopilot.logs()
    console.print(f"{len(logs)} logs, {sum(log.size_bytes for log in logs) / 1e6:.1f} MB")
    if args.dry_run:
        for log in logs:
            console.print(Text(f"{log.number:5d}  {log.date}  {log.size_bytes / 1e6:8.2f} MB"))
        return DONE
    await _refuse_armed(autopilot)
    args.logs.mkdir(parents=True, exist_ok=True)
    with progress_of(console) as progress:
        for log in logs:
            await _fetch(autopilot, log, args.logs, progress)
    return DONE


async def _fetch(autopilot: Provisioner, log: StoredLog, folder: Path, progress) -> None:
    path = folder / file_name(log)
    task = progress.add_task(f"log {log.number}", total=1.0, what=path.name)
    is_same = path.exists() and path.stat().st_size == log.size_bytes and not log.date.startswith(UNDATED)
    if not is_same:
        part = path.with_suffix(".part")
        part.unlink(missing_ok=True)
        await autopilot.download(log, part, lambda share: progress.update(task, completed=share))
        while path.exists() and not (is_same := filecmp.cmp(part, path, shallow=False)):
            path = next_name(path)
        part.replace(path)  # onto itself, where it is the same
    progress.update(task, completed=1.0, what=f"{path.name}{' is there already' if is_same else ''}")


def next_name(path: Path) -> Path:
    """`log-0007-DATE.bin`, then `-2`, `-3`: another log of the same number and date."""
    stem, number = re.findall(r"(.*?Z)(?:-(\d+))?$", path.stem)[0]
    return path.with_stem(f"{stem}-{int(number or 1) + 1}")


def file_name(log: StoredLog) -> str:
    """`log-0007-2026-01-01T000000Z.bin`: number and the autopilot's date; see `next_name` for one without a clock."""
    return f"log-{log.number:04d}-{log.date.replace(':', '')}.bin"
