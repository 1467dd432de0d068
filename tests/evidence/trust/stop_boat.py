"""A boat that drives, with its uplink: the real App, gate and telemetry, `python -m ... ZENOH_PORT`.

The App stands on the stepped clock, which is moved on as real time passes, the simulated world at the far end of its
cables. It tells of every change between neutral and thrust on the wire: `still T` or `moving T` (T: monotonic [ns]).
Input: `drive` (answered by `moving T`), `counts` (by numbers); its end ends the boat.
"""

from __future__ import annotations

import asyncio
import gc
import sys
import tempfile
import threading
import time
from pathlib import Path

from companion.boat.uplink.name_collision import NameCollisions
from companion.boat.uplink.order_receiver import ShoreCommands
from companion.boat.uplink.telemetry import Telemetry, config_of
from companion.cli.boat.run import GIL_S
from companion.core.configuration.run_file import TelemetryLink
from companion.core.messages import Alert, NewMission, OperatorCommand
from companion.core.telemetry.order_gate import OrderGate
from companion.core.telemetry.topics import points_of
from companion.core.telemetry.view import TelemetryView, Who
from sim.world.world import STEP_NS
from tests.companion.boat.app_fixture import Bench, neutral
from tests.evidence.trust.stop_attacks import BOAT, KEY, RUN
from tests.support.drive_fixture import setup


def main(port: str) -> None:
    """Play until the input ends."""
    sys.setswitchinterval(GIL_S)  # as a run has it
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder) / "run.mcap", begin_ns=time.monotonic_ns())
        assert bench.scene(lambda bench: _play(bench, int(port))) is None


async def _play(bench: Bench, port: int) -> None:
    link = TelemetryLink(connect=(f"tcp/127.0.0.1:{port}",), commands=True)
    view = TelemetryView(setup().pilot, Who(RUN, "digest", "aritra 0", 0, commands=True), link.rate_Hz)
    telemetry, alerts = Telemetry(BOAT, link, config_of(link, Path(), where="evidence"), view), list[Alert]()
    names = NameCollisions(BOAT, RUN, bench.clock.now_ns, alerts.append)
    ear = ShoreCommands(bench.app, setup().pilot, OrderGate(BOAT, RUN, KEY), bench.clock, alerts.append, names.meet)
    telemetry.start(alerts.append, tuple, ear, names.hear)
    bench.on_watch = telemetry.see
    loop, ended = asyncio.get_running_loop(), asyncio.Event()

    def obey(word: str) -> None:
        if word == "drive":
            now, mission = bench.clock.now_ns(), setup().pilot.mission
            bench.app.load(NewMission(t_ns=now, name="square", waypoints=points_of(mission), end_heading_rad=None))
            bench.app.command(OperatorCommand(t_ns=now, command="start"))
        else:
            collisions = sum("calls itself" in a.text and a.level == "error" for a in alerts)
            print("counts", ear.refused["unsigned"], collisions, flush=True)

    def read() -> None:
        for line in sys.stdin:
            loop.call_soon_threadsafe(obey, line.strip())
        loop.call_soon_threadsafe(ended.set)

    threading.Thread(target=read, daemon=True).start()
    gc.collect()
    gc.freeze()
    pacing = asyncio.create_task(_pace(bench))
    await ended.wait()
    pacing.cancel()
    await asyncio.gather(pacing, return_exceptions=True)
    bench.on_watch = None
    telemetry.close()
    ear.close()


async def _pace(bench: Bench) -> None:
    """The stepped clock goes as the real one does; what changes on the wire is told."""
    told = None
    while True:
        if time.monotonic_ns() - bench.clock.now_ns() < STEP_NS:
            await asyncio.sleep(0.001)
            continue
        await bench.run(STEP_NS * 1e-9)
        sent = [m for _, m in bench.sent if m.get_type() == "RC_CHANNELS_OVERRIDE"]
        bench.sent.clear()
        bench.seen.clear()
        for m in sent:
            now = "still" if neutral(tuple(getattr(m, f"chan{n}_raw") for n in range(1, 13))) else "moving"
            if now != told:
                told = now
                print(now, time.monotonic_ns(), flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
