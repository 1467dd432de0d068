"""Machine code of CasADi expressions: the one model, evaluated at the speed of the processor.

    compile_loops   loops of SX functions over one block of memory (`control.rti.loops`): the NMPC's kernel
    compile_scan    a recurrence over series of any length, in arrays of the caller: trajectories, fits

`emit` translates an SX function to LLVM's intermediate language, `program` joins such functions to loops, `scan` makes
one loop with its own functions of vectors (`lanes`, `operators`, `elementary`). `machine` compiles the text by llvmlite
(wheels for x86 and aarch64, no compiler needed), `worker` does so in a child process, `cache` keeps the code. Every
caller can use CasADi's interpreter instead. Nothing in `companion.core` depends on it. ADR 23, 24, 30.
"""

from companion.core.control.rti.loops import NotCompiled
from companion.jit.cache import CodeStore
from companion.jit.machine import compile_loops
from companion.jit.scan import ALONE, LANES, Scan, compile_scan

__all__ = ["ALONE", "LANES", "CodeStore", "NotCompiled", "Scan", "compile_loops", "compile_scan"]
