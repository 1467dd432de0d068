"""Writing causes into a vessel file (docs/adr/0015), and which of them a file has no key for.

A diagnosis yields three files, all of which load unchanged:

    refitted        base numbers of the best fit without any cause
    numbers         base numbers of the fit beside the causes, without the causes
    extended        `numbers` with the causes

Base numbers: mass, damping, coupling, gains, force maps, dead time, lag, places and latency of sensors, each within its
tolerance band. Effects of the day (current, wind) and known errors of sensors are written only if they were named.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress

import numpy as np
from msgspec.structs import replace

from companion.core.configuration.tables import ConfigError
from companion.core.configuration.vessel_file import Damping, ModelError, RotorMap, VesselFile
from companion.core.estimation.tuning import EstimatorTuning
from companion.core.model.manoeuvring import mass_matrix
from companion.core.model.vessel_text import vessel_toml
from sim.fitting.diagnose.vessel_edits.edits import EDITS, CauseValues, NotInVesselFileError
from sim.fitting.engine.noise import Noise
from sim.fitting.engine.parameters import DAMPING, HULL, file_values
from sim.fitting.identify.vessel_out import inertia_of
from sim.fitting.wiring.thrusters import append_note

REFITTED_WITH_BASE = (
    "base", "thruster_gain", "common_loss", "astern_asymmetry", "voltage_exponent", "dead_band", "lag", "dead_time",
    "hull_fouling", "payload", "added_mass", "yaw_inertia", "cg_shift", "yaw_sway_coupling", "imu_lever_arm",
    "uwb_latency", "uwb_lever_arm", "gnss_latency", "gnss_lever_arm",
)  # fmt: skip
"""Effects whose tolerance band is part of a refitted base: they move numbers that every vessel file has."""
IN_SAMPLE = 2.0
"""Factor on the latent force of the fitted logs: bands absorbed part of it, and conditions vary; assumed."""
LEAST_SHARE = 0.2
"""Least model error over the filter's own tuning: effects below their smallest sizes: 0.8 N and 0.3 N m; assumed."""
LAST = ("swapped_pair", "accel_bias", "gyro_bias")
"""Causes written last: swapped pairs change names, and biases refer to the final axes and scale of the IMU."""
COUPLINGS = ("M23_kg_m", "Y_r_N_s", "N_v_N_s")


def refitted(vessel: VesselFile, nuisances: Sequence[CauseValues], source: str) -> VesselFile:
    """`vessel` with its base numbers changed by those `nuisances` that are in `REFITTED_WITH_BASE`.

    Where the file's checks refuse the fitted yaw-sway coupling, that of the file is kept.
    """
    mine = [n for n in nuisances if n.kind in REFITTED_WITH_BASE]
    before = c = _coefficients(vessel)
    for cause in mine:
        if "hull" in cause.effect.hooks:
            c = cause.effect.hooks["hull"](dict(cause.engine), c)
    moved = _with_hull(vessel, c, source)
    if not _loads(moved):
        moved = _with_hull(vessel, c | {k: before[k] for k in COUPLINGS}, source)
    for cause in mine:
        if cause.kind == "base" and "maps" in cause.effect.hooks:
            moved = _rounded(cause.effect.hooks["maps"](dict(cause.engine), moved))
        elif "hull" not in cause.effect.hooks and cause.kind != "base":
            with suppress(NotInVesselFileError):
                moved = extended(moved, cause)
    return moved


def _rounded(vessel: VesselFile) -> VesselFile:
    """Trims rounded to whole microseconds and clipped to the dead band, as vessel files require."""
    trimmed = []
    for t in vessel.thrusters:
        fmap = vessel.force_maps[t.force_map]
        most = max(math.ceil(fmap.dead_band_us) - 1, 0) if isinstance(fmap, RotorMap) else math.inf
        trimmed.append(replace(t, trim_us=round(max(-most, min(t.trim_us, most)))))
    return replace(vessel, thrusters=tuple(trimmed))


def extended(vessel: VesselFile, cause: CauseValues) -> VesselFile:
    """`vessel` with one cause written into it. NotInVesselFileError where a vessel file has no key for it."""
    hooks = set(cause.effect.hooks)
    if cause.kind in EDITS:
        new = EDITS[cause.kind](vessel, cause)
    elif hooks == {"maps"}:
        new = _with_maps(vessel, cause.effect.hooks["maps"](dict(cause.engine), vessel), cause.note)
    elif hooks == {"hull"}:
        c = cause.effect.hooks["hull"](dict(cause.engine), _coefficients(vessel))
        new = _with_hull(vessel, c, cause.note)
    else:
        raise NotInVesselFileError("no key of a vessel file stands for it")
    try:
        vessel_toml(new)
    except ConfigError as error:
        raise NotInVesselFileError(str(error)) from None
    return new


def with_causes(vessel: VesselFile, causes: Sequence[CauseValues]) -> tuple[VesselFile, dict[str, str]]:
    """`vessel` with all causes that it has keys for, and by name of the others the reason."""
    left: dict[str, str] = {}
    for cause in sorted(causes, key=lambda c: c.kind in LAST):
        try:
            vessel = extended(vessel, cause)
        except NotInVesselFileError as error:
            left[cause.effect.name] = str(error)
    return vessel, left


def base_numbers(folded: VesselFile, full: VesselFile, causes: Sequence[CauseValues]) -> VesselFile:
    """Base numbers on which the causes' public values yield `full`.

    They are `folded` except for added mass, whose cause is relative to a number that absorbs all changes of M.
    """
    for cause in causes:
        if cause.effect.name == "added_mass":
            gain = cause.public["gain"]
            own = {k: getattr(full.inertia, k) / gain for k in ("X_udot_kg", "Y_vdot_kg")}
            return replace(folded, inertia=replace(folded.inertia, **own))
    return folded


def with_model_error(vessel: VesselFile, noise: Noise, source: str) -> VesselFile:
    """`vessel` with a model error for the filter: `IN_SAMPLE` diag(M) times the latent acceleration, or more."""
    force = IN_SAMPLE * np.diag(mass_matrix(vessel)) * np.array(noise.latent)
    X, Y, N = np.maximum(force, LEAST_SHARE * np.array(EstimatorTuning().lively_sigma)).tolist()
    error = ModelError(X_sigma_N=round(X, 3), Y_sigma_N=round(Y, 3), N_sigma_N_m=round(N, 3), source=source)
    return replace(vessel, model_error=error)


def _loads(vessel: VesselFile) -> bool:
    try:
        vessel_toml(vessel)
    except ConfigError:
        return False
    return True


def _coefficients(vessel: VesselFile) -> dict[str, float]:
    """Hull coefficients of the file by the names of HULL."""
    return dict(zip(HULL, file_values(vessel)[: len(HULL)].tolist(), strict=True))


def _with_maps(before: VesselFile, after: VesselFile, note: str) -> VesselFile:
    """`after` with the note in `source` of those tables that differ from `before`."""
    maps = {
        name: m if m == before.force_maps[name] else replace(m, source=append_note(m.source, note))
        for name, m in after.force_maps.items()
    }
    propulsion = after.propulsion
    if propulsion != before.propulsion:
        propulsion = replace(propulsion, source=append_note(propulsion.source, note))
    return replace(after, force_maps=maps, propulsion=propulsion)


def _with_hull(vessel: VesselFile, c: Mapping[str, float], note: str) -> VesselFile:
    damping = Damping(**{name: c[name] for name in DAMPING}, source=append_note(vessel.damping.source, note))
    return replace(
        vessel, inertia=inertia_of(vessel.inertia, c, append_note(vessel.inertia.source, note)), damping=damping
    )
