"""Evidence for identification: the structured fit on boats drawn at random, all parameters up to 30 % off."""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import as_completed

import numpy as np
from scipy.stats import beta

from sim.studies.boats.campaign import BoatScore, CampaignFigures, figures, line, one_boat
from sim.studies.boats.lab_priors import BOLLARD, WEIGHED
from tests.evidence.identify.paper import reference_vessel
from tests.evidence.line import Line, at_most, between, exactly, information
from tests.evidence.processes import processes

SEED = 4001
BOATS, FEW = 20, 4
LABS = (WEIGHED, BOLLARD)
PROCESSES = 2


def _one(case: tuple[int, float, float]) -> tuple[BoatScore, ...]:
    return one_boat(reference_vessel(), *case, labs=LABS)


def _campaign(full: bool, uwb_hz: float, sigma_m: float, seed: int) -> list[CampaignFigures]:
    """Figures for each of `LABS`, on the same boats and logs."""
    n, began = BOATS if full else FEW, time.monotonic()
    print(f"  {n} of {BOATS} boats, seeds {seed} to {seed + n - 1}" + ("" if full else "; all with --full"))
    done: list[tuple[BoatScore, ...]] = []
    with processes(PROCESSES) as pool:
        for future in as_completed([pool.submit(_one, (seed + i, uwb_hz, sigma_m)) for i in range(n)]):
            done.append(future.result())
            for score in done[-1]:
                print(f"  [{len(done)}/{n}, {time.monotonic() - began:.0f} s] {line(score)}", flush=True)
    return [figures([scores[i] for scores in done]) for i in range(len(LABS))]


def boats_1_hz(full: bool) -> Iterator[Line]:
    """Structured fit, IMU 30 Hz, UWB 1 Hz 10 cm, 13,840 samples: all parameters +-30 %, one thing measured on land"""
    for found in _campaign(full, 1.0, 0.10, SEED):
        yield from _lines(found, 3.0)


def boats_10_hz(full: bool) -> Iterator[Line]:
    """Structured fit, IMU 30 Hz, UWB 10 Hz 5 cm, 13,840 samples: all parameters +-30 %, one thing measured on land"""
    for found in _campaign(full, 10.0, 0.05, SEED + 100):
        yield from _lines(found, 1.5)


def _lines(found: CampaignFigures, goal: float) -> Iterator[Line]:
    n, lab = len(found.boats), found.boats[0].lab
    worst = f"{n} boats; worst boat's median {100 * found.worst_boat_error:.2f} %"
    yield at_most(f"{lab}: median parameter error", 100 * found.median_error, goal, "%", worst)
    free = 100 * found.scale_free_median_error
    yield information(f"{lab}: the same over the mean gain", free, "%", "what the motion alone shows")
    yield between(f"{lab}: 95 % intervals cover", 100 * found.coverage, 90, 98, "%", _coverage_note(found))
    note = f"of {len(found.boats[0].scale_free_covered)} ratios a boat"
    yield between(f"{lab}: over the mean gain they cover", 100 * found.scale_free_coverage, 90, 98, "%", note)
    z = ", ".join(f"{name} {value:.2f}" for name, value in found.z_rms.items())
    yield information(
        f"{lab}: error over its sigma, rms of all", np.sqrt(np.mean(np.square(list(found.z_rms.values()))))
    )
    print(f"    by parameter: {z}")
    yield exactly(f"{lab}: unstable models", found.unstable, 0, "", f"of {n}")
    loop, median = found.rms_m["filter"], found.median_m["filter"]
    errors = "identified {identified:.3f}, true {true:.3f}, file {file:.2f}, Taylor {taylor:.3g}"
    errors += " and {taylor_smoother:.3g} m"
    note = "rms: " + errors.format(**loop)
    yield at_most(f"{lab}: 30 s open loop over that of the true parameters", found.open_loop_ratio, 1.2, "", note)
    note = "medians: " + errors.format(**median)
    for rival, how in (("taylor", "paper's pipeline"), ("taylor_smoother", "from the smoother")):
        ratio = median["identified"] / median[rival]
        yield at_most(f"{lab}: over Taylor, {how}, rms", loop["identified"] / loop[rival], 1 / 3)
        yield at_most(f"{lab}: over Taylor, {how}, medians", ratio, 1 / 3, "", note)
    for start in ("smoothed", "exact"):
        loop = found.rms_m[start]
        ratio = loop["identified"] / loop["true"]
        yield information(f"{lab}: from {start} states, over true", ratio, "", "rms: " + errors.format(**loop))
    seconds = f"slowest {found.seconds[1]:.1f}; processor {found.cpu_s[0]:.1f} and {found.cpu_s[1]:.1f} s"
    yield information(f"{lab}: time of a fit, two at a time, median", found.seconds[0], "s", seconds)


def _coverage_note(found: CampaignFigures) -> str:
    """One scale moves 16 parameters of a boat together: how many boats have it right says how sure the coverage is."""
    n = len(found.boats)
    hits = sum(boat.covered["M11_kg"] for boat in found.boats)
    low = beta.ppf(0.025, hits, n - hits + 1) if hits else 0.0
    high = beta.ppf(0.975, hits + 1, n - hits) if hits < n else 1.0
    of = len(found.boats[0].covered)
    return (
        f"+-{100 * found.coverage_half:.1f} with boats as the sample; one scale moves 16 of {of} together: right in "
        f"{hits} of {n} boats, 95 % interval of that {100 * low:.0f} to {100 * high:.0f} %"
    )


PARTS = (boats_1_hz, boats_10_hz)
