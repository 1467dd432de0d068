"""The stages of commissioning: what each is about, which manoeuvres it may use, and when it is over.

    signs         one thruster at a time, for a moment, then to and fro, until every wiring fault is ruled out or found
    delays        dead time and lag of the thrusters
    hull          mass, damping, gains
    sensors       places of tag and IMU, the tag's latency, the compass
    surroundings  current and wind of the day, so that they are not taken for the boat
    proof         a manoeuvre that no fit sees: it decides which file to believe

A stage flies what is worth most of `about`, by the expected information of each manoeuvre on the present belief, and is
over when a minute more would tell less than `LEAST_NATS_PER_MIN` of each of its parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace

from companion.core.configuration.site_file import Site
from companion.core.configuration.tables import ConfigError
from companion.core.configuration.vessel_file import VesselFile
from companion.core.excitation.file import Excitation, Idle, Multisine, Segment, Zigzag
from companion.core.excitation.signal import axis_reach, signals
from sim.commission.belief import CARE, BoatBelief
from sim.commission.signs import CONFIRMED, PULSE_S, distrusted, signs_segments
from sim.fitting.engine.parameters import HULL
from sim.fitting.excite.design import CandidateManoeuvre, candidates, choose, gain_nats
from sim.fitting.excite.information import Knowledge, indices_of_interest

LEAST_NATS_PER_MIN = 0.2
"""Of each parameter of the stage, in the mean: a sigma that falls by a fifth in a minute; assumed."""
FLIGHT_S = 120.0
"""About so long a flight: then it is fitted, and the next is designed on what is known by then; assumed."""
PROOF = ("zig-zag", "multisine")
"""Manoeuvres of the library that prove a model: all axes, none of them alone."""


@dataclass(frozen=True)
class Stage:
    """One stage. `about`: names of its parameters, by how they begin; `kinds`: names of manoeuvres, empty: all."""

    name: str
    why: str
    about: tuple[str, ...] = ()
    kinds: tuple[str, ...] = ()
    most: int = 1

    def indices(self, known: Knowledge) -> np.ndarray:
        """Its parameters, as indices of w; without any of its own those that manoeuvres are designed for."""
        if not self.about:
            return indices_of_interest(known.vessel)
        names = known.parameters.names
        return np.flatnonzero([any(name.startswith(head) for head in self.about) for name in names])


SIGNS = Stage("signs", "which thruster pushes where")
PROVEN = Stage("proof", "a manoeuvre that no fit sees")
STAGES = (
    SIGNS,
    Stage("delays", "dead time and lag of the thrusters", ("dead_time", "lag"), ("pulses", "stop and reverse",
          "sway reversals", "yaw reversals"), 1),
    Stage("hull", "mass, damping, gains", (*HULL, "gain_"), (), 4),
    Stage("sensors", "places of tag and IMU, the tag's latency, the compass", ("tag_", "imu_", "hard_iron_", "uwb_"),
          ("spin both ways", "circle to starboard", "circle to port", "sideways turns"), 2),
    Stage("surroundings", "current and wind of the day", ("current_", "wind_"), ("idle", "coast down", "strafe"), 1),
    PROVEN,
)  # fmt: skip


@dataclass(frozen=True)
class Proposal:
    """What a stage would fly next: the plan, what it would tell in nats, its minutes. No plan: why not.

    `vessel`: the file to fly it by; None: the one that is believed.
    """

    plan: Excitation | None
    nats: float = 0.0
    minutes: float = 0.0
    why: str = ""
    vessel: VesselFile | None = None


def propose(
    stage: Stage,
    belief: BoatBelief,
    library: Excitation,
    site: Site,
    left_s: float,
    flown: int,
    yielded: float = 1.0,
    say: Callable[[str], None] = lambda _text: None,
) -> Proposal:
    """The next flight of a stage. `flown`: flights of it so far; `left_s`: time that is left for it.

    Of the proof only flights that were done count. `yielded`: what flights so far told, over what was expected: a boat
    is not quite its model.
    """
    if stage is SIGNS:
        return _signs(belief, library, flown, left_s)
    if flown >= stage.most:
        return Proposal(None, why="as often as this stage may")
    if stage is PROVEN:
        return _proof(belief, library)
    return _most_informative(stage, belief, library, site, left_s, yielded, say)


def _signs(belief: BoatBelief, library: Excitation, flown: int, left_s: float) -> Proposal:
    if belief.signs_known and flown >= CONFIRMED:
        return Proposal(None, why="signs and sides are known")
    if belief.astray and flown >= CONFIRMED:
        return Proposal(None, why=f"{belief.astray}: nothing can be flown before that is right")
    if flown >= len(PULSE_S):
        return Proposal(None, why="the longest pulses do not tell signs and sides")
    vessel = belief.first
    # No way back under power: until signs are known, it might be the way out.
    segments = signs_segments(vessel, flown)
    plan = replace(library, name=SIGNS.name, segments=segments, caution=max(library.caution, CARE[1]), homing=False)
    seconds = sum(signal.duration_s for signal in signals(plan, vessel, name=SIGNS.name))
    if seconds > left_s:
        return Proposal(None, why=f"no time left: the next flight takes {seconds:.0f} s; give more --minutes")
    return Proposal(plan, minutes=seconds / 60, vessel=distrusted(vessel))


def _proof(belief: BoatBelief, library: Excitation) -> Proposal:
    sideways = axis_reach(belief.vessel)[1].min() > 0
    own = (scaled(s, belief) for s in library.segments if s.name in PROOF)
    segments = tuple(replace(s, Y=0.0) if isinstance(s, Multisine) and not sideways else s for s in own)
    return Proposal(replace(careful(library, belief), name=PROVEN.name, segments=segments), minutes=1.5)


def _most_informative(
    stage: Stage,
    belief: BoatBelief,
    library: Excitation,
    site: Site,
    left_s: float,
    yielded: float,
    say: Callable[[str], None],
) -> Proposal:
    segments = tuple(scaled(s, belief) for s in library.segments if not stage.kinds or s.name in stage.kinds)
    shelf = replace(careful(library, belief), name=stage.name, segments=segments)
    try:
        usable, _ = candidates(shelf, belief.vessel, site, say, belief.known.settings)
    except ConfigError as error:
        return Proposal(None, why=" ".join(str(error).split("\n")))
    about = stage.indices(belief.known)
    chosen = choose(belief.known, usable, min(FLIGHT_S, left_s) / 1.4, about=about)
    if not chosen:
        return Proposal(None, why="no time left")
    expected, seconds = _told(belief.known, chosen, about)
    nats = expected * yielded
    if nats / (seconds / 60) < LEAST_NATS_PER_MIN * len(about):
        return Proposal(None, nats, seconds / 60, f"{seconds / 60:.1f} minutes more would tell {nats:.1f} nats")
    return Proposal(replace(shelf, segments=tuple(c.segment for c in chosen)), nats, seconds / 60)


def check_library(library: Excitation, *, name: str) -> None:
    """Raises ConfigError where no manoeuvre is there that can prove a file."""
    if not {s.name for s in library.segments} & set(PROOF):
        proofs = " or ".join(f'"{proof}"' for proof in PROOF)
        raise ConfigError(f"{name}: segments: none has the name {proofs}, with which the new file is proven")


def _told(known: Knowledge, chosen: Sequence[CandidateManoeuvre], about: np.ndarray) -> tuple[float, float]:
    """Expected gain [nats] and duration [s] of manoeuvres one after the other."""
    after = known
    for one in chosen:
        after = after.with_information(one.information)
    return gain_nats(known, after, about), sum(one.duration_s for one in chosen)


def careful(library: Excitation, belief: BoatBelief) -> Excitation:
    """The library with the caution that the belief asks for, and no less than it has itself."""
    return replace(library, caution=max(library.caution, belief.caution))


def scaled(segment: Segment, belief: BoatBelief) -> Segment:
    """The segment as strong as the belief permits: whole where the file is right, weaker where it may be off."""
    share = CARE[0] / belief.caution
    if isinstance(segment, Idle):
        return segment
    if isinstance(segment, Zigzag):
        return replace(segment, X=segment.X * share, N=segment.N * share)
    if isinstance(segment, Multisine):
        return replace(segment, X=segment.X * share, Y=segment.Y * share, N=segment.N * share)
    levels = tuple(level * share for level in segment.levels)
    return replace(segment, levels=levels)
