"""Trajectories of a vessel by the loop of their kind of step."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import msgspec
import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from sim.trajectory.arguments import Task
from sim.trajectory.loops import Interpreted, loop
from sim.trajectory.step import StepKind, step_function


@lru_cache(maxsize=64)
def _step(packed: bytes, kind: StepKind) -> str:
    """The step of a vessel file, serialized."""
    return step_function(msgspec.msgpack.decode(packed, type=VesselFile), kind).serialize()


def states(vessel: VesselFile, work: Task, machine_code: bool) -> tuple[np.ndarray, str]:
    """x at the start and after every sample, (m, k + 1, 6 + n), and why by the interpreter."""
    step = _step(msgspec.msgpack.encode(vessel), work.kind)
    run, why = loop(step) if machine_code else (Interpreted(ca.Function.deserialize(step)), "not asked for")
    m, width = work.start.shape
    x = np.empty((m, work.samples + 1, width))
    x[:, 0] = work.start
    run(work.start.copy(), work.constants, work.series, x[:, 1:])
    return x, why
