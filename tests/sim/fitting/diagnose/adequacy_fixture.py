"""Logs with faults that no entry of the catalogue explains, and the model fitted to them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
import polars as pl

from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.run import Run
from sim.fitting.diagnose.catalogue import catalogue, without_effects
from sim.fitting.diagnose.catalogue.effect import EffectParameter
from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.posterior.noise import stated_noise
from sim.fitting.diagnose.posterior.physics import EffectPhysics
from sim.fitting.diagnose.selection.greedy_selection import Selector
from sim.fitting.diagnose.selection.model import CandidateModel
from sim.studies.boats.draw import in_still_air
from sim.world.teleop_log import teleop_run
from tests.support.vessel_fixtures import boat

VESSEL = in_still_air(boat("aritra"))
UNIT = (EffectParameter("a", "", 1.0, 1.0, 0.01),)


@cache
def drive(seed: int = 21, seconds: float = 100.0) -> Run:
    return teleop_run(boat("aritra"), seed, seconds, uwb_hz=5.0, sigma_m=0.07)


def bench(run: Run, without: Sequence[str] = ()) -> tuple[PosteriorFit, CandidateModel]:
    fit = PosteriorFit(
        EffectPhysics([run], VESSEL, 1.0), without_effects(catalogue(VESSEL, [run]), without), stated_noise(VESSEL)
    )
    return fit, Selector(fit).base()


@cache
def clean() -> tuple[PosteriorFit, CandidateModel]:
    return bench(drive())


@cache
def faulty(fault) -> tuple[PosteriorFit, CandidateModel]:
    return bench(fault(drive()))


def compass_off_by_place(run: Run) -> Run:
    """The compass is 6 degrees off in one half of the basin."""
    table = run.table.with_columns(pl.col("north_m", "east_m").interpolate().forward_fill().backward_fill())
    off = np.radians(6.0) * np.tanh(table["north_m"].to_numpy() - float(table["north_m"].mean()))  # type: ignore[arg-type]  # a float column
    wrong = run.table["psi_rad"].to_numpy() + off
    wrapped = pl.Series(np.arctan2(np.sin(wrong), np.cos(wrong))).fill_nan(None)
    return Run(run.table.with_columns(psi_rad=wrapped), run.meta)


@cache
def other(changed: Callable[[VesselFile], VesselFile], *without: str) -> tuple[PosteriorFit, CandidateModel]:
    """Logs of a boat that is not as the file has it, and a catalogue that lacks some entries."""
    vessel = boat("aritra")
    return bench(teleop_run(changed(vessel), 21, 100.0, uwb_hz=5.0, sigma_m=0.07, believed=vessel), without)
