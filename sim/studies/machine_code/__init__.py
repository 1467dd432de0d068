"""Ways from CasADi expressions to machine code, measured on the same problems. `python -m sim.studies.machine_code`

    emitter       the project's own (`companion.jit`): LLVM's language, lanes written out, compiled by llvmlite
    numba         the same kernels and loops as Python source for numba
    loops in C    the same kernels and loops as C source, by gcc
    CasADi's C    C code that CasADi generates of the interpreter's functions, by gcc, called as the interpreter does
    interpreter   CasADi's own: no machine code

The decision and the table: ADR 30.
"""
