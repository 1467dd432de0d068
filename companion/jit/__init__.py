"""CasADi expressions as machine code: the one model, evaluated at the speed of the processor.

`emit` turns an SX function into LLVM's intermediate language, `program` strings such functions into loops over one
block of memory, `machine` compiles them with llvmlite (wheels for x86 and aarch64, no compiler needed) and keeps the
object code. `scan` is a loop of another kind: a recurrence over series of any length, in arrays of the caller, with
functions of lanes of its own (`lanes`, `elementary`). Whoever uses this has a way without it: CasADi's own interpreter.
ADR 23 and 24.
"""

from companion.jit.machine import Machine, NotCompiled, Store
from companion.jit.program import Fetch, Kernel, Loop, Operand, Repeat
from companion.jit.scan import Scan

__all__ = ["Fetch", "Kernel", "Loop", "Machine", "NotCompiled", "Operand", "Repeat", "Scan", "Store"]
