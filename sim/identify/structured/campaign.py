"""The structured fit judged on boats drawn at random: errors, coverage of intervals, stability, open loop, time."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable

import msgspec
import numpy as np

from companion.core.vessel import linear_damping, mass_matrix
from companion.core.vessel_file import VesselFile
from sim.identify.run import Run
from sim.identify.smoothing import SmootherNoise
from sim.identify.structured.boats import draw_boat, in_still_air
from sim.identify.structured.fit import Settings
from sim.identify.structured.parameters import WARP, Parameters, file_values
from sim.identify.structured.result import Z95, FitResult, fit_structured
from sim.identify.structured.vessel_out import identified_vessel
from sim.identify.teleop import teleop_run
from sim.identify.validation.models import VesselSimulator
from sim.identify.validation.scores import errors, simulated
from sim.identify.validation.windows import Windows, cut, reference

TRAIN_S = 1384.0  # 13,840 samples at 10 Hz: paper
UNSEEN_S = 300.0
HORIZON_S = 30.0
DATE = "in simulation"


class BoatScore(msgspec.Struct, frozen=True, kw_only=True):
    """One boat. Errors are shares of the true value; `covered`: is the truth in the 95 % interval.

    `scale_free`: inertia, damping and gains divided by the mean gain, which motion alone cannot show. `open_loop_m`:
    rms position error after 30 s from the true state on an unseen log, identified, true, and the file that fitting
    started from. `cpu_s`: processor time of the fit.
    """

    seed: int
    error: dict[str, float]
    covered: dict[str, bool]
    scale_free_error: dict[str, float]
    scale_free_covered: dict[str, bool]
    stable: bool
    open_loop_m: tuple[float, float, float]
    undetermined: tuple[str, ...]
    latent_share: tuple[float, float, float]
    iterations: int
    seconds: float
    cpu_s: float


class CampaignFigures(msgspec.Struct, frozen=True, kw_only=True):
    """All boats together. `open_loop_ratio`: rms over boats, identified over true parameters."""

    boats: tuple[BoatScore, ...]
    uwb_hz: float
    sigma_m: float
    median_error: float
    worst_boat_error: float
    coverage: float
    scale_free_median_error: float
    scale_free_coverage: float
    unstable: int
    open_loop_m: tuple[float, float, float]
    open_loop_ratio: float
    seconds: tuple[float, float]
    cpu_s: tuple[float, float]


def boats_campaign(
    vessel: VesselFile,
    n: int,
    uwb_hz: float,
    sigma_m: float,
    seed: int,
    *,
    settings: Settings | None = None,
    train_s: float = TRAIN_S,
    say: Callable[[str], None] = lambda _: None,
) -> CampaignFigures:
    """Draw `n` boats round `vessel`, fly and fit each, score it. `say` hears a line per boat."""
    scores = []
    for i in range(n):
        score = one_boat(vessel, seed + i, uwb_hz, sigma_m, settings=settings, train_s=train_s)
        say(line(score))
        scores.append(score)
    return figures(scores, uwb_hz, sigma_m)


def one_boat(
    vessel: VesselFile,
    seed: int,
    uwb_hz: float,
    sigma_m: float,
    *,
    settings: Settings | None = None,
    train_s: float = TRAIN_S,
) -> BoatScore:
    """One boat from its seed: drawn, flown twice, fitted on the first log, judged on the second."""
    boat = draw_boat(vessel, np.random.default_rng(seed))
    train = teleop_run(boat, seed, train_s, uwb_hz=uwb_hz, sigma_m=sigma_m)
    unseen = teleop_run(boat, seed + 500_000, UNSEEN_S, uwb_hz=uwb_hz, sigma_m=sigma_m)
    return judged(vessel, boat, train, unseen, seed, settings)


def judged(
    vessel: VesselFile, boat: VesselFile, train: Run, unseen: Run, seed: int, settings: Settings | None = None
) -> BoatScore:
    """Fit `train` from `vessel` as prior; compare with the true `boat`, also on `unseen`."""
    vessel, boat = in_still_air(vessel), in_still_air(boat)
    cpu = time.process_time()
    result = fit_structured([train], vessel, settings)
    cpu = time.process_time() - cpu
    parameters = Parameters(vessel)
    names, true = parameters.names, file_values(boat)
    covered = {p.name: p.ci95[0] <= t <= p.ci95[1] for p, t in zip(result.parameters, true, strict=True)}
    covered = {n: c for n, c in covered.items() if n not in WARP}  # a boat has none
    shares = [n for n in covered if not n.startswith("tag_")]  # a place in metres has no share
    error = {n: float(v) for n, v in zip(names, result.q / np.where(true == 0, np.nan, true) - 1, strict=True)}
    free, free_true, free_se = scale_free(result, true, parameters)
    ratio_names = names[: parameters.thrusters.stop]
    identified = identified_vessel(vessel, result, date=DATE)
    return BoatScore(
        seed=seed,
        error={n: error[n] for n in shares},
        covered=covered,
        scale_free_error=dict(zip(ratio_names, (free / free_true - 1).tolist(), strict=True)),
        scale_free_covered=dict(zip(ratio_names, (np.abs(free - free_true) <= Z95 * free_se).tolist(), strict=True)),
        stable=is_stable(identified),
        open_loop_m=open_loop(unseen, boat, (identified, boat, vessel)),
        undetermined=tuple(p.name for p in result.parameters if not p.determined),
        latent_share=result.latent_share,
        iterations=result.iterations,
        seconds=result.seconds,
        cpu_s=cpu,
    )


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


def open_loop(unseen: Run, boat: VesselFile, vessels: Iterable[VesselFile]) -> tuple[float, float, float]:
    """RMS position error [m] `HORIZON_S` after windows' starts, every 5 s, of each vessel's model."""
    windows: Windows = cut(
        unseen,
        reference(unseen, SmootherNoise.of(boat)),
        boat.propulsion.nominal_voltage_V,
        horizon_s=HORIZON_S,
        shortest_s=HORIZON_S,
    )
    found = []
    for vessel in vessels:
        e = errors(simulated(VesselSimulator(vessel.name, vessel), windows), windows.truth)[:, -1, 0]
        found.append(float(np.sqrt((e**2).mean())))
    identified, true, prior = found
    return identified, true, prior


def figures(scores: list[BoatScore], uwb_hz: float, sigma_m: float) -> CampaignFigures:
    """Medians and shares over all boats and parameters."""
    errors_ = np.abs([list(s.error.values()) for s in scores])
    free = np.abs([list(s.scale_free_error.values()) for s in scores])
    loops = np.sqrt((np.array([s.open_loop_m for s in scores]) ** 2).mean(axis=0))
    seconds, cpu = [s.seconds for s in scores], [s.cpu_s for s in scores]
    return CampaignFigures(
        boats=tuple(scores),
        uwb_hz=uwb_hz,
        sigma_m=sigma_m,
        median_error=float(np.median(errors_)),
        worst_boat_error=float(np.median(errors_, axis=1).max()),
        coverage=float(np.mean([list(s.covered.values()) for s in scores])),
        scale_free_median_error=float(np.median(free)),
        scale_free_coverage=float(np.mean([list(s.scale_free_covered.values()) for s in scores])),
        unstable=sum(not s.stable for s in scores),
        open_loop_m=(float(loops[0]), float(loops[1]), float(loops[2])),
        open_loop_ratio=float(loops[0] / loops[1]),
        seconds=(float(np.median(seconds)), float(np.max(seconds))),
        cpu_s=(float(np.median(cpu)), float(np.max(cpu))),
    )


def line(s: BoatScore) -> str:
    """One boat in words."""
    worst = max(s.error, key=lambda n: abs(s.error[n]))
    return (
        f"boat {s.seed}: median error {100 * np.median(np.abs(list(s.error.values()))):.2f} %, "
        f"worst {worst} {100 * s.error[worst]:.1f} %, without the scale "
        f"{100 * np.median(np.abs(list(s.scale_free_error.values()))):.2f} %, covered {sum(s.covered.values())}"
        f"/{len(s.covered)} ({sum(s.scale_free_covered.values())}/{len(s.scale_free_covered)} without the scale), "
        f"30 s {s.open_loop_m[0]:.3f} m (true {s.open_loop_m[1]:.3f}, prior {s.open_loop_m[2]:.3f}), "
        f"{s.iterations} steps, {s.seconds:.1f} s ({s.cpu_s:.1f} s of processor)"
    )
