"""A module's text as functions that can be called; its object code kept, so that it is compiled once.

llvmlite is a wheel (x86-64 and aarch64) that brings LLVM with it. Where it is absent, or the system forbids memory
that is written and then run (`MemoryDenyWriteExecute` of a service), `NotCompiled` says so and the caller takes
CasADi's interpreter instead.
"""

from __future__ import annotations

import ctypes
import hashlib
import importlib
import mmap
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Protocol

import numpy as np

from companion.jit.emit import Unsupported
from companion.jit.program import Step, module


class NotCompiled(Exception):
    """No machine code here; the text says why."""


class Store(Protocol):
    """Keeps object code between runs of the program. Must give back what it was given, or nothing."""

    def get(self, key: str) -> bytes | None:
        """Object code of that key, or None."""
        ...

    def put(self, key: str, code: bytes) -> None:
        """Keep it; failing to is no error."""
        ...

    def made(self, text: str) -> bytes | None:
        """Object code of a module's text, made elsewhere than in this process; None: to be made here."""
        ...


class Code:
    """Machine code of one module's text, compiled or taken from `store`. Raises NotCompiled."""

    def __init__(self, text: str, store: Store | None = None):
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
        """Of a function; valid while this object lives."""
        return self._engine.get_function_address(name)


class Machine:
    """The entries of one module, each over the same memory. `memory`: doubles, contiguous, kept alive here."""

    def __init__(self, entries: Mapping[str, Sequence[Step]], memory: np.ndarray, store: Store | None = None):
        """Compile, or take from `store`. Raises NotCompiled."""
        self.memory = memory
        try:
            text = module(entries)
        except Unsupported as error:
            raise NotCompiled(str(error)) from None
        self._code = Code(text, store)
        here = ctypes.c_void_p(memory.ctypes.data)
        self._entries = {name: self._bound(self._code.address(name), here) for name in entries}

    def entry(self, name: str) -> Callable[[], None]:
        """A function that runs an entry; it allocates nothing and lets no exception out."""
        return self._entries[name]

    def _bound(self, address: int, memory: ctypes.c_void_p) -> Callable[[], None]:
        function = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(address)
        function.machine = self  # type: ignore[attr-defined]  # whoever holds an entry keeps its code and memory
        return partial(function, memory)


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
    """This processor, with all that it can do."""
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=llvm.get_host_cpu_features().flatten(), opt=2, jit=True
    )


def may_run_what_was_written() -> bool:
    """Whether memory that was written can be made executable. LLVM would end the program where it cannot."""
    page = mmap.mmap(-1, mmap.PAGESIZE)
    try:
        address = ctypes.addressof(ctypes.c_char.from_buffer(page))
        libc = ctypes.CDLL(None)
        libc.mprotect.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)
        return libc.mprotect(address, mmap.PAGESIZE, mmap.PROT_READ | mmap.PROT_EXEC) == 0
    finally:
        del page


def _key(llvm: Any, target: Any, text: str) -> str:
    """Names what the object code depends on: the text, LLVM's version, the processor."""
    features = llvm.get_host_cpu_features().flatten()
    about = "\n".join([str(llvm.llvm_version_info), target.triple, llvm.get_host_cpu_name(), features, text])
    return hashlib.sha256(about.encode()).hexdigest()


def _compiled(llvm: Any, target: Any, text: str) -> bytes:
    parsed = llvm.parse_assembly(text)
    parsed.triple = target.triple
    parsed.verify()
    options = llvm.create_pipeline_tuning_options(speed_level=1)
    passes = llvm.create_pass_builder(target, options)
    passes.getModulePassManager().run(parsed, passes)
    return target.emit_object(parsed)
