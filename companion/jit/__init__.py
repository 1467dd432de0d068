"""Machine code of CasADi expressions: the one model, evaluated at the speed of the processor.

    compile_loops   loops of SX functions over one block of memory (`control.rti.loops`): the NMPC's kernel
    compile_scan    a recurrence over series of any length, in arrays of the caller: trajectories, fits

Inside: `emit` turns an SX function into LLVM's language, `program` strings such functions into loops, `scan` makes one
loop, whose functions of lanes are our own (`lanes`, `operators`, `elementary`); `machine` has llvmlite compile them
(wheels for x86 and aarch64, no compiler needed), `worker` does that in a process of its own, `cache` keeps the code.
Whoever uses this has a way without it: CasADi's interpreter. Nothing in `companion.core` knows it. ADR 23, 24 and 30.
"""

from companion.core.control.rti.loops import NotCompiled
from companion.jit.cache import CodeStore
from companion.jit.machine import compile_loops
from companion.jit.scan import ALONE, LANES, Scan, compile_scan

__all__ = ["ALONE", "LANES", "CodeStore", "NotCompiled", "Scan", "compile_loops", "compile_scan"]
