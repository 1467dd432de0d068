"""The machine that a benchmark ran on, as far as its figures depend on it."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import psutil

from sim.bench.result import MachineInfo

LIBRARIES = ("casadi", "llvmlite", "numpy", "scipy")
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
MEGABYTE = 1e6


def load() -> float:
    """Processes that ran or wanted to, mean of the last minute."""
    return os.getloadavg()[0]


def machine(load_before: float) -> MachineInfo:
    """This one, now."""
    return MachineInfo(
        cpu=cpu_model(_text("/proc/cpuinfo")) or platform.processor() or "unknown",
        architecture=platform.machine(),
        cores=os.cpu_count() or 1,
        memory_mb=round(psutil.virtual_memory().total / MEGABYTE),
        kernel=f"{platform.system()} {platform.release()}",
        python=platform.python_version(),
        versions={name: _version(name) for name in LIBRARIES},
        threads={name: os.environ.get(name, "") for name in THREADS},
        governor=_text("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor").strip(),
        load_before=load_before,
        load_after=load(),
    )


def cpu_model(cpuinfo: str) -> str:
    """Name in a /proc/cpuinfo; of the board where there is none (ARM); empty where there is neither."""
    found: dict[str, str] = {}
    for line in cpuinfo.splitlines():
        key, _, value = line.partition(":")
        found.setdefault(key.strip(), value.strip())
    return found.get("model name") or _text("/proc/device-tree/model").strip("\0 \n") or found.get("Hardware", "")


def _text(path: str) -> str:
    """Of a file of the kernel's; empty where it has none."""
    try:
        return Path(path).read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "none"
