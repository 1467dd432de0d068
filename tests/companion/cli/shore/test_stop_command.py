"""`aritra stop`: boats of zenoh's alone behind the real network; who has the stop, who has not, exit codes."""

import asyncio
import contextlib
import io
import sys
import threading
import time

import pytest

from companion.__main__ import main
from companion.core.telemetry.order_gate import OrderGate
from companion.shore import stop_boats
from tests.companion.command_line import exit_code
from tests.support.console_server_fixture import KEY, Boat, serving, until
from tests.support.zenoh_fixture import free_port, router


@pytest.fixture
def key(tmp_path):
    file = tmp_path / "command.key"
    file.write_bytes(KEY)
    file.chmod(0o600)
    return file


@contextlib.contextmanager
def boats(port, *names, **more):
    there = [Boat(port, name, **more) for name in names]
    try:
        yield there
    finally:
        for boat in there:
            boat.session.close()


def stop(port, key, *words):
    return main(["stop", *words, "--connect", f"tcp/127.0.0.1:{port}", "--command-key", str(key), "--name", "anna"])


def test_all_that_are_in_reach_are_stopped(key, capsys):
    port = free_port()
    with router(port), boats(port, "a", "b") as both:
        assert stop(port, key) == 0
    assert [boat.obeyed for boat in both] == [["stop"], ["stop"]]
    assert {line.split(" after")[0] for line in capsys.readouterr().out.splitlines()} == {"a: stopped", "b: stopped"}


def test_the_named_ones_alone_whatever_their_clock(key, capsys):
    port = free_port()
    with router(port), boats(port, "a", "b", ahead_ns=10**12) as both:
        assert stop(port, key, "b", "b") == 0
    assert [boat.obeyed for boat in both] == [[], ["stop"]]
    assert capsys.readouterr().out.startswith("b: stopped after")


def test_whoever_no_longer_reads_keeps_no_boat_from_its_stop(key, monkeypatch):
    """As `aritra stop | head -1`, a full disk, a lost terminal."""

    class Gone(io.StringIO):
        def write(self, text):
            raise BrokenPipeError

    port = free_port()
    with router(port), boats(port, "a") as (boat,), monkeypatch.context() as patch:
        for stream in ("stdout", "stderr"):
            patch.setattr(sys, stream, Gone())
        assert stop(port, key, "a") == 0
    assert boat.obeyed == ["stop"]


@pytest.mark.long
def test_another_boats_key_stops_nobody(key, capsys, monkeypatch):
    monkeypatch.setitem(stop_boats.PATIENCE_S, "stop", 2.0)
    port = free_port()
    key.write_bytes(bytes(32))
    with router(port), boats(port, "a") as (boat,):
        assert stop(port, key) == 1
    assert boat.obeyed == []
    said = capsys.readouterr().out
    assert said.startswith("a: NOT STOPPED: ") and "is the key the boat's?" in said


def test_a_name_of_which_one_program_has_another_key_is_not_all_stopped(key, capsys):
    port = free_port()
    with router(port), boats(port, "a", "a") as (boat, twin):
        twin.gate = OrderGate("a", "run2", bytes(32))
        assert stop(port, key, "a") == 1
    assert boat.obeyed == ["stop"] and twin.obeyed == []
    said = capsys.readouterr().out
    assert said.startswith("a: PARTLY STOPPED after") and "A program without this key answered" in said


def test_a_boat_that_is_away_keeps_no_other_waiting_and_is_no_success(key, capsys, monkeypatch):
    monkeypatch.setitem(stop_boats.PATIENCE_S, "stop", 1.0)
    port = free_port()
    with router(port), boats(port, "a") as (boat,):
        assert stop(port, key, "a", "away") == 1
    assert boat.obeyed == ["stop"]
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("a: stopped after") and second.startswith("away: NOT STOPPED: no answer in 1 s")


@pytest.mark.parametrize("listens", [True, False])
def test_nobody_there_is_no_success(listens, key, capsys, monkeypatch):
    monkeypatch.setattr(stop_boats, "SEARCH_S", 0.5)
    monkeypatch.setitem(stop_boats.PATIENCE_S, "stop", 0.5)
    port = free_port()
    with router(port) if listens else contextlib.nullcontext():
        assert stop(port, key) == 1
    said = capsys.readouterr().err
    assert f"tcp/127.0.0.1:{port}" in said and "no stop was sent" in said


@pytest.mark.long
def test_in_the_consoles_place_boats_are_awaited_that_connect_later(key, capsys, monkeypatch):
    port, codes = free_port(), []
    monkeypatch.setattr("companion.cli.shore.stop.LOCAL", f"tcp/127.0.0.1:{port}")
    monkeypatch.setattr(stop_boats, "SEARCH_S", 4.0)
    with boats(port, "a") as (boat,):  # tries to connect until somebody listens
        thread = threading.Thread(target=lambda: codes.append(main(["stop", "--command-key", str(key)])))
        thread.start()
        while not boat.obeyed and thread.is_alive():
            time.sleep(0.02)
        time.sleep(1.5)
        with boats(port, "late") as (late,):
            thread.join(20.0)
    assert codes == [0] and boat.obeyed == late.obeyed == ["stop"]
    assert [line.split(":")[0] for line in capsys.readouterr().out.splitlines()] == ["a", "late"]


@pytest.mark.long
def test_without_an_endpoint_it_goes_through_the_console_of_this_computer(key, capsys, monkeypatch):
    async def play():
        async with serving() as desk:
            monkeypatch.setattr("companion.cli.shore.stop.LOCAL", f"tcp/127.0.0.1:{desk.zenoh}")
            with boats(desk.zenoh, "a", "b") as both:
                await until(lambda: len(desk.console.store.boats) == 2)
                assert await asyncio.to_thread(main, ["stop", "--command-key", str(key)]) == 0
                return [boat.obeyed for boat in both]

    assert asyncio.run(play()) == [["stop"], ["stop"]]


def test_what_a_session_dies_of_is_not_hidden(key, monkeypatch):
    def broken(*_args, **_more):
        raise RuntimeError("a bug")

    monkeypatch.setattr("companion.shore.subscriber.listen", broken)
    port = free_port()
    with router(port), pytest.raises(RuntimeError, match="a bug"):
        stop(port, key)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ((), "--command-key is missing"),
        (("--command-key", "/nowhere.key"), "--command-key: /nowhere.key"),
        (
            ("anna", "--command-key", "/", "--connect", "tcp/192.168.1.20"),
            "--connect: tcp/192.168.1.20: expected HOST",
        ),
        (("a/b",), "'a/b': expected a boat's name"),
        (("--name", "a\nb", "--command-key", "/"), "--name"),
    ],
)
def test_bad_input_is_named(words, says, capsys):
    assert exit_code("stop", *words) == 2
    assert says in capsys.readouterr().err
