"""Ghosts: open-loop simulations along a whole log under the logged commands, reset to the measured state every T s.

    x_hat(t) = x(t_k) + integral of x_dot of the model from t_k to t,   t_k = t_0 + k T <= t,   x(t_k): smoothed state

A ghost departs from the boat by the model error of at most T seconds. All models share one reference, smoothed with the
base file's sensors, so the ghosts of two vessel files start each piece at the same state and may be compared.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.logs.runs.apply_sensor_errors import calibrated
from companion.logs.runs.run import Run
from companion.logs.runs.splits import recording_intervals
from sim.fitting.engine.smoothing import RATE_HZ, SmootherNoise
from sim.fitting.engine.split import JobError, NamedLog, usable
from sim.fitting.validate.models import VesselSimulator
from sim.fitting.validate.protocol import CHANNELS, Commands, Simulator
from sim.fitting.validate.scores import errors, simulated
from sim.fitting.validate.windows import HeldOutWindows, Reference, cut_held_out, reference_motion

SHORTEST_S = 1.0
"""Shortest last piece."""


@dataclass(frozen=True)
class Ghost:
    """Simulated pieces of one model: `x` (m, k, 6) at the instants of `Overlay.t_s`; `error` (m, k, 5) by `CHANNELS`.

    NaN beyond the end of a piece; the error is infinite where the simulation is not finite.
    """

    name: str
    x: np.ndarray
    error: np.ndarray

    def rms(self, age_s: float) -> dict[str, float]:
        """Rms error `age_s` after the start of the pieces, by channel [m, rad, m/s, m/s, rad/s]; NaN if none lasts."""
        e = self.error[:, round(age_s * RATE_HZ)]
        e = e[~np.isnan(e[:, 0])]
        with np.errstate(over="ignore"):
            values = np.sqrt((e**2).mean(axis=0)) if len(e) else np.full(len(CHANNELS), np.nan)
        return dict(zip(CHANNELS, values.tolist(), strict=True))


@dataclass(frozen=True)
class Overlay:
    """m pieces of `every_s`: `t_s` (m, k) on the run's clock, `truth` (m, k, 6) reference motion, and the ghosts."""

    every_s: float
    source: str
    t_s: np.ndarray
    truth: np.ndarray
    ghosts: tuple[Ghost, ...]

    @property
    def ages_s(self) -> tuple[float, ...]:
        """Ages at which errors are reported: a tenth, half and all of a piece [s]."""
        return tuple(round(share * self.every_s, 1) for share in (0.1, 0.5, 1.0))


@dataclass(frozen=True)
class GhostModel:
    """A vessel file as a model for commands in another file's order of thrusters: a diagnosis may swap names.

    `order`: for each of its own thrusters the column in the commands.
    """

    name: str
    vessel: VesselFile
    order: tuple[int, ...]

    @classmethod
    def of(cls, name: str, vessel: VesselFile, base: VesselFile) -> GhostModel:
        """The model `vessel` for commands in the order of `base`. JobError if their thrusters have other names."""
        names, own = [t.name for t in base.thrusters], [t.name for t in vessel.thrusters]
        if sorted(names) != sorted(own):
            raise JobError(
                f"{name}: the thrusters of {vessel.name} are {', '.join(own)}, but the log's are {', '.join(names)}: "
                "another boat's vessel file"
            )
        return cls(name, vessel, tuple(names.index(n) for n in own))

    def simulate(self, x0: np.ndarray, commands: Commands) -> np.ndarray:
        """As `Simulator`."""
        order = list(self.order)
        own = replace(commands, pwm_us=commands.pwm_us[..., order], before_us=commands.before_us[..., order])
        return VesselSimulator(self.name, self.vessel).simulate(x0, own)


def overlay(
    run: Run,
    vessel: VesselFile,
    models: Sequence[Simulator],
    *,
    every_s: float,
    say: Callable[[str, float], None] = lambda _text, _share: None,
) -> Overlay:
    """Ghosts of `models` for the whole run; `vessel`: the file whose sensors measured it. `say(text, share)`: progress.

    Raises JobError, RunError or ValueError where the run lacks what a simulation needs, or is too short.
    """
    run = calibrated(usable(NamedLog(run.meta.source, run), vessel).run, vessel)
    say("what the boat did", 0.0)
    ref = reference_motion(run, SmootherNoise.of(vessel))
    windows = _pieces(run, ref, vessel, every_s)
    t_s = windows.start_s[:, None] + np.arange(windows.truth.shape[1]) / RATE_HZ
    ghosts = []
    for i, model in enumerate(models):
        say(model.name, 0.5 + 0.5 * i / len(models))
        x = np.where(np.isnan(windows.truth), np.nan, simulated(model, windows))
        ghosts.append(Ghost(model.name, x, errors(x, windows.truth)))
    say("", 1.0)
    return Overlay(every_s, ref.source, t_s, windows.truth, tuple(ghosts))


def _pieces(run: Run, ref: Reference, vessel: VesselFile, every_s: float) -> HeldOutWindows:
    """Pieces of what was recorded: none across a pause, in which nobody knows what was commanded."""
    volts, inside = vessel.propulsion.nominal_voltage_V, recording_intervals(run)
    return cut_held_out(
        run, ref, volts, horizon_s=every_s, stride_s=every_s, shortest_s=min(SHORTEST_S, every_s), inside=inside
    )
