"""C/S Enterprise I identified from its recordings and judged on held-out data. Results: docs/cse1.md.

    blocks       fit the even 60 s blocks of random_run1, predict the odd ones
    across       fit one joystick run, predict the other, and dptest (station keeping, another day, another setting)
    trimmed      the same, with the blades' neutral (four trims, nothing else) of the other day from its first third

All models start from the same measured states under the same commands; errors are root mean squares over windows that
begin every 5 s. No choice made here depends on the predicted data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.logs.readers.read_run import read_run
from companion.logs.runs.run import Run
from companion.logs.runs.splits import Interval, alternate, before, part, parts
from sim.fitting.engine.parameters import Parameters
from sim.fitting.engine.smoothing import SmootherNoise, smooth
from sim.fitting.engine.thrust.fitted import adjustable, pitch_maps
from sim.fitting.identify.result import FitResult, fit_structured
from sim.fitting.identify.structured_fit import FitSettings
from sim.fitting.identify.vessel_out import identified_vessel
from sim.fitting.taylor.pipeline import smoother_samples
from sim.fitting.taylor.regression import least_squares
from sim.fitting.validate.models import ConstantVelocity, TaylorSimulator, VesselSimulator, ZeroVelocity
from sim.fitting.validate.protocol import CHANNELS, Simulator
from sim.fitting.validate.scores import SpeedBox, score
from sim.fitting.validate.windows import HeldOutWindows, cut_held_out, reference_motion

RUNS = ("random_run1", "random_run3", "dptest")
BLOCK_S = 60.0
HORIZONS_S = (5, 10, 20)
STRUCTURED, CRUDE, TAYLOR, TAYLOR_SAME = "structured", "crude", "Taylor", "Taylor, forces as identified"
BASELINES = (ConstantVelocity(), ZeroVelocity())
DATE = "in the study"


@dataclass(frozen=True)
class Errors:
    """Rms errors by model, (horizons, channels); inf where a run is not finite. `count` (horizons,): windows."""

    title: str
    rms: dict[str, np.ndarray]
    count: np.ndarray

    def of(self, model: str, channel: str, horizon_s: int) -> float:
        """Rms error of one channel [m, rad, m/s, m/s, rad/s]."""
        return float(self.rms[model][HORIZONS_S.index(horizon_s), CHANNELS.index(channel)])

    def best_baseline(self, channel: str, horizon_s: int) -> float:
        """The smaller error of the two baselines."""
        return min(self.of(model.name, channel, horizon_s) for model in BASELINES)

    def ratio(self, model: str, channel: str, horizon_s: int) -> float:
        """Error over that of the better baseline."""
        return self.of(model, channel, horizon_s) / self.best_baseline(channel, horizon_s)


def recording(folder: Path, name: str) -> Run:
    """One of `RUNS` from the folder of the recordings. Raises OSError, RunError."""
    return read_run(folder / f"{name}.csv.gz")


def crude(vessel: VesselFile) -> FitSettings:
    """Settings of a crude model: trims and azimuths as in the file, thrust proportional to pitch, no N_ur damping."""
    names = [vessel.thrusters[i].name for i in adjustable(vessel)]
    straight = {f"azimuth_{name}_deg": (None, 0.0) for name in names}
    neutral = {f"trim_{name}_us": (None, 0.0) for name in names}
    curves = {f"curve_{name}": (0.0, 0.0) for name in pitch_maps(vessel)}
    return FitSettings(overrides={**straight, **neutral, **curves, "N_ur_N_s2": (0.0, 0.0)})


def models(runs: Sequence[Run], vessel: VesselFile, *, session: bool) -> tuple[list[Simulator], FitResult]:
    """Structured, crude and Taylor models fitted to `runs`. `session`: with fitted trims, to predict the same day."""
    fit = fit_structured(runs, vessel)
    identified = identified_vessel(vessel, fit, date=DATE, session=session)
    first = identified_vessel(vessel, fit_structured(runs, vessel, crude(vessel)), date=DATE)
    same_day = identified_vessel(vessel, fit, date=DATE, session=True)
    smoothed = [smooth(run, SmootherNoise.of(vessel)) for run in runs]
    taylor = {
        name: least_squares([smoother_samples(r, v, s) for r, s in zip(runs, smoothed, strict=True)]).C
        for name, v in ((TAYLOR, vessel), (TAYLOR_SAME, same_day))
    }
    simulators: list[Simulator] = [VesselSimulator(STRUCTURED, identified), VesselSimulator(CRUDE, first)]
    simulators += [TaylorSimulator(TAYLOR, taylor[TAYLOR], vessel)]
    simulators += [TaylorSimulator(TAYLOR_SAME, taylor[TAYLOR_SAME], identified)]
    return simulators, fit


def trimmed(vessel: VesselFile, run: Run) -> VesselFile:
    """`vessel` with its trims, and nothing else, fitted to `run`."""
    names = Parameters(vessel).names
    held = {name: (None, 0.0) for name in names if not name.startswith("trim_")}
    return identified_vessel(
        vessel, fit_structured([run], vessel, FitSettings(overrides=held)), date=DATE, session=True
    )


def errors_of(title: str, simulators: Sequence[Simulator], windows: HeldOutWindows) -> Errors:
    """Errors of all models and both baselines on the windows."""
    box, rms, count = SpeedBox.of(windows.truth[..., 3:]), {}, np.zeros(0)
    for model in (*simulators, *BASELINES):
        one, _ = score(model, windows, box)
        at = [one.horizons_s.index(h) for h in HORIZONS_S]
        rms[model.name] = np.column_stack([one.rms[channel][at] for channel in CHANNELS])
        count = one.count[at]
    return Errors(title, rms, count)


def held_out(run: Run, vessel: VesselFile, inside: Sequence[Interval] | None = None) -> HeldOutWindows:
    """Windows as `validate` cuts them."""
    volts = vessel.propulsion.nominal_voltage_V
    return cut_held_out(run, reference_motion(run, SmootherNoise.of(vessel)), volts, inside=inside)


def blocks(run: Run, vessel: VesselFile) -> tuple[Errors, FitResult]:
    """Fit on even blocks, errors on odd ones."""
    fitted, out = alternate(run, BLOCK_S)
    simulators, fit = models(parts(run, fitted), vessel, session=True)
    return errors_of(f"{run.meta.source}, odd blocks", simulators, held_out(run, vessel, out)), fit


def across(train: Run, tests: Sequence[Run], vessel: VesselFile) -> tuple[list[Errors], FitResult]:
    """Fit on one run, errors on others."""
    simulators, fit = models([train], vessel, session=False)
    return [
        errors_of(f"{train.meta.source} -> {test.meta.source}", simulators, held_out(test, vessel)) for test in tests
    ], fit


def across_trimmed(found: FitResult, test: Run, vessel: VesselFile) -> Errors:
    """Errors on the last two thirds of `test`; "structured" has the trims of the first third."""
    t_s = test.table["t_s"]
    begin, end = float(t_s[0]), float(t_s[-1])
    third = begin + (end - begin) / 3
    other_day = identified_vessel(vessel, found, date=DATE)
    simulators = [
        VesselSimulator(STRUCTURED, trimmed(other_day, part(test, begin, before(third)))),
        VesselSimulator(f"{STRUCTURED}, trims of the file", other_day),
    ]
    windows = held_out(test, vessel, [(third, end)])
    return errors_of(f"{test.meta.source}, last two thirds", simulators, windows)
