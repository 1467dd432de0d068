"""Waiting for a firmware's script thread, as Linux tells of it in /proc."""

from __future__ import annotations

import os
import shutil
import sys
import threading
import time
from pathlib import Path

import pytest

from tests.support.autopilots import script_thread
from tests.support.autopilots.script_thread import NAME, ScriptThread

PID, FOREVER_S = 7, 60.0


class Firmware:
    """A process as /proc shows it: its main thread, and the scripts' where it has one."""

    def __init__(self, proc: Path):
        self.proc, self.slept = proc, 5
        self.thread(PID, "ardurover", 100)

    def thread(self, tid: int, name: str, slept: int) -> None:
        folder = self.proc / str(PID) / "task" / str(tid)
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "comm").write_text(f"{name}\n", encoding="utf-8")
        status = f"Name:\t{name}\nState:\tS (sleeping)\nvoluntary_ctxt_switches:\t{slept}\n"
        new = folder / "new"
        new.write_text(f"{status}nonvoluntary_ctxt_switches:\t{slept + 40}\n", encoding="utf-8")
        new.replace(folder / "status")

    def script_runs(self, tid: int = PID + 1) -> None:
        self.slept += 1
        self.thread(tid, NAME, self.slept)


@pytest.fixture
def firmware(tmp_path):
    return Firmware(tmp_path)


def test_each_step_waits_until_the_script_has_had_its_turn(firmware, monkeypatch):
    monkeypatch.setattr(script_thread, "LIMIT_S", FOREVER_S)
    firmware.script_runs()
    waiting = ScriptThread(PID, firmware.proc)
    waiting.wait_for_turn()
    for turn in range(1, 4):
        threading.Timer(0.05, firmware.script_runs).start()
        waiting.wait_for_turn()
        assert firmware.slept == 6 + turn


def test_a_script_that_waits_for_the_main_loop_stops_nothing(firmware, monkeypatch):
    monkeypatch.setattr(script_thread, "LIMIT_S", 0.02)
    firmware.script_runs()
    waiting, began_s = ScriptThread(PID, firmware.proc), time.monotonic()
    for _ in range(3):
        waiting.wait_for_turn()
    assert time.monotonic() - began_s >= 2 * 0.02, "each but the first has waited, and gone on"


def test_one_without_scripts_or_that_starts_again_is_not_waited_for(firmware, monkeypatch):
    monkeypatch.setattr(script_thread, "LIMIT_S", FOREVER_S)
    began_s = time.monotonic()
    waiting = ScriptThread(PID, firmware.proc)
    waiting.wait_for_turn()
    firmware.script_runs()
    waiting.wait_for_turn()
    shutil.rmtree(firmware.proc / str(PID) / "task" / str(PID + 1))
    waiting.wait_for_turn()
    waiting.wait_for_turn()
    firmware.script_runs(tid=PID + 2)
    waiting.wait_for_turn()
    assert time.monotonic() - began_s < FOREVER_S


@pytest.mark.skipif(sys.platform != "linux", reason="Linux alone tells how often a thread has slept")
def test_linux_tells_of_a_thread_by_that_name(monkeypatch):
    monkeypatch.setattr(script_thread, "LIMIT_S", 0.3)
    named, end = threading.Event(), threading.Event()

    def scripts() -> None:
        Path(f"/proc/self/task/{threading.get_native_id()}/comm").write_text(NAME, encoding="utf-8")
        named.set()
        end.wait()

    thread = threading.Thread(target=scripts)
    thread.start()
    named.wait()
    waiting, waits_s = ScriptThread(os.getpid()), []
    for _ in range(5):
        began_s = time.monotonic()
        waiting.wait_for_turn()
        waits_s.append(time.monotonic() - began_s)
    end.set()
    thread.join()
    assert waits_s[-1] >= 0.3, "it is seen, and it does not run"
