"""Another boat of our name: told loudly, not at every sample, and whoever says it."""

import time
from contextlib import ExitStack
from pathlib import Path

import pytest
import zenoh

from companion.boat.uplink.name_collision import AGAIN_NS, NameCollisions
from companion.boat.uplink.telemetry import Telemetry, config_of
from companion.core.telemetry import structs as shore
from companion.core.telemetry.view import TelemetryView, Who
from tests.companion.boat.telemetry.telemetry_fixture import link_to
from tests.support.console_fixture import mode
from tests.support.drive_fixture import setup
from tests.support.zenoh_fixture import config, free_port, router, wait_for

S = 1_000_000_000


class Namesakes:
    def __init__(self):
        self.now_ns, self.told = 0, []
        self.names = NameCollisions("b", "run1", lambda: self.now_ns, self.told.append)


def test_it_is_told_at_once_and_again_while_it_lasts():
    at = Namesakes()
    for _ in range(3 * AGAIN_NS // S):
        at.names.meet("run1", "by this boat")
        at.names.meet("run2", "by anna, on shore")
        at.now_ns += S
    assert [a.t_ns for a in at.told] == [0, AGAIN_NS, 2 * AGAIN_NS]
    assert at.told[0].level == "error" and "calls itself b, too (run run2, heard by anna, on shore)" in at.told[0].text


@pytest.mark.parametrize("data", [b"", b"\xff", b"[" * 60_000, b"{}"])
def test_rubbish_is_nobody(data):
    at = Namesakes()
    at.names.hear(data)
    at.names.hear(shore.encode(mode(1)))
    assert not at.told
    at.names.hear(shore.encode(mode(1, run="run2")))
    assert len(at.told) == 1


@pytest.mark.long
def test_a_boat_that_is_a_client_of_a_router_hears_it_itself():
    port, at = free_port(), Namesakes()
    with ExitStack() as held:
        held.enter_context(router(port))
        link = link_to(port, mode="client")
        view = TelemetryView(setup().pilot, Who("run1", "digest", "aritra 0", 0, commands=False), 10.0)
        boat = Telemetry("b", link, config_of(link, Path(), where="run.toml"), view)
        connected = []
        boat.start(connected.append, tuple, hear=at.names.hear)
        held.callback(boat.close)
        other = held.enter_context(zenoh.open(config("client", connect=[f"tcp/127.0.0.1:{port}"])))
        wait_for(lambda: connected)

        def tells():
            other.put(shore.telemetry_key("b", "mode"), shore.encode(mode(1, run="run2")))
            time.sleep(0.05)
            return at.told

        wait_for(tells)
    assert len(at.told) == 1 and "run run2" in at.told[0].text
