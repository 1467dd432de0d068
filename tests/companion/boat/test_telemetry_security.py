"""The configuration files in deploy/zenoh, as they are, with certificates from its script: who may see and command."""

import subprocess
import time
from contextlib import contextmanager

import msgspec
import pytest
import zenoh

from companion.boat.load_run import EXAMPLES
from companion.boat.uplink.telemetry import Telemetry, config_of
from companion.core.configuration.run_file import TelemetryLink
from companion.core.messages import Alert
from companion.core.telemetry import structs as shore
from companion.core.telemetry.order_gate import OrderOutcome
from companion.core.telemetry.view import TelemetryView, Who
from tests.support.drive_fixture import setup
from tests.support.zenoh_fixture import Console, config, free_port, wait_for

ZENOH = EXAMPLES / "zenoh"
ANSWER = OrderOutcome(run="run", t_ns=1, status="done", code="ok", text="")


@pytest.fixture(scope="module")
def pki(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pki")
    names = ["aritra", "anna", "watch", "stranger"]
    made = subprocess.run(
        [ZENOH / "make-certificates", folder, "127.0.0.1", *names], check=True, capture_output=True, text=True
    )
    assert len(made.stdout.split()) == 5
    for name in [*names, "router", "ca"]:
        assert (folder / f"{name}.key").stat().st_mode & 0o077 == 0
    again = subprocess.run([ZENOH / "make-certificates", folder, "127.0.0.1", "bob"], check=True, capture_output=True)
    assert again.stdout.decode().split() == [f"{folder}/bob.pem"], "what is there stays"
    for file in ("boat", "shore", "router"):
        text = (ZENOH / f"{file}.json5").read_text()
        for name in ("/etc/aritra/zenoh", "pki"):
            text = text.replace(f'"{name}/', f'"{folder}/')
        (folder / f"{file}.json5").write_text(text.replace("boat.pem", "aritra.pem").replace("boat.key", "aritra.key"))
    return folder


@contextmanager
def boat(pki, port):
    link = TelemetryLink(connect=(f"tls/127.0.0.1:{port}",), config="boat.json5")
    view, told = TelemetryView(setup().pilot, Who("run", "digest", "aritra 0", 0, True), 10.0), []
    made = Telemetry("aritra", link, config_of(link, pki, where="run.toml"), view)

    def answer(query):
        with query:
            query.reply(shore.command_key("aritra"), msgspec.json.encode(ANSWER))

    made.moved = []
    made.start(told.append, tuple, answer, steer=lambda sample: made.moved.append(bytes(sample.payload)))
    try:
        wait_for(lambda: any("is connected" in a.text for a in told), what=lambda: told)
        yield made
    finally:
        made.close()


@contextmanager
def person(pki, port, name):
    text = (pki / "shore.json5").read_text().replace("/anna.", f"/{name}.")
    (pki / f"{name}.json5").write_text(text)
    made = config("client", connect=[f"tls/127.0.0.1:{port}"], file=pki / f"{name}.json5")
    with zenoh.open(made) as session:
        yield Console(session)


def texts(console):
    return [told.text for told in console.of("alert")]


def say(console, text):
    told = shore.AlertTold(run="run", t_ns=time.monotonic_ns(), level="info", text=text)
    console.session.put(shore.telemetry_key("aritra", "alert"), shore.encode(told))


def command(console):
    replies = console.session.get(shore.command_key("aritra"), payload=b"x", timeout=1.0)
    return [bytes(r.ok.payload) for r in replies if r.ok]


@pytest.mark.long
def test_each_may_do_what_the_router_file_says(pki):
    port = free_port()
    with (
        zenoh.open(config("router", listen=[f"tls/127.0.0.1:{port}"], file=pki / "router.json5")),
        boat(pki, port) as b,
    ):
        b.see(Alert(t_ns=time.monotonic_ns(), level="info", text="history"))
        for name, sees, commands in (("anna", True, True), ("watch", True, False), ("stranger", False, False)):
            with person(pki, port, name) as console:
                if sees:
                    wait_for(lambda c=console: texts(c) == ["history"], what=lambda n=name: n)
                else:
                    time.sleep(1.0)
                    assert not console.heard
                assert bool(console.last_values()) == sees
                assert console.alive() == ({"aritra/aritra/alive"} if sees else set())
                assert bool(command(console)) == commands, name
                for _ in range(5):
                    console.session.put(shore.sticks_key("aritra"), name.encode())
                    time.sleep(0.1)
        assert set(b.moved) == {b"anna"}, "who may command may steer"


def test_only_the_boat_speaks_under_its_name(pki):
    port = free_port()
    with (
        zenoh.open(config("router", listen=[f"tls/127.0.0.1:{port}"], file=pki / "router.json5")),
        person(pki, port, "watch") as witness,
    ):
        for name in ("anna", "watch", "stranger"):
            with person(pki, port, name) as console:
                for _ in range(5):
                    say(console, name)
                    time.sleep(0.1)
        with person(pki, port, "aritra") as console:
            wait_for(lambda: say(console, "aritra") or texts(witness), what=lambda: witness.heard)
        assert set(texts(witness)) == {"aritra"}


@pytest.mark.long
def test_without_a_certificate_of_ours_nobody_comes_in(pki, tmp_path):
    port = free_port()
    subprocess.run([ZENOH / "make-certificates", tmp_path, "127.0.0.1", "anna"], check=True, capture_output=True)
    with zenoh.open(config("router", listen=[f"tls/127.0.0.1:{port}"], file=pki / "router.json5")):
        text = (pki / "shore.json5").read_text()
        (tmp_path / "own.json5").write_text(text.replace(f"{pki}/anna", f"{tmp_path}/anna"))
        with pytest.raises(zenoh.ZError), zenoh.open(
            config("client", connect=[f"tls/127.0.0.1:{port}"], file=tmp_path / "own.json5",
                   **{"connect/timeout_ms": 2000})
        ):  # fmt: skip
            pass
