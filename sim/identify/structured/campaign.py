"""The structured fit judged on boats drawn at random: errors, coverage of intervals, stability, open loop, time."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import msgspec
import numpy as np

from companion.core.vessel import linear_damping, mass_matrix
from companion.core.vessel_file import VesselFile
from sim.identify.run import Run
from sim.identify.structured.boats import draw_boat, in_still_air
from sim.identify.structured.data import cut
from sim.identify.structured.fit import Settings
from sim.identify.structured.model import compile_model
from sim.identify.structured.motion import Mover
from sim.identify.structured.noise import STATE, L
from sim.identify.structured.parameters import WARP, Parameters, file_values
from sim.identify.structured.result import Z95, FitResult, fit_structured
from sim.identify.structured.vessel_out import identified_vessel
from sim.identify.teleop import teleop_run

TRAIN_S = 1384.0  # 13,840 samples at 10 Hz: paper
UNSEEN_S = 300.0
HORIZON_S = 30.0
START_SIGMA = (0.05, 0.05, 0.012, 0.02, 0.02, 0.005)
"""How well a filter knows x y [m], psi [rad], u v [m/s], r [rad/s] when a prediction starts: heading wander of the
vessel file, the rest as the project's own filter has them with UWB at 1 Hz; assumed."""
DATE = "in simulation"


class BoatScore(msgspec.Struct, frozen=True, kw_only=True):
    """One boat. Errors are shares of the true value; `covered`: is the truth in the 95 % interval.

    `scale_free`: inertia, damping and gains divided by the mean gain, which motion alone cannot show. `open_loop_m`:
    rms position error after 30 s on an unseen log, identified, true, and the file that fitting started from, from
    states as a filter knows them (`START_SIGMA`); `exact_start_m`: from the true state.
    `cpu_s`: processor time of the fit.
    """

    seed: int
    error: dict[str, float]
    covered: dict[str, bool]
    scale_free_error: dict[str, float]
    scale_free_covered: dict[str, bool]
    stable: bool
    open_loop_m: tuple[float, ...]
    exact_start_m: tuple[float, ...]
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
    open_loop_m: tuple[float, ...]
    exact_start_m: tuple[float, ...]
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
    trio = (identified, boat, vessel)
    return BoatScore(
        seed=seed,
        error={n: error[n] for n in shares},
        covered=covered,
        scale_free_error=dict(zip(ratio_names, (free / free_true - 1).tolist(), strict=True)),
        scale_free_covered=dict(zip(ratio_names, (np.abs(free - free_true) <= Z95 * free_se).tolist(), strict=True)),
        stable=is_stable(identified),
        open_loop_m=open_loop(unseen, trio, START_SIGMA, np.random.default_rng(seed)),
        exact_start_m=open_loop(unseen, trio, (0.0,) * 6, np.random.default_rng(seed)),
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


def open_loop(
    unseen: Run, vessels: Sequence[VesselFile], start_sigma: Sequence[float], rng: np.random.Generator
) -> tuple[float, ...]:
    """RMS position error [m] of each vessel's model `HORIZON_S` after true states off by `start_sigma`.

    `start_sigma`: of x y [m], psi [rad], u v [m/s], r [rad/s]; every vessel starts from the same states.
    """
    windows = cut([unseen], vessels[0], HORIZON_S)
    t, truth = unseen.samples(
        *(f"true_{name}" for name in ("north_m", "east_m", "psi_rad", "u_m_s", "v_m_s", "r_rad_s"))
    )
    truth[:, 2] = np.unwrap(truth[:, 2])
    W, K = windows.size
    z = np.zeros((W, L))
    z[:, STATE] = _at(windows.t_s[:, 0], t, truth) + rng.normal(size=(W, 6)) * np.array(start_sigma)
    end = _at(windows.t_s[:, -1], t, truth)
    found = []
    for vessel in vessels:
        motion = Mover(windows, Parameters(vessel), compile_model(vessel, K, W))(file_values(vessel), z)
        off = motion.x[:, -1, :2] - end[:, :2]
        found.append(float(np.sqrt((off**2).sum(axis=1).mean())))
    return tuple(found)


def _at(t_s: np.ndarray, t: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.column_stack([np.interp(t_s, t, column) for column in values.T])


def figures(scores: list[BoatScore], uwb_hz: float, sigma_m: float) -> CampaignFigures:
    """Medians and shares over all boats and parameters."""
    errors_ = np.abs([list(s.error.values()) for s in scores])
    free = np.abs([list(s.scale_free_error.values()) for s in scores])
    loops, exact = _rms([s.open_loop_m for s in scores]), _rms([s.exact_start_m for s in scores])
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
        open_loop_m=loops,
        exact_start_m=exact,
        open_loop_ratio=loops[0] / loops[1],
        seconds=(float(np.median(seconds)), float(np.max(seconds))),
        cpu_s=(float(np.median(cpu)), float(np.max(cpu))),
    )


def _rms(rows: Sequence[Sequence[float]]) -> tuple[float, ...]:
    return tuple(map(float, np.sqrt((np.array(rows) ** 2).mean(axis=0))))


def line(s: BoatScore) -> str:
    """One boat in words."""
    worst = max(s.error, key=lambda n: abs(s.error[n]))
    return (
        f"boat {s.seed}: median error {100 * np.median(np.abs(list(s.error.values()))):.2f} %, "
        f"worst {worst} {100 * s.error[worst]:.1f} %, without the scale "
        f"{100 * np.median(np.abs(list(s.scale_free_error.values()))):.2f} %, covered {sum(s.covered.values())}"
        f"/{len(s.covered)} ({sum(s.scale_free_covered.values())}/{len(s.scale_free_covered)} without the scale), "
        f"30 s {s.open_loop_m[0]:.3f} m (true {s.open_loop_m[1]:.3f}, prior {s.open_loop_m[2]:.3f}; "
        f"exact start {s.exact_start_m[0]:.3f}, {s.exact_start_m[1]:.3f}, {s.exact_start_m[2]:.3f}), "
        f"{s.iterations} steps, {s.seconds:.1f} s ({s.cpu_s:.1f} s of processor)"
    )
