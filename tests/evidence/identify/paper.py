"""Evidence for identification: the paper's regression, on the structured plant's logs and on its own polynomial's."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from companion.boat.load_run import EXAMPLES, load_setup
from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.run import Run
from sim.fitting.engine.smoothing import SmootherNoise, smooth
from sim.fitting.identify.result import fit_structured
from sim.fitting.identify.structured_fit import FitSettings
from sim.fitting.identify.vessel_out import identified_vessel
from sim.fitting.taylor.abkowitz import C
from sim.fitting.taylor.abkowitz_table import TERMS
from sim.fitting.taylor.pipeline import paper_motion, paper_samples, smoother_samples
from sim.fitting.taylor.regression import TaylorFit, least_squares, noise_shift
from sim.fitting.taylor.sindy import sindy_coefficients
from sim.fitting.validate.divergence import Departure, divergence_study, divergence_table
from sim.fitting.validate.figures import comparison, divergence, training_log
from sim.fitting.validate.models import ConstantVelocity, TaylorSimulator, VesselSimulator
from sim.fitting.validate.scores import SpeedBox
from sim.fitting.validate.stability import stability
from sim.fitting.validate.study import HeldOut, validate
from sim.fitting.validate.windows import HeldOutWindows, concatenated, cut_held_out, reference_motion
from sim.studies.boats.campaign import DATE, TRAIN_S
from sim.studies.boats.draw import draw_boat, in_still_air
from sim.studies.boats.lab_priors import BOLLARD, measured
from sim.studies.paper.polynomial_log import polynomial_logs
from sim.studies.paper.recovery import differenced, noisy, recovery, through_sensors
from sim.world.teleop_log import teleop_run
from tests.evidence.identify.coefficient_table import coefficient_table
from tests.evidence.line import Line, at_most, between, exactly, information

ROOT = Path(__file__).resolve().parents[3]
OUT = ROOT / "out" / "identify"
SEED = 4000
SAMPLES = 13_840
UNSEEN_S = 1210.0  # 20 runs of 60 s
NOISE_SEEDS = 16
SENSOR_SEEDS = 4


@cache
def reference_vessel() -> VesselFile:
    return in_still_air(load_setup(EXAMPLES / "aritra.toml").pilot.vessel)


@cache
def known_boat() -> tuple[VesselFile, FitSettings]:
    """What the structured fit starts from: a file that is up to 30 % off everywhere, the thrusters' pull measured."""
    rng = np.random.default_rng(SEED)
    return measured(draw_boat(reference_vessel(), rng, gain_sigma=0.0), reference_vessel(), BOLLARD, rng)


@cache
def training_run() -> Run:
    """1384 s of teleoperation of the boat of the file: IMU 30 Hz, UWB 1 Hz with 10 cm."""
    return teleop_run(reference_vessel(), SEED, TRAIN_S)


@cache
def _unseen(number: int) -> Run:
    return teleop_run(reference_vessel(), SEED + 500_000 + number, UNSEEN_S)


def _windows(count: int) -> HeldOutWindows:
    """60 s each, one after the other, from logs of their own."""
    vessel, noise = reference_vessel(), SmootherNoise.of(reference_vessel())
    parts = []
    for number in range(-(-count // 20)):
        run = _unseen(number)
        volts = vessel.propulsion.nominal_voltage_V
        parts.append(cut_held_out(run, reference_motion(run, noise), volts, stride_s=60.0, shortest_s=60.0))
    return concatenated(parts)


def _departures(fits: dict[str, np.ndarray], structured: VesselFile, count: int) -> tuple[list[Departure], SpeedBox]:
    _, nu = training_run().samples("true_u_m_s", "true_v_m_s", "true_r_rad_s")
    box = SpeedBox.of(nu)
    models = [VesselSimulator("true parameters", reference_vessel()), VesselSimulator("structured", structured)]
    models += [TaylorSimulator(name, c, reference_vessel()) for name, c in fits.items()]
    return divergence_study([*models, ConstantVelocity()], _windows(count), box), box


def paper_pipeline(full: bool) -> Iterator[Line]:
    """Paper's pipeline on 13,840 samples of the structured plant (seed 4000), unseen runs from seeds 504000 on"""
    vessel, noise, train = reference_vessel(), SmootherNoise.of(reference_vessel()), training_run()
    samples = [paper_samples(train, vessel, noise)]
    fit = least_squares(samples)
    yield exactly("samples", fit.n, SAMPLES)
    yield exactly("rank of the regression", fit.rank, len(TERMS))
    smoothed = smooth(train, noise)
    by_smoother = [smoother_samples(train, vessel, smoothed)]
    better = least_squares(by_smoother)
    sigma = np.sqrt(np.diagonal(smoothed.P[:, 3:, 3:], axis1=1, axis2=2))
    shift = noise_shift(by_smoother, [sigma], np.random.default_rng(SEED))
    print("\nPaper's pipeline, as Table 2:\n" + coefficient_table(fit))
    print("\nSame regression on the smoother's speeds and accelerations:\n" + coefficient_table(better, shift) + "\n")
    file, settings = known_boat()
    identified = identified_vessel(file, fit_structured([train], file, settings), date=DATE)
    count = 100
    taylor = {"Taylor (paper)": fit.C, "Taylor (smoother)": better.C}
    found, box = _departures(taylor, identified, count)
    print(
        "Median distance from the true place, share of runs that diverged:\n"
        + divergence_table(found).markdown()
        + "\n"
    )
    for d in found:
        gone = round(d.diverged[-1] * d.runs)
        where = f"{d.position_m[9, 1]:.2f} m after 10 s, {d.position_m[29, 1]:.2f} m after 30 s"
        yield information(f"{d.name}: median distance after 60 s", d.position_m[-1, 1], "m", where)
        if d.name == "structured":
            yield exactly(f"{d.name}: runs of {d.runs} that diverge within 60 s", gone, 0)
        else:
            yield information(f"{d.name}: runs of {d.runs} that diverge within 60 s", gone)
    for model in [TaylorSimulator("Taylor (printed in the paper)", C, vessel)] + [
        TaylorSimulator(name, c, vessel) for name, c in taylor.items()
    ]:
        shares = stability(model, vessel, box, SEED)
        note = f"without thrust {100 * shares.free_diverged:.0f} %, comes to rest {100 * shares.free_at_rest:.0f} %"
        what = f"{model.name}: diverge under thrusts drawn every 10 s"
        yield information(what, 100 * shares.driven_diverged, "%", f"{shares.runs} runs of 60 s; {note}")
    shares = stability(VesselSimulator("structured", identified), vessel, box, SEED)
    yield exactly("structured: the same", 100 * shares.driven_diverged, 0, "%")
    written = _pictures(taylor, identified, found, box)
    yield exactly("pictures as Figures 5 to 10, and of divergence", len(written), 4, "", ", ".join(written))


def _pictures(
    taylor: dict[str, np.ndarray], structured: VesselFile, found: list[Departure], box: SpeedBox
) -> list[str]:
    """Writes them under out/identify; their names."""
    vessel, noise, train = reference_vessel(), SmootherNoise.of(reference_vessel()), training_run()
    models = [TaylorSimulator(name, c, vessel) for name, c in taylor.items()]
    study = validate(
        [VesselSimulator("structured", structured), *models], [HeldOut(_unseen(0))], vessel, noise, box=box, seed=SEED
    )
    pictures: dict[str, Figure] = {
        "figures_5_6": training_log(train, paper_motion(train, noise), smooth(train, noise)),
        "figures_7_to_10_a": comparison(study, 0, structured),
        "figures_7_to_10_b": comparison(study, len(study.windows.start_s) // 2, structured),
        "divergence": divergence(found),
    }
    OUT.mkdir(parents=True, exist_ok=True)
    for name, figure in pictures.items():
        figure.savefig(OUT / f"{name}.png", dpi=110)
    return [f"{name}.png" for name in pictures]


def polynomial(full: bool) -> Iterator[Line]:
    """The paper's own polynomial inside its validity box (seed 4000): do its coefficients come back?"""
    logs = polynomial_logs(np.random.default_rng(SEED), SAMPLES)
    exact = recovery([least_squares([log.samples for log in logs])])
    yield exactly("samples", exact.samples, SAMPLES)
    yield at_most("without noise: worst absolute error", exact.worst_abs, 1e-9)
    away = recovery([least_squares(differenced(logs, across_steps=False))])
    yield at_most("exact speeds, 7-point differences away from steps of force", away.worst_abs, 1e-4)
    across = recovery([least_squares(differenced(logs, across_steps=True))])
    yield information("the same across the steps: median error", 100 * across.median_rel, "%")
    seeds = [np.random.default_rng([SEED, k]) for k in range(NOISE_SEEDS)]
    found = recovery([least_squares(noisy(logs, rng, 0.01, 0.002)) for rng in seeds])
    noise = f"{NOISE_SEEDS} seeds; 0.01 m/s^2 over 0.5 s, speeds 2 mm/s; median error {100 * found.median_rel:.0f} %"
    yield between("noise in the accelerations: 95 % intervals cover", 100 * found.coverage, 90, 98, "%", noise)
    for by, name in (("paper", "paper's filter"), ("smoother", "smoother with biases")):
        rngs = [np.random.default_rng([SEED, 1, k]) for k in range(SENSOR_SEEDS)]
        found = recovery([least_squares(through_sensors(logs, rng, by=by)) for rng in rngs])
        what = f"through the paper's sensors, {name}"
        why = f"{SENSOR_SEEDS} seeds; errors of u, v, r are in the regressors, no interval of (7) knows of them"
        yield between(f"{what}: intervals cover", 100 * found.coverage, 90, 98, "%", why)
        yield information(f"{what}: median error", 100 * found.median_rel, "%")


def pysindy(full: bool) -> Iterator[Line]:
    """pysindy on the same samples: an outside peer (same table, same unseen runs)"""
    logs = [log.samples for log in polynomial_logs(np.random.default_rng(SEED), SAMPLES)]
    exact = sindy_coefficients(logs, threshold=0.0)
    rated = C != 0
    off = np.median(np.abs(exact - C)[rated] / np.abs(C)[rated])
    yield information("exact speeds of the polynomial: median error of pysindy", 100 * off, "%", "differs across steps")
    vessel, noise, train = reference_vessel(), SmootherNoise.of(reference_vessel()), training_run()
    samples = [smoother_samples(train, vessel, smooth(train, noise))]
    ours, peer = least_squares(samples), sindy_coefficients(samples)
    print(_side_by_side(ours, peer))
    away = np.median(np.abs(peer - ours.C) / ours.se_robust)
    struck = int((peer == 0).sum())
    yield information(
        "structured plant: median |pysindy - regression| in standard errors", away, "", f"{struck} struck"
    )
    models = {"regression": ours.C, "pysindy": peer}
    _, nu = train.samples("true_u_m_s", "true_v_m_s", "true_r_rad_s")
    simulators = [TaylorSimulator(name, c, vessel) for name, c in models.items()]
    for d in divergence_study(simulators, _windows(100), SpeedBox.of(nu)):
        note = f"{d.position_m[9, 1]:.2f} m after 10 s, {d.position_m[29, 1]:.2f} m after 30 s"
        yield information(f"{d.name}: runs of {d.runs} that diverge in 60 s", d.diverged[-1] * d.runs, "", note)


def _side_by_side(ours: TaylorFit, peer: np.ndarray) -> str:
    lines = ["| term | surge | pysindy | sway | pysindy | yaw | pysindy |", "|---|---|---|---|---|---|---|"]
    for j, term in enumerate(TERMS):
        cells = [f"{ours.C[i, j]:.4f} ({ours.se_robust[i, j]:.4f}) | {peer[i, j]:.4f}" for i in range(3)]
        lines.append(f"| C_{term} | {' | '.join(cells)} |")
    return "\n".join(lines)


PARTS = (paper_pipeline, polynomial, pysindy)
