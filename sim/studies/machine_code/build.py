"""Source text to something that runs, kept by its digest beside the boat's machine code."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

from companion.jit.cache import cache_folder
from companion.jit.private_folder import PrivateFolder

GCC = ("gcc", "-O3", "-march=native", "-fno-math-errno", "-shared", "-fPIC")


def _kept(text: str, suffix: str) -> Path:
    caches = cache_folder(os.environ)
    assert caches is not None, "this user has no home: name a folder in ARITRA_CACHE"
    folder = caches / "study"
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    PrivateFolder(folder).demand_private()
    return folder / f"code_{hashlib.sha256(text.encode()).hexdigest()[:16]}{suffix}"


def numba_module(text: str) -> ModuleType:
    """Python source as a module of a file, beside which numba keeps its code."""
    path = _kept(text, ".py")
    if not path.exists():
        path.write_text(text, encoding="utf-8")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module  # numba looks there for what it kept
    spec.loader.exec_module(module)
    return module


def shared_library(text: str) -> Path:
    """C source compiled by gcc."""
    path = _kept(text, ".so")
    if not path.exists():
        source = path.with_suffix(".c")
        source.write_text(text, encoding="utf-8")
        subprocess.run([*GCC, "-o", str(path), str(source), "-lm"], check=True)
    return path
