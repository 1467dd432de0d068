"""Who plans on a stepped clock: the boat's own controller, ended by its iterations; or nobody."""

from __future__ import annotations

from functools import partial
from typing import Any, NoReturn

from msgspec.structs import replace

from companion.core.control.nmpc import Actuation, Nmpc
from companion.core.messages import SolveRequest
from companion.core.model.manoeuvring import StructuredModel
from companion.core.pilot.pilot import PilotSettings
from companion.jit import CodeStore, compile_loops

PATIENT_S = 60.0
"""Time of IPOPT's rescue: it must end by iterations, which are the same everywhere, not by the wall clock."""


def stepped_controller(settings: PilotSettings) -> Nmpc:
    """The controller of these settings, machine code kept on disk."""
    patient = replace(settings.nmpc, rescue_time_s=PATIENT_S)
    model, actuation = StructuredModel.of(settings.vessel), Actuation.of(settings.vessel)
    return Nmpc(model, actuation, patient, lambda: 0.0, settings.fence, partial(compile_loops, store=CodeStore.of()))


def no_plan(request: SolveRequest, warm: Any) -> NoReturn:
    """The controller of a flight that needs none."""
    raise AssertionError(f"tick {request.index}: an excitation asks for no plan")
