"""The structured fit judged on boats drawn at random: errors, coverage of intervals, stability, open loop, time.

Beside it the paper's regression on the same log, as a rival in open loop: by the paper's pipeline (taylor) and from
the smoother's speeds and accelerations (taylor_smoother), which do it more justice.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence

import msgspec
import numpy as np
from msgspec.structs import replace
from scipy.stats import t as student

from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.manoeuvring import linear_damping, mass_matrix
from companion.logs.runs.run import Run
from sim.fitting.engine.parameters import WARP, Parameters, file_values
from sim.fitting.engine.smoothing import SmootherNoise, smooth
from sim.fitting.identify.result import Z95, FitResult, fit_structured
from sim.fitting.identify.vessel_out import identified_vessel
from sim.fitting.taylor.pipeline import paper_samples, smoother_samples
from sim.fitting.taylor.regression import least_squares
from sim.studies.boats.draw import draw_boat, in_still_air
from sim.studies.boats.lab_priors import BOLLARD, LabPriors, measured
from sim.studies.boats.open_loop import STARTS, distances, rms
from sim.world.teleop_log import teleop_run

TRAIN_S = 1384.0  # 13,840 samples at 10 Hz: paper
UNSEEN_S = 300.0
UNSEEN_SEED = 500_000  # added to a boat's seed for the log that no fit sees
DATE = "in simulation"


class BoatScore(msgspec.Struct, frozen=True, kw_only=True):
    """One boat. Errors are shares of the true value; `covered`: is the truth in the 95 % interval; `z`: error over se.

    `scale_free`: inertia, damping and gains divided by the mean gain, which motion alone cannot show. `open_loop_m`: by
    start (`STARTS`), then by model (identified, true, file, taylor, taylor_smoother), position errors of all windows
    after 30 s on an unseen log. `cpu_s`: processor time of the fit.
    """

    seed: int
    lab: str
    error: dict[str, float]
    z: dict[str, float]
    covered: dict[str, bool]
    scale_free_error: dict[str, float]
    scale_free_covered: dict[str, bool]
    stable: bool
    open_loop_m: dict[str, dict[str, tuple[float, ...]]]
    undetermined: tuple[str, ...]
    latent_share: tuple[float, float, float]
    window_s: float
    iterations: int
    seconds: float
    cpu_s: float


class CampaignFigures(msgspec.Struct, frozen=True, kw_only=True):
    """All boats together. `coverage_half`: half width of the 95 % interval of `coverage` with boats as the sample.

    `rms_m`, `median_m`: open loop over all windows of all boats, by start, then by model. `open_loop_ratio`: rms,
    identified over true parameters, from states as a filter has them.
    """

    boats: tuple[BoatScore, ...]
    median_error: float
    worst_boat_error: float
    coverage: float
    coverage_half: float
    z_rms: dict[str, float]
    scale_free_median_error: float
    scale_free_coverage: float
    unstable: int
    rms_m: dict[str, dict[str, float]]
    median_m: dict[str, dict[str, float]]
    open_loop_ratio: float
    seconds: tuple[float, float]
    cpu_s: tuple[float, float]


def one_boat(
    vessel: VesselFile,
    seed: int,
    uwb_hz: float,
    sigma_m: float,
    *,
    labs: Sequence[LabPriors] = (BOLLARD,),
    train_s: float = TRAIN_S,
) -> tuple[BoatScore, ...]:
    """One boat from its seed, every parameter up to 30 % off: flown twice, fitted on the first log, judged on the

    second. A score for each of `labs`, all on the same logs.
    """
    uwb = replace(vessel.sensors.tag, rate_Hz=uwb_hz, range_sigma_m=sigma_m)
    vessel = replace(vessel, sensors=replace(vessel.sensors, uwb=uwb))
    boat = draw_boat(vessel, np.random.default_rng(seed), gain_sigma=0.0)
    train = teleop_run(boat, seed, train_s, uwb_hz=uwb_hz, sigma_m=sigma_m)
    unseen = teleop_run(boat, seed + UNSEEN_SEED, UNSEEN_S, uwb_hz=uwb_hz, sigma_m=sigma_m)
    return tuple(judged(vessel, boat, train, unseen, seed, lab) for lab in labs)


def judged(vessel: VesselFile, boat: VesselFile, train: Run, unseen: Run, seed: int, lab: LabPriors) -> BoatScore:
    """Fit `train` from `vessel` with what `lab` measured; compare with the true `boat`, also on `unseen`."""
    boat = in_still_air(boat)
    file, settings = measured(in_still_air(vessel), boat, lab, np.random.default_rng([seed, 1]))
    cpu = time.process_time()
    result = fit_structured([train], file, settings)
    cpu = time.process_time() - cpu
    parameters = Parameters(file)
    names, true = parameters.names, file_values(boat)
    rated = [i for i, name in enumerate(names) if name not in WARP]  # a boat has none
    shares = [i for i in rated if not names[i].startswith("tag_")]  # a place in metres has no share
    free, free_true, free_se = scale_free(result, true, parameters)
    ratio_names = names[: parameters.thrusters.stop]
    identified = identified_vessel(file, result, date=DATE)
    return BoatScore(
        seed=seed,
        lab=lab.name,
        error={names[i]: float(result.q[i] / true[i] - 1) for i in shares},
        z={names[i]: float((result.q[i] - true[i]) / result.parameters[i].se) for i in rated},
        covered={names[i]: _inside(true[i], result.parameters[i].ci95) for i in rated},
        scale_free_error=dict(zip(ratio_names, (free / free_true - 1).tolist(), strict=True)),
        scale_free_covered=dict(zip(ratio_names, (np.abs(free - free_true) <= Z95 * free_se).tolist(), strict=True)),
        stable=is_stable(identified),
        open_loop_m=_open_loop(unseen, {"identified": identified, "true": boat, "file": file}, train, file, seed),
        undetermined=tuple(p.name for p in result.parameters if not p.determined),
        latent_share=result.latent_share,
        window_s=result.window_s,
        iterations=result.iterations,
        seconds=result.seconds,
        cpu_s=cpu,
    )


def _inside(value: float, interval: tuple[float, float]) -> bool:
    return bool(interval[0] <= value <= interval[1])


def _open_loop(
    unseen: Run, vessels: dict[str, VesselFile], train: Run, file: VesselFile, seed: int
) -> dict[str, dict[str, tuple[float, ...]]]:
    """Of the vessels and of the Taylor series that `train` gives with the forces of `file`."""
    noise = SmootherNoise.of(file)
    samples = {"taylor": paper_samples(train, file, noise)}
    samples["taylor_smoother"] = smoother_samples(train, file, smooth(train, noise))
    taylor = {name: least_squares([part]).C for name, part in samples.items()}
    found = {}
    for start in STARTS:
        by_model = distances(unseen, vessels, taylor, start, np.random.default_rng(seed))
        found[start] = {name: tuple(map(float, d)) for name, d in by_model.items()}
    return found


def scale_free(
    result: FitResult, true: np.ndarray, parameters: Parameters
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Inertia, damping and gains over the mean gain: found, true, and one sigma."""
    gains = parameters.thrusters
    q, covariance = result.q[: gains.stop], np.array(result.covariance)[: gains.stop, : gains.stop]
    mean = q[gains].mean()
    J = np.eye(len(q)) / mean
    J[:, gains] -= q[:, None] / mean**2 / (gains.stop - gains.start)
    se = np.sqrt(np.diag(J @ covariance @ J.T))
    return q / mean, true[: gains.stop] / true[gains].mean(), se


def is_stable(vessel: VesselFile) -> bool:
    """M > 0, D + D^T > 0 and quadratic damping of the right sign: without thrust the energy only falls."""
    D, d = linear_damping(vessel), vessel.damping
    quadratic = max(d.X_uu_N_s2_m2, d.Y_vv_N_s2_m2, d.N_rr_N_m_s2)
    M_good = np.linalg.eigvalsh(mass_matrix(vessel)).min() > 0
    return bool(M_good and np.linalg.eigvalsh(D + D.T).min() > 0 and quadratic <= 0)


def figures(scores: Sequence[BoatScore]) -> CampaignFigures:
    """Medians and shares over all boats and parameters."""
    errors = np.abs([list(s.error.values()) for s in scores])
    free = np.abs([list(s.scale_free_error.values()) for s in scores])
    by_boat = np.array([np.mean(list(s.covered.values())) for s in scores])
    n = len(by_boat)
    half = student.ppf(0.975, n - 1) * by_boat.std(ddof=1) / np.sqrt(n) if n > 1 else np.nan
    loops = {start: _pooled([s.open_loop_m[start] for s in scores]) for start in STARTS}
    rms_m = {start: {name: rms(d) for name, d in models.items()} for start, models in loops.items()}
    seconds, cpu = [s.seconds for s in scores], [s.cpu_s for s in scores]
    return CampaignFigures(
        boats=tuple(scores),
        median_error=float(np.median(errors)),
        worst_boat_error=float(np.median(errors, axis=1).max()),
        coverage=float(by_boat.mean()),
        coverage_half=float(half),
        z_rms={name: rms([s.z[name] for s in scores]) for name in scores[0].z},
        scale_free_median_error=float(np.median(free)),
        scale_free_coverage=float(np.mean([list(s.scale_free_covered.values()) for s in scores])),
        unstable=sum(not s.stable for s in scores),
        rms_m=rms_m,
        median_m={start: {k: float(np.median(d)) for k, d in models.items()} for start, models in loops.items()},
        open_loop_ratio=rms_m["filter"]["identified"] / rms_m["filter"]["true"],
        seconds=(float(np.median(seconds)), float(np.max(seconds))),
        cpu_s=(float(np.median(cpu)), float(np.max(cpu))),
    )


def _pooled(rows: Iterable[dict[str, tuple[float, ...]]]) -> dict[str, np.ndarray]:
    """All boats' windows in one row for each model."""
    rows = list(rows)
    return {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}


def line(s: BoatScore) -> str:
    """One boat in words."""
    worst = max(s.error, key=lambda n: abs(s.error[n]))
    loop = {name: rms(d) for name, d in s.open_loop_m["filter"].items()}
    ratios = f"{sum(s.scale_free_covered.values())}/{len(s.scale_free_covered)} without the scale"
    return (
        f"boat {s.seed} ({s.lab}): median error {100 * np.median(np.abs(list(s.error.values()))):.2f} %, "
        f"worst {worst} {100 * s.error[worst]:.1f} %, without the scale "
        f"{100 * np.median(np.abs(list(s.scale_free_error.values()))):.2f} %, covered {sum(s.covered.values())}"
        f"/{len(s.covered)} ({ratios}), 30 s {loop['identified']:.3f} m (true {loop['true']:.3f}, "
        f"file {loop['file']:.3f}, Taylor {loop['taylor']:.3g} and {loop['taylor_smoother']:.3g}), "
        f"{s.iterations} steps, {s.seconds:.1f} s ({s.cpu_s:.1f} s of processor)"
    )
