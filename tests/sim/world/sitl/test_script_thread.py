"""Waiting for a firmware's script thread: a thread of this process with its name stands for it."""

from __future__ import annotations

import os
import sys
import threading
from pathlib import Path

import pytest

from sim.world.sitl import script_thread
from sim.world.sitl.script_thread import NAME, ScriptThread

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="Linux alone tells how often a thread has slept")


class Script:
    """A thread by that name. Each `go` lets it work once; `worked`: how often it has."""

    def __init__(self):
        self.worked, self._go, self._named, self.ended = 0, threading.Semaphore(0), threading.Event(), False
        self._thread = threading.Thread(target=self._run)
        self._thread.start()
        self._named.wait()

    def _run(self) -> None:
        Path(f"/proc/self/task/{threading.get_native_id()}/comm").write_text(NAME)
        self._named.set()
        while self._go.acquire() and not self.ended:
            self.worked += 1

    def go(self) -> None:
        self._go.release()

    def end(self) -> None:
        self.ended = True
        self._go.release()
        self._thread.join()


@pytest.fixture
def script():
    made = Script()
    yield made
    made.end()


def test_each_step_waits_until_the_script_has_had_its_turn(script, monkeypatch):
    monkeypatch.setattr(script_thread, "LIMIT_S", 60.0)
    waiting = ScriptThread(os.getpid())
    waiting.wait_for_turn()
    for turn in range(1, 6):
        threading.Timer(0.05, script.go).start()
        waiting.wait_for_turn()
        assert script.worked == turn


def test_a_script_that_waits_for_the_main_loop_stops_nothing(script, monkeypatch):
    monkeypatch.setattr(script_thread, "LIMIT_S", 0.02)
    waiting = ScriptThread(os.getpid())
    for _ in range(3):
        waiting.wait_for_turn()
    assert script.worked == 0


def test_a_firmware_without_scripts_is_not_waited_for(monkeypatch):
    monkeypatch.setattr(script_thread, "LIMIT_S", 1e9)
    waiting, ended = ScriptThread(os.getpid()), Script()
    waiting.wait_for_turn()
    ended.end()
    for _ in range(3):
        waiting.wait_for_turn()
