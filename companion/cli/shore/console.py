"""`aritra shore`: see boats and give them orders, in a browser, over zenoh. Docs: docs/shore.md."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import re
import secrets
import socket
import sys
import time
import webbrowser
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import psutil

from companion.cli.boat.terminal_writer import TerminalWriter
from companion.cli.interrupts import call_when_asked_to_end
from companion.cli.options.extras import how_to_install
from companion.cli.options.values import port
from companion.cli.shore.key_files import KeyFiles
from companion.cli.shore.network_options import LOCAL, add_network, sender_name
from companion.core.configuration.tables import ConfigError

if TYPE_CHECKING:
    from companion.shore.console.live import Console
    from companion.shore.foxglove.live import FoxgloveServer

PORT = 8470
EVERYWHERE = {"0.0.0.0": "127.0.0.1", "::": "::1"}
"""`--host` of the whole network -> where this machine finds us then."""
MIN_TOKEN = 8


def add_parser(commands) -> None:
    """Add `shore` to the command line."""
    p = commands.add_parser(
        "shore",
        help="see the boats, and hold, resume or stop them, in a browser",
        description="A local web console fed by zenoh: map, plots, alerts, pre-flight table, orders. Without a command "
        "key it only looks. Serves 127.0.0.1 alone unless --host says otherwise; then a token is needed. Runs until "
        "Ctrl-C. Exit code 2: bad input, or the port is taken.",
        example="aritra shore --command-key out/demo/ --open",
    )
    add_network(p, f"default, where nothing is said: {LOCAL}")
    p.add_argument(
        "--logs", type=Path, metavar="FOLDER", help="list the logs (.mcap) of this folder, to download and open"
    )
    p.add_argument("--host", default="127.0.0.1", help="address to serve; 0.0.0.0: the whole network, with a token")
    p.add_argument("--port", type=port, default=PORT, help="port to serve (%(default)s)")
    p.add_argument("--token", help="the token, instead of a new one each time: an open phone finds back to us")
    p.add_argument("--foxglove", type=port, metavar="PORT", help="also serve Foxglove, on 127.0.0.1: docs/logs.md")
    p.add_argument("--open", action="store_true", help="open the page in a browser")
    p.set_defaults(function=shore)


def shore(args: argparse.Namespace) -> int:
    """Serve until interrupted; the exit code."""
    screen = TerminalWriter(sys.stdout)
    try:
        return asyncio.run(_serve(args, lambda text: screen.write(f"{text}\n")))
    except ImportError as error:
        raise ConfigError(f"{error}; {how_to_install('shore')} brings what the console needs") from None
    finally:
        screen.close()


async def _serve(args: argparse.Namespace, say: Callable[[str], object]) -> int:
    """`say`: takes what is to be said while it serves; neither waits nor raises."""
    from aiohttp import web

    from companion.shore.console.files.logs import ServedLogs
    from companion.shore.console.keys import Keys
    from companion.shore.console.live import Console
    from companion.shore.console.request_auth import RequestAuth, is_loopback
    from companion.shore.console.zenoh_client import ZenohClient, config_of

    local = is_loopback(args.host)
    token = _token(args.token, local)
    files = KeyFiles(args.command_key)
    keys = Keys(files.find if args.command_key else None, sender_name(args))
    listen = args.listen or ([] if args.connect or args.config else [LOCAL])
    config = config_of(args.config, args.connect, listen)
    names = {"localhost", socket.gethostname().lower(), f"{socket.gethostname().lower()}.local", args.host.lower()}
    logs = ServedLogs(args.logs) if args.logs else None
    guard = RequestAuth(frozenset(names), token)
    console = Console(ZenohClient(config), guard, keys, compress=not local, logs=logs, say=say)
    foxglove = _foxglove(console, args.foxglove) if args.foxglove is not None else None
    runner = web.AppRunner(console.app, access_log=None, shutdown_timeout=1.0)
    await runner.setup()
    try:
        server = await console.serve(runner, args.host, args.port)
    except (OSError, OverflowError) as error:
        await runner.cleanup()
        print(f"aritra shore: {args.host}:{args.port}: {error}; another --port?", file=sys.stderr)
        return 2
    port = server.sockets[0].getsockname()[1]
    for line in addresses(args.host, port, token):
        print(line, flush=True)
    print(f"zenoh: {', '.join([*args.connect, *(f'listening on {x}' for x in listen)]) or args.config}", flush=True)
    print("orders: signed with the command key" if keys else "no command key: this console only looks", flush=True)
    for problem in filter(None, map(keys.problem, files.boats)):
        print(problem, flush=True)
    if args.open:
        host: str = args.host
        await asyncio.to_thread(webbrowser.open, _address(EVERYWHERE.get(host, host), port, token))
    if foxglove:
        print(f"Foxglove: ws://127.0.0.1:{foxglove.port}", flush=True)
    try:
        await _until_signal(console.run())
    finally:
        server.close()
        await runner.cleanup()
        if foxglove:
            foxglove.close()
        if logs:
            logs.close()
    return 0


def _foxglove(console: Console, port: int) -> FoxgloveServer:
    """A Foxglove server with the samples of the console. Raises ConfigError."""
    from companion.shore.foxglove.live import FoxgloveServer

    server = FoxgloveServer(port)
    console.also.append(lambda sample: server.see(sample.boat, sample.topic, sample.data, time.time_ns()))
    return server


async def _until_signal(work) -> None:
    """Await `work`; SIGINT, SIGTERM and SIGHUP cancel it in order."""
    task = asyncio.ensure_future(work)
    call_when_asked_to_end(asyncio.get_running_loop(), task.cancel)
    with contextlib.suppress(asyncio.CancelledError):
        await task


def _token(token: str | None, local: bool) -> str | None:
    if token is not None:
        if not re.fullmatch(rf"[A-Za-z0-9_-]{{{MIN_TOKEN},100}}", token):
            raise ConfigError(f"--token: expected {MIN_TOKEN} to 100 letters, digits, _ or -")
        return token
    return None if local else secrets.token_urlsafe(12)


def _address(host: str, port: int, token: str | None) -> str:
    name = f"[{host}]" if ":" in host else host
    return f"http://{name}:{port}/" + (f"?token={token}" if token else "")


def addresses(host: str, port: int, token: str | None) -> list[str]:
    """What is printed of where the console is: every address of this machine, where it serves the network."""
    if host not in EVERYWHERE:
        return [f"console: {_address(host, port, token)}"]
    cards = psutil.net_if_addrs().values()
    family = socket.AF_INET6 if ":" in host else socket.AF_INET  # a server of asyncio's serves one of them
    found = {each.address for card in cards for each in card if each.family is family}
    mine = sorted(each for each in found if not each.startswith(("127.", "::1", "fe80:")))
    return [
        f"console: {_address(EVERYWHERE[host], port, token)}",
        *(f"  from the network: {_address(a, port, token)}" for a in mine),
        "  whoever has this address may give orders; it travels unencrypted: see docs/shore.md",
    ]
