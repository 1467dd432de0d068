"""Planning of the manoeuvre that separates confused causes, by its expected information.

Each segment of an excitation library is flown by the vessel file's own boat (`excite.nominal`) and linearised with
the columns of the diagnosis at the log's rates and noise. Runs share no nodes, so Hessians add:

    H_after = H_logs + sum of H_segment,   nats(a, b) from H_after as in `identifiability`

Greedy: the segment that raises the worst pair most per second is added until all pairs are separated. The nats of the
plan are then computed from a flight of the whole plan.

Assumptions: the boat is the file's, current and wind continue, and the water is a square of at least `LEAST_WATER_M`
(assumed) round the log's positions unless a site is stated.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace

from companion.core.configuration.site_file import Site
from companion.core.configuration.tables import ConfigError
from companion.core.configuration.vessel_file import VesselFile
from companion.core.excitation.file import Excitation, Segment, Steps
from companion.logs.runs.run import Run
from sim.fitting.diagnose.catalogue.effect import Effect, parameter_slices
from sim.fitting.diagnose.posterior.fit import PosteriorFit
from sim.fitting.diagnose.posterior.physics import EffectPhysics
from sim.fitting.diagnose.selection.candidate_score import DECISIVE_NATS, LEAST_EVIDENCE_NATS
from sim.fitting.diagnose.selection.identifiability import pairwise_evidence
from sim.fitting.diagnose.vessel_edits.public_form import family
from sim.fitting.engine.noise import STATE, L, Noise
from sim.fitting.excite.information import true_nodes
from sim.fitting.excite.nominal import fly_nominal

ENOUGH = (
    2 * DECISIVE_NATS
)  # estimated: the real boat is not quite its model, and noise moves the evidence by a few nats
LONGEST_S = 600.0
ENDLESS = 3.0  # copies of the whole library: a pair that it does not separate is out of reach of any plan
MOST = 3  # most pairs in a plan
LEAST_WATER_M = 24.0
SHORTEST_S = 5.0  # shortest flight that is used
WINDOW_S = 1.0
STEP_NS = 50_000_000  # time step of the plant: half a tick is fine enough for planning
AFTER_S = 60.0  # time from the end of the logs to the manoeuvre; assumed
SLOW = ("clock_drift", "turning_current", "voltage_exponent")
TEN_MINUTES = Steps(
    name="ten minutes to and fro", why="what grows with time", X=0.16, levels=(1.0, -1.0) * 50, hold_s=6.0
)
ANYTHING = 30.0  # factor on the usual biases of a log that makes them practically unknown
NOTHING = ""  # the rival "nothing is there"
ConfusedPairs = Sequence[tuple[str, str, float]]
"""Truth, rival or `NOTHING`, nats of the logs."""


@dataclass(frozen=True)
class ManoeuvrePlan:
    """A planned manoeuvre.

    excitation     what to fly; None where nothing would help
    pairs          truth, rival, nats of the logs, nats with the manoeuvre
    unreachable    the same of pairs that no plan separates, with the nats of `ENDLESS` copies of the library
    """

    excitation: Excitation | None
    duration_s: float
    pairs: tuple[tuple[str, str, float, float], ...]
    unreachable: tuple[tuple[str, str, float, float], ...]


@dataclass(frozen=True)
class _FlownSegment:
    """One segment with its flight; H (P, P) with unknown biases: information from them counts once, for the plan."""

    segment: Segment
    run: Run
    H: np.ndarray

    @property
    def duration_s(self) -> float:
        return self.run.duration_s


class ManoeuvrePlanner:
    """Plans for the logs of `fit`, with their Hessian H (P, P) of all parameters, active effects and noise."""

    def __init__(
        self, fit: PosteriorFit, H: np.ndarray, active: frozenset[str], noise: Noise, site: Site | None = None
    ):
        self.fit, self.active, self.noise = fit, active, noise
        self._H = H
        self._site = site or _fence(fit)
        self._vessel = at_rates(fit)

    def plan(self, library: Excitation, confused: ConfusedPairs) -> ManoeuvrePlan:
        """Manoeuvre for the first `MOST` of the `confused` pairs that the library can separate."""
        # 1. Flights of all segments; upper limit of the nats of each pair.
        names = {n for a, b, _ in confused for n in (a, b)}
        effects = [e for e in self.fit.effects if e.always_free or e.id in self.active or e.name in names]
        candidates, H = self._candidates(library, effects, names), self._information_of(effects)
        once = (
            self.information(max(candidates, key=lambda c: c.duration_s).run, effects)
            if candidates
            else np.zeros_like(H)
        )
        limit = self._nats(H + once + ENDLESS * sum((c.H for c in candidates), np.zeros_like(H)), effects, confused)
        helped = [pair for pair, most in zip(confused, limit, strict=True) if most >= nats_needed(pair[1])][:MOST]
        beyond = tuple((*p, float(most)) for p, most in zip(confused, limit, strict=True) if most < nats_needed(p[1]))
        # 2. Greedy selection; flight and nats of the whole plan.
        segments = self._select_segments(candidates, H + once, effects, helped) if helped else []
        excitation = replace(library, name="manoeuvre", segments=tuple(segments))
        run = self._flown(excitation) if segments else None
        if run is None:
            return ManoeuvrePlan(None, 0.0, (), beyond)
        after = self._nats(H + self.information(run, effects), effects, helped)
        pairs = tuple((*pair, float(then)) for pair, then in zip(helped, after, strict=True))
        helps = any(then >= nats_needed(b) for _, b, _, then in pairs)
        return ManoeuvrePlan(excitation if helps else None, run.duration_s, pairs, beyond)

    def _select_segments(
        self, candidates: Sequence[_FlownSegment], H: np.ndarray, effects: Sequence[Effect], confused: ConfusedPairs
    ) -> list[Segment]:
        """Segments added one at a time until all pairs have `ENOUGH` nats or `LONGEST_S` is used up."""
        selected, now, left_s = [], self._nats(H, effects, confused), LONGEST_S
        while now.min() < ENOUGH and (fits := [c for c in candidates if c.duration_s <= left_s]):
            worth = [_worth(now, self._nats(H + c.H, effects, confused)) / c.duration_s for c in fits]
            best = fits[int(np.argmax(worth))]
            if max(worth) <= 0:
                break
            selected.append(best.segment)
            H, left_s = H + best.H, left_s - best.duration_s
            now = self._nats(H, effects, confused)
        return selected or [c.segment for c in candidates[:1]]

    def _candidates(self, library: Excitation, effects: Sequence[Effect], names: set[str]) -> list[_FlownSegment]:
        slow = any(family(name) in SLOW for name in names)
        flown = []
        for segment in (*library.segments, *((TEN_MINUTES,) if slow else ())):
            run = self._flown(replace(library, segments=(segment,), name=segment.name))
            if run is not None:
                flown.append(_FlownSegment(segment, run, self.information(run, effects, own=ANYTHING)))
        return flown

    def _flown(self, excitation: Excitation) -> Run | None:
        """The log of the file's own boat under `excitation`; None where it cannot fly it to its end."""
        try:
            flown = fly_nominal(excitation, self._vessel, self._site, limit_s=2 * LONGEST_S, step_ns=STEP_NS)
        except ConfigError:
            return None
        return _commanded(flown.run) if flown.done and flown.duration_s >= SHORTEST_S else None

    def information(self, run: Run, effects: Sequence[Effect], own: float = 1.0) -> np.ndarray:
        """Hessian (P, P) of a simulated `run`, whose states are known, in the parameters of `effects`.

        `own`: factor on the sigmas of the run's own biases of gyro and accelerometers.
        """
        a_x, a_y, r = self.noise.bias
        noise = dataclasses.replace(self.noise, bias=(own * a_x, own * a_y, own * r))
        physics, log = EffectPhysics([run], self.fit.physics.vessel, WINDOW_S), self.fit.physics
        wait = float(log.clock_s.max()) + AFTER_S - float(physics.clock_s.min())
        physics.clock_s, physics.fix_clock_s = physics.clock_s + wait, physics.fix_clock_s + wait
        physics.centre_m, physics.middle_s = log.centre_m, log.middle_s
        fit = PosteriorFit(physics, effects, noise)
        z = np.zeros((physics.windows.size[0], L))
        z[:, STATE] = true_nodes(physics.windows, run)
        return fit.reduced(fit.point({}, z, effects), effects).H

    def _nats(self, H: np.ndarray, effects: Sequence[Effect], confused: ConfusedPairs) -> np.ndarray:
        names = [n for a, b, _ in confused for n in (a, b) if n]
        evidence = pairwise_evidence(self.fit, H, self.active, effects, names)
        index = {n: i for i, n in enumerate(evidence.names)}
        return np.array(
            [evidence.nothing[index[a]] if b == NOTHING else evidence.nats[index[a], index[b]] for a, b, _ in confused]
        )

    def _information_of(self, effects: Sequence[Effect]) -> np.ndarray:
        at = parameter_slices(self.fit.effects)
        index = np.concatenate([np.arange(at[e.id].start, at[e.id].stop) for e in effects])
        return self._H[np.ix_(index, index)]


def nats_needed(rival: str) -> float:
    """Nats that separate a cause from `rival`; from `NOTHING`, the nats from which it is named."""
    return LEAST_EVIDENCE_NATS if rival == NOTHING else DECISIVE_NATS


def _worth(now: np.ndarray, then: np.ndarray) -> float:
    """Gain of the worst pair plus a tenth of the sum of all gains, each pair capped at `ENOUGH` [nats]."""
    gain = np.minimum(then, ENOUGH) - np.minimum(now, ENOUGH)
    return float(np.minimum(then, ENOUGH).min() - now.min() + 0.1 * gain.sum())


def _fence(fit: PosteriorFit) -> Site:
    """A square fence round the positions of the logs."""
    places = fit.physics.windows.fixes.place_m
    middle, reach = places.mean(axis=0), np.ptp(places, axis=0).max() / 2
    half = max(float(reach), LEAST_WATER_M / 2)
    fence = tuple((float(middle[0] + n * half), float(middle[1] + e * half)) for n, e in
                  ((-1, -1), (1, -1), (1, 1), (-1, 1)))  # fmt: skip
    return Site(name="water of the logs", lat_deg=0.0, lon_deg=0.0, fence=fence, source="assumed")


def at_rates(fit: PosteriorFit) -> VesselFile:
    """The vessel with the sensor rates of the fitted logs; the IMU's is that of its fastest channel."""
    vessel, w = fit.physics.vessel, fit.physics.windows
    known = [w.t_s[:, :-1][channel] for channel in np.moveaxis(np.isfinite(w.y), 2, 0)]
    step, fix = min(_interval(t) for t in known if len(t) > 1), _interval(w.fixes.t_s)
    s = vessel.sensors
    return replace(
        vessel,
        sensors=replace(s.with_position(rate_Hz=1 / fix), imu=replace(s.imu, rate_Hz=1 / step)),
    )


def _interval(t_s: np.ndarray) -> float:
    """Median time between samples of all logs, stacked one after the other [s]."""
    gaps = np.diff(t_s)
    return float(np.median(gaps[gaps > 0]))


def _commanded(run: Run) -> Run:
    """`run` from its first command on: pulse widths before it are unknown."""
    held = [f"pwm_{name}" for name in run.thrusters]
    return Run(run.table.drop_nulls(held), run.meta)
