"""Functions from a module's text, with a store of object code, so that a text is compiled once.

llvmlite is a wheel (x86-64 and aarch64) that contains LLVM. `NotCompiled` where it is absent, or where the system
forbids to execute memory that was written (`MemoryDenyWriteExecute` of a service); the caller then takes CasADi's
interpreter.
"""

from __future__ import annotations

import ctypes
import hashlib
import importlib
import mmap
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from companion.core.control.rti.loops import NotCompiled, Step
from companion.jit.cache import CodeStore
from companion.jit.program import module


class Code:
    """Machine code of one module's text, compiled or taken from `store`. Raises NotCompiled."""

    def __init__(self, text: str, store: CodeStore | None = None):
        llvm = _llvm()
        target = _target(llvm)
        key = _key(llvm, target, text)
        code = store.get(key) if store is not None else None
        if code is None:
            code = (store.made(text) if store is not None else None) or _compiled(llvm, target, text)
            if store is not None:
                store.put(key, code)
        backing = llvm.parse_assembly("")
        backing.triple = target.triple
        self._engine = llvm.create_mcjit_compiler(backing, target)
        self._engine.add_object_file(llvm.ObjectFileRef.from_data(code))
        self._engine.finalize_object()

    def address(self, name: str) -> int:
        """Address of a function; valid while this object lives."""
        return self._engine.get_function_address(name)


def compile_loops(
    entries: Mapping[str, Sequence[Step]], memory: np.ndarray, store: CodeStore | None = None
) -> dict[str, Callable[[], None]]:
    """A function for each entry that runs its loops over `memory`: doubles, contiguous. Raises NotCompiled.

    `store` keeps the code between runs. A function allocates nothing and raises nothing; it keeps a reference to code
    and memory.
    """
    code = Code(module(entries), store)
    pointer = ctypes.c_void_p(memory.ctypes.data)

    def bound(name: str) -> Callable[[], None]:
        function = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(code.address(name))
        function.kept = code, memory  # type: ignore[attr-defined] - ctypes functions take any
        return partial(function, pointer)

    return {name: bound(name) for name in entries}


def _llvm() -> Any:
    """llvmlite's binding, ready. Raises NotCompiled."""
    try:
        llvm = importlib.import_module("llvmlite.binding")
    except ImportError as error:
        raise NotCompiled(f"llvmlite is not installed: {error}") from None
    if not may_run_what_was_written():
        raise NotCompiled("the system forbids to run code that was written to memory (MemoryDenyWriteExecute)")
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm


def object_code(text: str) -> bytes:
    """A module's text compiled for this processor. Raises NotCompiled."""
    llvm = _llvm()
    return _compiled(llvm, _target(llvm), text)


def _target(llvm: Any) -> Any:
    """This processor with all its features."""
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=llvm.get_host_cpu_features().flatten(), opt=2, jit=True
    )


def may_run_what_was_written() -> bool:
    """Whether written memory can be made executable. LLVM aborts the process where it cannot."""
    page = mmap.mmap(-1, mmap.PAGESIZE)
    try:
        address = ctypes.addressof(ctypes.c_char.from_buffer(page))
        libc = ctypes.CDLL(None)
        libc.mprotect.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)
        return libc.mprotect(address, mmap.PAGESIZE, mmap.PROT_READ | mmap.PROT_EXEC) == 0
    finally:
        del page


def _key(llvm: Any, target: Any, text: str) -> str:
    """SHA-256 of all that the object code depends on: text, version of LLVM, processor."""
    features = llvm.get_host_cpu_features().flatten()
    inputs = "\n".join([str(llvm.llvm_version_info), target.triple, llvm.get_host_cpu_name(), features, text])
    return hashlib.sha256(inputs.encode()).hexdigest()


def _compiled(llvm: Any, target: Any, text: str) -> bytes:
    parsed = llvm.parse_assembly(text)
    parsed.triple = target.triple
    parsed.verify()
    options = llvm.create_pipeline_tuning_options(speed_level=1)
    passes = llvm.create_pass_builder(target, options)
    passes.getModulePassManager().run(parsed, passes)
    return target.emit_object(parsed)
