"""Machine code by a child: as it would be made here; whatever goes wrong with the child, it is made all the same."""

import hashlib
import time

import casadi as ca
import numpy as np
import pytest

from companion.core.control.rti.loops import Kernel, Loop, Operand
from companion.jit import CodeStore, compile_loops, machine
from companion.jit.worker import ChildFailed, compiled_in_child
from companion.python_child import python

pytest.importorskip("llvmlite", reason="llvmlite is not installed")
if not machine.may_run_what_was_written():
    pytest.skip("the system forbids machine code", allow_module_level=True)

TEXT = "define void @nothing(ptr %memory) {\n  ret void\n}\n"


def child(code: str) -> list[str]:
    return python("-c", f"import sys; sys.stdin.read(); {code}")


FAILING = {
    "ends with an error": (child("sys.exit('out of memory')"), "exit code 1: out of memory"),
    "is killed": (child("import os; os.kill(os.getpid(), 9)"), "exit code -9"),
    "hangs": (child("import time; time.sleep(60)"), "no answer within 2 s"),
    "says nothing": (child("pass"), "answered 0 bytes"),
    "says nonsense": (child("print('x' * 100)"), "answered 101 bytes"),
    "sends the digest of nothing": (
        child(f"sys.stdout.buffer.write({hashlib.sha256(b'').digest()!r})"), "answered 32 bytes"),
    "is cut short": (
        child(f"sys.stdout.buffer.write({hashlib.sha256(b'code').digest() + b'cod'!r})"), "answered 35 bytes"),
    "is not there": (("/nowhere/python",), "No such file"),
    "does not read": (python("-c", "import sys; sys.exit(3)"), "exit code 3"),
}  # fmt: skip


def test_the_child_makes_the_code_that_this_process_would_make():
    assert compiled_in_child(TEXT) == machine.object_code(TEXT)


def test_text_that_is_no_module_is_told():
    with pytest.raises(ChildFailed, match="exit code 1"):
        compiled_in_child("no module")


@pytest.mark.parametrize("name", FAILING)
def test_a_child_that_fails_is_told_in_bounded_time(name):
    command, why = FAILING[name]
    began = time.monotonic()
    with pytest.raises(ChildFailed, match=why):
        compiled_in_child(TEXT * 4000, command, limit_s=2.0)
    assert time.monotonic() - began < 20.0


def test_where_the_child_fails_the_code_is_made_here_and_somebody_hears_of_it(tmp_path):
    def fails(text: str) -> bytes:
        raise ChildFailed("no memory left")

    heard: list[str] = []
    store = CodeStore(tmp_path, fails, heard.append)
    memory, a = np.array([1.0]), ca.SX.sym("a")
    kernel = Kernel(ca.Function("f", [a], [2 * a]), [Operand(0, 0, (0,))], [Operand(0, 0, (0,))])
    entries = {"go": [Loop([kernel], 1)]}
    compile_loops(entries, memory, store)["go"]()
    assert memory[0] == 2.0
    assert len(heard) == 1 and "no memory left" in heard[0]
    compile_loops(entries, memory, store)["go"]()
    assert memory[0] == 4.0 and len(heard) == 1, "kept: no second try"


def test_with_a_child_nothing_is_compiled_here(tmp_path, monkeypatch):
    monkeypatch.setattr("llvmlite.binding.create_pass_builder", lambda *_: pytest.fail("compiled in this process"))
    memory, a = np.array([1.0]), ca.SX.sym("a")
    kernel = Kernel(ca.Function("f", [a], [a + 2]), [Operand(0, 0, (0,))], [Operand(0, 0, (0,))])
    compile_loops({"go": [Loop([kernel], 1)]}, memory, CodeStore(tmp_path))["go"]()
    assert memory[0] == 3.0
