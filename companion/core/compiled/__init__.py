"""CasADi expressions as machine code: the one model, evaluated at the speed of the processor.

`emit` turns an SX function into LLVM's intermediate language, `program` strings such functions into loops over one
block of memory, `machine` compiles them with llvmlite (wheels for x86 and aarch64, no compiler needed) and keeps the
object code. Whoever uses this has a way without it: CasADi's own interpreter. ADR 23.
"""

from companion.core.compiled.machine import Machine, NotCompiled, Store
from companion.core.compiled.program import Kernel, Loop, Operand, Repeat

__all__ = ["Kernel", "Loop", "Machine", "NotCompiled", "Operand", "Repeat", "Store"]
