"""Compilers of the other ways, with the face of `companion.jit`, and how to have a way taken."""

from __future__ import annotations

import ctypes
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import lru_cache, partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import casadi as ca
import numpy as np

from companion.core.control.rti import iteration
from companion.core.control.rti.interpreted import InterpretedRti
from companion.core.control.rti.loops import Compiler, Step
from companion.jit import CodeStore, compile_loops, compile_scan, scan
from companion.jit.emit import Body, Value
from companion.jit.lanes import Lanes
from sim.studies.machine_code import program
from sim.studies.machine_code.build import numba_module, shared_library
from sim.studies.machine_code.scan import CScan, NumbaScan
from sim.trajectory.loops import Here, Interpreted

CASADI_C = "CasADi's C"


def _numba(entries: Mapping[str, Sequence[Step]], memory: np.ndarray) -> dict[str, Callable[[], None]]:
    """As `compile_loops`; numba compiles at the first call, on numbers that are thrown away."""
    module, before = numba_module(program.python(entries)), memory.copy()
    run = {name: partial(getattr(module, name), memory) for name in entries}
    for call in run.values():
        call()
    memory[:] = before
    return run


def _c(entries: Mapping[str, Sequence[Step]], memory: np.ndarray) -> dict[str, Callable[[], None]]:
    """As `compile_loops`."""
    library, here = ctypes.CDLL(str(shared_library(program.c(entries)))), ctypes.c_void_p(memory.ctypes.data)
    kind = ctypes.CFUNCTYPE(None, ctypes.c_void_p)
    return {name: partial(kind((name, library)), here) for name in entries}


class CodedRti(InterpretedRti):
    """The interpreter's functions as C code that CasADi generates, loops over stages included."""

    def _called(self, function: ca.Function, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> Callable[[], None]:
        name: Any = function.name()
        generator: Any = ca.CodeGenerator(f"{name}.c")
        generator.add(function)
        with tempfile.TemporaryDirectory() as folder:
            text = Path(generator.generate(f"{folder}/")).read_text(encoding="utf-8")
        return super()._called(ca.external(name, str(shared_library(text))), inputs, outputs)


class CLibrary(Lanes):
    """Lanes with the C library's functions, called for each lane, in place of the emitter's own."""

    def operation(self, op: int, args: Sequence[Value]) -> Value:
        """As `Body`."""
        return Body.operation(self, op, args)


COMPILERS: Mapping[str, Callable[[], Compiler | None]] = {
    "emitter": lambda: partial(compile_loops, store=CodeStore.of()),
    "numba": lambda: _numba,
    "loops in C": lambda: _c,
    CASADI_C: lambda: None,
    "interpreter": lambda: None,
}
"""Ways of the real-time iteration."""


@contextmanager
def taken(way: str) -> Iterator[Compiler | None]:
    """The compiler of a way; while this lasts, what is built without a compiler is built that way, too."""
    with patch.object(iteration, "InterpretedRti", CodedRti if way == CASADI_C else InterpretedRti):
        yield COMPILERS[way]()


def _with_c_library(function: ca.Function) -> Any:
    with patch.object(scan, "Lanes", CLibrary):
        loop = compile_scan(function, Here.of())
        loop._made[scan.LANES] = loop._compiled(scan.LANES)
    return loop


SCANS: Mapping[str, Callable[[ca.Function], Any]] = {
    "emitter": lambda function: compile_scan(function, Here.of()),
    "emitter, C library's functions": _with_c_library,
    "numba": NumbaScan,
    "loops in C": CScan,
    "interpreter": Interpreted,
}
"""Ways of trajectories."""


@lru_cache
def _loop(way: str, serialized: str) -> Any:
    return SCANS[way](ca.Function.deserialize(serialized))


@contextmanager
def scanned(way: str) -> Iterator[None]:
    """While this lasts, `sim.trajectory` takes that way."""
    with patch("sim.trajectory.run.loop", lambda serialized: (_loop(way, serialized), "")):
        yield
