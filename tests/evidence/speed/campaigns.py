"""Evidence for campaigns: closed-loop missions on two cores against one, and the same bits from every scheduler."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import psutil
from distributed import LocalCluster

from companion.boat.load_run import EXAMPLES
from sim.campaign.inputs import read_campaign
from sim.campaign.runners.cluster import Cluster
from sim.campaign.runners.job import CaseOutcome, Runner, Work
from sim.campaign.runners.local import Local
from tests.evidence.line import Line, at_least, exactly, information

CORNER = ((9.0, 9.0), (16.0, 9.0), (16.0, 16.0))
"""Two legs of 7 m with a corner, then station keeping: some 45 s of driving."""
SHORT, WHOLE = (40, 4), (1000, 10)
"""Missions, and rounds that they are parted into."""
SAMPLE = 10
"""Missions of a round that one process drives as well, for what one core does in that time of day."""
TEXT = f"""format = 1
name = "evidence"
kind = "missions"
seeds = {{{{ count = {{count}} }}}}
[files]
run = "{EXAMPLES / "aritra.toml"}"
mission = "corner.toml"
[missions]
limit_s = 90.0
station_s = 3.0
[set]
world.mismatch = 0.1
weather.V_c_m_s = 0.1
weather.V_w_m_s = 3.0
weather.gustiness = 0.2
[draw]
world.north_m = {{{{ uniform = [7.5, 8.5] }}}}
world.east_m = {{{{ uniform = [7.5, 8.5] }}}}
weather.beta_c_deg = {{{{ uniform = [0.0, 360.0] }}}}
weather.beta_w_deg = {{{{ uniform = [0.0, 360.0] }}}}
"""


def missions(count: int) -> list[Work]:
    """Seeds 1 to `count`, in their order."""
    with tempfile.TemporaryDirectory() as folder:
        legs = "".join(f"[[waypoints]]\nnorth_m = {n}\neast_m = {e}\nspeed_m_s = 0.5\n" for n, e in CORNER)
        (Path(folder) / "corner.toml").write_text('name = "corner"\n' + legs)
        path = Path(folder) / "campaign.toml"
        path.write_text(TEXT.format(count=count))
        inputs, cases = read_campaign(path)
        return [inputs.work(case) for case in sorted(cases, key=lambda case: case.seed)]


@dataclass
class Spent:
    """Of some rounds: wall time, processor time of this program with its processes, and of all others [s]."""

    wall_s: float = 0.0
    ours_s: float = 0.0
    others_s: float = 0.0
    outcomes: list[CaseOutcome] = field(default_factory=list)

    def add(self, runner: Runner, works: Sequence[Work]) -> None:
        """Run them too."""
        begun, ours_s, all_s = time.monotonic(), _ours_s(), _all_s()
        self.outcomes += runner(works)
        used_s = _ours_s() - ours_s
        self.wall_s += time.monotonic() - begun
        self.ours_s += used_s
        self.others_s += _all_s() - all_s - used_s


def _ours_s() -> float:
    here = psutil.Process()
    return sum(t.user + t.system for t in (p.cpu_times() for p in (here, *here.children(recursive=True))))


def _all_s() -> float:
    told = psutil.cpu_times()
    return told.user + told.nice + told.system


def campaigns(full: bool) -> Iterator[Line]:
    """Campaign: closed-loop missions in 2 processes and, between them, a sample of the same in 1 (1,000 with --full)"""
    many, rounds = WHOLE if full else SHORT
    works, part = missions(many), many // rounds
    start, two, one, dask = Spent(), Spent(), Spent(), Spent()
    with Local(2) as pair, Local(1) as single:
        start.add(pair, works[:2])
        Spent().add(single, works[:1])
        for i in range(rounds):
            mine = works[i * part : (i + 1) * part]
            two.add(pair, mine)
            one.add(single, mine[:SAMPLE])
    found, again = {o.id: o for o in two.outcomes}, one.outcomes
    each_s, all_of_them = one.wall_s / len(again), f"{many} missions"
    how = f"{len(again)} of them in one process, {each_s:.2f} s each, between the parts; {os.cpu_count()} cores"
    gain = 100 * many * each_s / (2 * two.wall_s)
    note = f"and {start.wall_s:.1f} s until the first 2 were done"
    yield information(f"{all_of_them}: wall time in 2 processes", two.wall_s, "s", note)
    yield at_least(f"{all_of_them}: efficiency of 2 processes against 1", gain, 85, "%", how)
    costs = (two.ours_s / many) / (one.ours_s / len(again))
    yield information(
        "processor time of a mission, one of two over alone", costs, "", "does not count waiting for a core"
    )
    note = "what they take is missing above: for a fair figure nothing else should run"
    yield information("cores that other programs took beside the two", two.others_s / two.wall_s, "", note)
    yield exactly(f"{all_of_them}: failed", sum(bool(o.error) for o in found.values()), 0)
    figures = [o.figures for o in found.values()]
    ended = 100 * sum(f["finished"] is True and f["waypoints_missed"] == 0 for f in figures) / len(figures)
    yield information(f"{all_of_them}: ended on station, no waypoint missed", ended, "%")
    differ = sum(o.figures != found[o.id].figures for o in again)
    yield exactly("cases that differ between 1 and 2 processes", differ, 0, "", f"of {len(again)}, every bit")
    with (
        LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0") as local,
        Cluster(local.scheduler_address) as cluster,
    ):
        dask.add(cluster, works)
    differ = sum(o.figures != found[o.id].figures for o in dask.outcomes)
    yield information(
        f"{all_of_them}: wall time on a Dask cluster of 2 workers", dask.wall_s, "s", "with their imports"
    )
    yield exactly("cases that differ between Dask and processes", differ, 0, "", f"of {len(dask.outcomes)}, every bit")


PARTS = (campaigns,)
