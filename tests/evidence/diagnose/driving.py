"""Evidence for diagnosis: ten boats with something wrong, diagnosed from two logs, then driven with what was found."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace

from companion.boat.load_run import EXAMPLES, load_setup
from companion.core.configuration.vessel_file import Damping, VesselFile
from sim.studies.driving.diagnosed import GOALS, LOG_S, DiagnosedBoat, Trip, imperfect, mended, pooled, trips
from sim.world.teleop_log import teleop_logs
from tests.evidence.line import Line, at_least, exactly, information
from tests.evidence.processes import processes

SEED = 5101
FIRST_MISSION, MISSIONS = 5201, 2
PROCESSES = 2
NAMES = ("base", "refitted", "causes", "extended")
"""Vessel files. `causes`: the extended one without what it says of its own error: the filter goes by its tuning."""
FEW = ("current", "reversed", "heading")


def _thruster(vessel: VesselFile, name: str, gain: float) -> VesselFile:
    """One thruster's gain (or, by the name "", all) times `gain`."""
    changed = tuple(replace(t, gain=t.gain * gain) if name in ("", t.name) else t for t in vessel.thrusters)
    return replace(vessel, thrusters=changed)


def _swapped(vessel: VesselFile, one: str, other: str) -> VesselFile:
    """The command called `one` drives what stands where `other` should, and the other way round."""
    there = {t.name: t for t in vessel.thrusters}
    swap = {one: other, other: one}
    changed = [
        replace(there[swap[t.name]], name=t.name, channel=t.channel) if t.name in swap else t for t in vessel.thrusters
    ]
    return replace(vessel, thrusters=tuple(changed))


def _term(vessel: VesselFile, name: str, **numbers: float) -> VesselFile:
    return replace(vessel, terms={**vessel.terms, name: {**numbers, "source": "evidence"}})


def _imu(vessel: VesselFile, **more: float) -> VesselFile:
    imu = vessel.sensors.imu
    added = {k: getattr(imu, k) + v for k, v in more.items()}
    return replace(vessel, sensors=replace(vessel.sensors, imu=replace(imu, **added)))


def _late(vessel: VesselFile, more_s: float) -> VesselFile:
    uwb = vessel.sensors.uwb
    return replace(vessel, sensors=replace(vessel.sensors, uwb=replace(uwb, latency_s=uwb.latency_s + more_s)))


def _slow_link(vessel: VesselFile, more_s: float) -> VesselFile:
    p = vessel.propulsion
    return replace(vessel, propulsion=replace(p, dead_time_s=p.dead_time_s + more_s))


def _fouled(vessel: VesselFile, share: float) -> VesselFile:
    d = vessel.damping
    grown = {k: (1 + share) * getattr(d, k) for k in d.__struct_fields__ if k != "source"}
    return replace(vessel, damping=Damping(**grown, source=d.source))


@dataclass(frozen=True)
class Wrong:
    """What is wrong with a boat. `why`: why so large; `cause`: what it is called in findings."""

    cause: str
    why: str
    edit: Callable[[VesselFile], VesselFile]


EFFECTS: Mapping[str, Wrong] = {
    "current": Wrong(
        "current",
        "0.12 m/s towards 60 deg: a quarter of the mission's 0.5 m/s, as an inflow or a breeze makes in a pond",
        lambda v: _term(v, "current", V_c_m_s=0.12, beta_c_deg=60.0),
    ),
    "wind": Wrong(
        "wind",
        "6 m/s from 300 deg, Beaufort 4: 5.6 N abeam, as much as the drag at 0.5 m/s",
        lambda v: _term(v, "wind", V_w_m_s=6.0, beta_w_deg=300.0),
    ),
    "weak": Wrong(
        "thruster_gain:front_starboard",
        "one thruster at 70 %: weed or a chipped propeller",
        lambda v: _thruster(v, "front_starboard", 0.7),
    ),
    "reversed": Wrong(
        "thruster_gain:rear_port",
        "two motor leads of one thruster changed when its ESC was replaced",
        lambda v: _thruster(v, "rear_port", -1.0),
    ),
    "swapped": Wrong(
        "swapped_pair:front_port+front_starboard",
        "plugs of neighbouring outputs, 9 and 10, changed",
        lambda v: _swapped(v, "front_port", "front_starboard"),
    ),
    "slow_link": Wrong(
        "dead_time",
        "commands 0.2 s later, 0.3 s in all: two ticks of control, a busy telemetry radio",
        lambda v: _slow_link(v, 0.2),
    ),
    "loss": Wrong(
        "common_loss",
        "all thrusters at 70 %: other propellers, or a current limit",
        lambda v: _thruster(v, "", 0.7),
    ),
    "heading": Wrong(
        "heading_offset",
        "compass 5 deg off, as mounted by eye: 1 m to the side in 12 m",
        lambda v: _imu(v, heading_offset_rad=math.radians(5.0)),
    ),
    "late_uwb": Wrong(
        "uwb_latency",
        "positions 0.25 s older, 0.33 s in all: a tag that averages; 0.12 m at 0.5 m/s",
        lambda v: _late(v, 0.25),
    ),
    "fouled": Wrong(
        "hull_fouling",
        "60 % more drag in every direction: a season's growth",
        lambda v: _fouled(v, 0.6),
    ),
}
"""Chosen, with their sizes, before any of it was run: the effects of the catalogue that a crew meets and that move the
boat or what it believes of itself by more than the main job's goals allow; each family at least once."""


def diagnosed(name: str) -> tuple[str, VesselFile, DiagnosedBoat]:
    """The true boat of an effect, and what two logs of 300 s say of it. Its seed: of the place in the table."""
    base, seed = load_setup(EXAMPLES / "aritra.toml").pilot.vessel, SEED + 10 * list(EFFECTS).index(name)
    true = EFFECTS[name].edit(imperfect(base, np.random.default_rng(seed)))
    found = mended(teleop_logs(true, base, (seed + 1, seed + 2), LOG_S), base)
    return name, true, found


Case = tuple[str, str, VesselFile, VesselFile, tuple[int, ...]]


def _drive(case: Case) -> tuple[str, list[Trip]]:
    name, belief, true, believed, seeds = case
    return name, trips(true, believed, load_setup(EXAMPLES / "aritra.toml").pilot, seeds, name=belief)


def driving(full: bool) -> Iterator[Line]:
    """Diagnosed from two logs of 300 s, UWB 1 Hz 10 cm, then the main job's mission in the true boat, NMPC"""
    names, began = tuple(EFFECTS) if full else FEW, time.monotonic()
    seeds = tuple(range(FIRST_MISSION, FIRST_MISSION + MISSIONS))
    print(f"  {len(names)} of {len(EFFECTS)} effects, boats from seed {SEED}, {MISSIONS} missions each from {seeds[0]}")
    runs: dict[tuple[str, str], list[Trip]] = {}
    found: dict[str, DiagnosedBoat] = {}
    with processes(PROCESSES) as pool:
        cases: list[Case] = []
        for future in as_completed([pool.submit(diagnosed, name) for name in names]):
            name, true, mend = future.result()
            found[name] = mend
            print(f"  [{time.monotonic() - began:.0f} s] {_told(name, mend)}", flush=True)
            known = {**mend.vessels, "causes": replace(mend.vessels["extended"], model_error=None)}
            cases += [(name, n, true, known[n], seeds) for n in NAMES]
        for future in as_completed([pool.submit(_drive, case) for case in cases]):
            name, done = future.result()
            runs[name, done[0].belief] = done
            print(f"  [{len(runs)}/{len(cases)}, {time.monotonic() - began:.0f} s] {_drove(name, done)}", flush=True)
    yield from lines(runs, found, names)


def _told(name: str, mend: DiagnosedBoat) -> str:
    left = "".join(f"; {k} has no place in the file: {v}" for k, v in mend.not_in_file.items())
    return f"{name} ({EFFECTS[name].why}): {mend.verdict}: {', '.join(mend.named) or 'no cause'}{left}"


def _drove(name: str, done: Sequence[Trip]) -> str:
    figures = pooled(done)
    each = ", ".join(f"{k.split('_rms')[0]} {figures[k]:.3f}" for k in ("cross_track_rms_m", *GOALS))
    return f"{name}, {done[0].belief}: {each}; {sum(t.finished for t in done)} of {len(done)} missions finished"


def falls(runs: Mapping[tuple[str, str], Sequence[Trip]], name: str, belief: str = "extended") -> tuple[float, float]:
    """By how much, as shares of the base's, cross-track rms and the estimator's error fall."""
    before, after = pooled(runs[name, "base"]), pooled(runs[name, belief])
    cross, error = (1 - after[k] / before[k] for k in ("cross_track_rms_m", "estimator_error"))
    return cross, error


def _effect(runs: Mapping[tuple[str, str], Sequence[Trip]], mend: DiagnosedBoat, name: str) -> Iterator[Line]:
    """What was found, and both figures with the base and with the extended file."""
    told, right = ", ".join(mend.named) or "nothing", mend.named == (EFFECTS[name].cause,)
    yield information(f"{name}: named (1: that cause and no other)", right, "", f"{mend.verdict}: {told}")
    base, mine = pooled(runs[name, "base"]), pooled(runs[name, "extended"])
    others = {n: falls(runs, name, n) for n in ("refitted", "causes")}
    finished = ", ".join(f"{n} {sum(t.finished for t in runs[name, n])}" for n in NAMES)
    for i, (what, key) in enumerate(
        (("cross-track rms", "cross_track_rms_m"), ("estimator's error", "estimator_error"))
    ):
        beside = ", ".join(f"{n} {100 * fall[i]:.0f} %" for n, fall in others.items())
        parts = ", ".join(f"{k.split('_rmse')[0]} {base[k]:.3f} -> {mine[k]:.3f}" for k in GOALS) if i else finished
        note = f"{base[key]:.3f} -> {mine[key]:.3f}; {beside}; {'' if i else 'finished: '}{parts}"
        yield information(f"{name}: {what} falls by", 100 * falls(runs, name)[i], "%", note)


def lines(
    runs: Mapping[tuple[str, str], Sequence[Trip]], found: Mapping[str, DiagnosedBoat], names: Sequence[str]
) -> Iterator[Line]:
    """Each effect, and the totals. A fall is the larger of the two: of cross-track, or of the estimator's error."""
    best = []
    for name in names:
        best.append(max(falls(runs, name)))
        yield from _effect(runs, found[name], name)
    n = len(names)
    fell = sum(b > 0 for b in best)
    yield at_least("effects in which either falls", fell, math.ceil(0.9 * n), "", f"of {n}")
    yield at_least(
        "median of the larger fall", 100 * float(np.median(best)), 30.0, "%", f"least {100 * min(best):.0f} %"
    )
    for i, what in enumerate(("cross-track", "estimator's error")):
        each = [100 * falls(runs, name)[i] for name in names]
        yield information(
            f"{what} alone: median fall", float(np.median(each)), "%", f"falls in {sum(e > 0 for e in each)} of {n}"
        )
    missed = sum(not t.finished for name in names for t in runs[name, "extended"])
    yield exactly("extended: missions not finished", missed, 0)


PARTS = (driving,)
