"""`aritra stop`: boats of zenoh's alone behind the real network; who has the stop, who has not, exit codes."""

import contextlib
import threading

import pytest

from companion.__main__ import main
from companion.shore import stop_boats
from tests.companion.command_line import exit_code
from tests.support.console_server_fixture import KEY, Boat
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


def test_another_boats_key_stops_nobody_and_is_told(key, capsys, monkeypatch):
    monkeypatch.setitem(stop_boats.PATIENCE_S, "stop", 2.0)
    port = free_port()
    key.write_bytes(bytes(32))
    with router(port), boats(port, "a") as (boat,):
        assert stop(port, key) == 1
    assert boat.obeyed == []
    said = capsys.readouterr().out
    assert said.startswith("a: NOT STOPPED: ") and "is the key the boat's?" in said


def test_a_boat_that_is_away_is_told_as_not_stopped(key, capsys, monkeypatch):
    monkeypatch.setitem(stop_boats.PATIENCE_S, "stop", 1.0)
    port = free_port()
    with router(port), boats(port, "a") as (boat,):
        assert stop(port, key, "a", "away") == 1
    assert boat.obeyed == ["stop"]
    told = dict(line.split(": ", 1) for line in capsys.readouterr().out.splitlines())
    assert told["a"].startswith("stopped") and told["away"].startswith("NOT STOPPED: no answer in 1 s")


@pytest.mark.parametrize("listens", [True, False])
def test_nobody_there_is_no_success(listens, key, capsys, monkeypatch):
    monkeypatch.setattr(stop_boats, "SEARCH_S", 0.5)
    monkeypatch.setitem(stop_boats.PATIENCE_S, "stop", 0.5)
    port = free_port()
    with router(port) if listens else contextlib.nullcontext():
        assert stop(port, key) == 1
    said = capsys.readouterr().err
    assert f"tcp/127.0.0.1:{port}" in said and "no stop was sent" in said


def test_without_an_endpoint_it_listens_where_the_console_would(key, capsys, monkeypatch):
    port = free_port()
    monkeypatch.setattr("companion.cli.shore.stop.LOCAL", f"tcp/127.0.0.1:{port}")
    codes = []
    with boats(port, "a") as (boat,):  # tries to connect until somebody listens
        thread = threading.Thread(target=lambda: codes.append(main(["stop", "--command-key", str(key)])))
        thread.start()
        thread.join(20.0)
    assert codes == [0] and boat.obeyed == ["stop"]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ((), "--command-key is missing"),
        (("--command-key", "/nowhere.key"), "--command-key: /nowhere.key"),
        (("a/b",), "'a/b': expected a boat's name"),
        (("--name", "a\nb", "--command-key", "/"), "--name"),
    ],
)
def test_bad_input_is_named(words, says, capsys):
    assert exit_code("stop", *words) == 2
    assert says in capsys.readouterr().err
