"""Evidence that a watch tells a fouling, soon and with its size, is quiet without one, and survives being killed."""

from __future__ import annotations

import math
import random
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from pathlib import Path

import numpy as np

from companion.boat.load_run import EXAMPLES
from companion.logs.readers.read_run import ReadOptions, read_run
from companion.python_child import aritra
from sim.commission.watch.causes import watched
from sim.commission.watch.course import course, threshold_nats
from sim.commission.watch.history import PAGE, PROPOSED, History
from sim.commission.watch.job import course_of
from sim.commission.watch.mission_fit import MissionInformation, boat_effects, mission_information
from tests.evidence.commission.fouled_boats import RAMP, UNCHANGED, Fouling, boat, fouling, mission, vessel
from tests.evidence.commission.story import Story
from tests.evidence.line import Line, at_least, at_most, exactly, information
from tests.evidence.processes import processes

FIRST_BOAT = 103
"""Seed of the first boat; seeds below were used while the method was made."""
SOON = 2
"""Missions within which a fouling must be told, its own included."""
KILLS = 6


def watch_fouled(full: bool) -> Iterator[Line]:
    """A boat fouls during its tenth mission: 2 boats, 4 foulings each (--full: 20 boats and 3 clean, also in waves)"""
    boats = range(FIRST_BOAT, FIRST_BOAT + (23 if full else 2))
    plans = [(seed, 0 if full and i >= 20 else 1 if full else 4) for i, seed in enumerate(boats)]
    yield from _judged(plans, waves=False)
    if full:
        yield from _judged(plans, waves=True)


def _judged(plans: Sequence[tuple[int, int]], waves: bool) -> Iterator[Line]:
    """Boats (seed, number of foulings) in current and gusts, or in waves, too: for these there is no goal."""
    where, begun = "in waves, too: " if waves else "", time.monotonic()
    with tempfile.TemporaryDirectory() as folder, _pool() as pool:
        stories = list(_stories(plans, waves, Path(folder), pool))
    for story in (s for s in stories if s.cause):
        print(f"  {story}")
    for ramps, text in ((False, "sudden foulings"), (True, "foulings that grow over three missions")):
        ill = [s for s in stories if s.cause and s.cause.ramps == ramps]
        goal, among = math.nan if waves else len(ill), f"of {len(ill)}"
        soon = "two missions" if not ramps else "two missions of their full size"
        yield at_least(f"{where}{text} told within {soon}", sum(s.rightly for s in ill), goal, "", among)
        yield at_least(f"{where}{text}: size within 20 %", sum(s.near for s in ill), goal, "", among)
        errors = [abs(s.size_error) for s in ill if s.rightly]
        if errors:
            yield information(f"{where}{text}: error of the size, median", 100 * float(np.median(errors)), "%")
    yield exactly(f"{where}changes told by a wrong name", sum(s.wrong for s in stories), 0)
    first = list({s.seed: s for s in reversed(stories)}.values())
    clean = f"in {UNCHANGED * len(first)} missions"
    yield exactly(f"{where}false alarms without change", sum(s.false_alarms for s in first), 0, "", clean)
    most = max(m.best[0] for s in first for m in s.course.missions[:UNCHANGED])
    yield information(f"{where}most evidence of a change without one", most, "nats", f"told from {_threshold():.1f} on")
    yield information(f"{where}time", (time.monotonic() - begun) / 60, "min")


def _threshold() -> float:
    return threshold_nats(len(watched(vessel(), boat_effects(vessel())).causes))


def watch_log_time(full: bool) -> Iterator[Line]:
    """What a mission's log costs"""
    with tempfile.TemporaryDirectory() as folder, _pool() as pool:
        path = pool.submit(mission, boat(FIRST_BOAT), 1, 1000 * FIRST_BOAT, Path(folder)).result()
        pool.submit(_information, path).result()
        begun = time.monotonic()
        pool.submit(_information, path).result()
    yield at_most("a log of a mission of two minutes taken in", time.monotonic() - begun, 10.0, "s")


def watch_killed(full: bool) -> Iterator[Line]:
    """A watch is killed at random moments and started again: 6 times (--full: 20)"""
    kills, rng = 20 if full else KILLS, random.Random(7)
    with tempfile.TemporaryDirectory() as name, _pool() as pool:
        folder = Path(name)
        jobs = [pool.submit(mission, boat(FIRST_BOAT), n, 1000 * FIRST_BOAT, folder) for n in (1, 2, 3)]
        logs = [job.result() for job in jobs]
        begun = time.monotonic()
        _watch(logs, folder / "whole").wait()
        whole_s = time.monotonic() - begun
        left = 0
        for _ in range(kills):
            child = _watch(logs, folder / "killed")
            try:
                child.wait(rng.uniform(0.2, 0.8) * whole_s)
            except subprocess.TimeoutExpired:
                child.send_signal(signal.SIGKILL)
                child.wait()
                left += 1
        code = _watch(logs, folder / "killed").wait()
        one, other = (History(folder / n, vessel(), "") for n in ("whole", "killed"))
        written = [(other.folder / n).stat().st_size > 0 for n in (PROPOSED, PAGE)]
        same = [e.eta for e in one.entries] == [e.eta for e in other.entries]
        courses = [course_of(history) for history in (one, other)]
    yield information("watches that were killed", left, "", f"of {kills}")
    yield exactly("last one: exit code", code, 0)
    yield exactly("logs in the history", len(other.entries), 3)
    yield exactly("entries as without a kill", same, True)
    beliefs = [c.missions[-1].belief.mean for c in courses if c]
    yield at_most("difference of what is believed", float(np.abs(beliefs[0] - beliefs[1]).max()), 0.0)
    yield exactly("page and proposed file written", sum(written), 2)


def _pool() -> ProcessPoolExecutor:
    return processes(initializer=_one_thread)


def _one_thread() -> None:
    from threadpoolctl import threadpool_limits

    threadpool_limits(limits=1)


def _stories(plans: Sequence[tuple[int, int]], waves: bool, folder: Path, pool: ProcessPoolExecutor) -> Iterator[Story]:
    """Of each boat all missions and fits are done side by side; its foulings share the missions before them."""

    def driven(seed: int, k: int | None, numbers: Iterable[int]) -> list[Future[MissionInformation]]:
        return [pool.submit(_one, seed, n, k, waves, folder) for n in numbers]

    sound = {seed: driven(seed, None, range(1, UNCHANGED + 1)) for seed, _ in plans}
    pairs = [(seed, k) for seed, count in plans for k in range(count)]
    ill = {(seed, k): driven(seed, k, _late(fouling(10 * seed + k))) for seed, k in pairs}
    effects = boat_effects(vessel())
    parameters = watched(vessel(), effects)
    for seed, count in plans:
        before = [job.result() for job in sound[seed]]
        for k in range(max(count, 1)):
            missions = before + [job.result() for job in ill.get((seed, k), ())]
            found = course(missions, parameters, [np.zeros(len(effects))] * len(missions))
            yield Story(seed, k, fouling(10 * seed + k) if count else None, found)


def _late(cause: Fouling) -> range:
    """Numbers of the missions since the fouling: until it has had its full size for two."""
    grows = len(RAMP) - 1 if cause.ramps else 0
    return range(UNCHANGED + 1, UNCHANGED + grows + SOON + 1)


def _one(seed: int, number: int, k: int | None, waves: bool, folder: Path) -> MissionInformation:
    """One mission driven and fitted; `k`: number of the boat's fouling."""
    cause = None if k is None else fouling(10 * seed + k)
    own = 1000 * seed + (0 if k is None else 1 + k)
    path = mission(boat(seed), number, own, folder / f"{seed}-{k}", cause, waves=waves)
    found = _information(path)
    path.unlink()
    return found


def _information(path: Path) -> MissionInformation:
    return mission_information(read_run(path, ReadOptions(vessel())), vessel())


def _watch(logs: Sequence[Path], history: Path) -> subprocess.Popen[bytes]:
    words = ["watch", *map(str, logs), "--vessel", str(EXAMPLES / "boats" / "aritra.toml"), "--history", str(history)]
    return subprocess.Popen(aritra(*words), stdout=subprocess.DEVNULL)


PARTS = (watch_fouled, watch_log_time, watch_killed)
