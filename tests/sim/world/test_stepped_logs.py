"""Logs of the stepped clock (25 s of an excitation, seed 3) are read by all that reads a boat's log."""

from itertools import pairwise

import msgspec
import numpy as np
import pytest

from companion.boat.load_run import setup_of
from companion.core.excitation.file import excitation_toml
from companion.core.messages import NOTES, GroundTruth, LoopTiming, OverrideLease, topic
from companion.core.pilot.pilot import Pilot
from companion.core.telemetry import structs as shore
from companion.logs.export.tables import tables
from companion.logs.log_file import LogFile
from companion.logs.page.view import page_data, samples
from companion.logs.replay import replay
from companion.logs.summary import summarise
from sim.world.stepped import SteppedRun
from sim.world.stepped_controller import no_plan
from sim.world.stepped_logs import RUN, TRUTH, SteppedLogs
from sim.world.world import World, WorldSetup
from tests.support.drive_fixture import setup
from tests.support.excitation_fixture import LIBRARY

BEGIN_UNIX_NS = 1_790_000_000_000_000_000
SECONDS = 25.0


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """Setup, all messages of the run, and its folder."""
    files = {**setup().files, "excitation.toml": excitation_toml(LIBRARY)}
    told = setup_of(files, {name: name for name in files})
    folder = tmp_path_factory.mktemp("flown")
    world = World(WorldSetup(told.pilot.vessel, told.pilot.site, start=(15.0, 15.0, 0.5)), 3)
    with SteppedLogs(folder, told, BEGIN_UNIX_NS) as logs:
        run = SteppedRun(world, Pilot(told.pilot), no_plan, "excite", logs.record)
        run.run(lambda _run: False, SECONDS)
    return told, run.messages, folder


def written(message):
    return topic(type(message)), msgspec.json.encode(message)


def test_every_message_is_logged_as_it_was(flown):
    _, messages, folder = flown
    logged = [(x.topic, x.data) for x in LogFile(folder / RUN).entries() if not x.topic.startswith("/foxglove/")]
    notes = {topic(kind) for kind in NOTES}
    assert [x for x in logged if x[0] not in notes] == [written(m) for m in messages if not isinstance(m, GroundTruth)]
    truths = [(x.topic, x.data) for x in LogFile(folder / TRUTH).entries() if not x.topic.startswith("/foxglove/")]
    assert truths == [written(m) for m in messages if isinstance(m, GroundTruth)]


@pytest.mark.parametrize("name", [RUN, TRUTH])
def test_each_was_logged_when_it_was(flown, name):
    log = LogFile(flown[2] / name)
    times = [x.log_time_ns for x in log.entries()]
    assert log.wall_offset_ns == times[0] == BEGIN_UNIX_NS
    assert times == sorted(times) and times[-1] == BEGIN_UNIX_NS + SECONDS * 1e9
    late_ns = [x.log_time_ns - x.publish_time_ns - BEGIN_UNIX_NS for x in log.entries()]
    assert min(late_ns) >= 0 and max(late_ns) < 0.3e9, "later by no more than sensor and link took"


def test_its_summary_has_rates_gaps_and_a_start(flown):
    found = summarise(LogFile(flown[2] / RUN))
    assert found.start == "2026-09-21 14:13:20+00:00" and found.duration_s == pytest.approx(SECONDS)
    estimates = next(t for t in found.topics if t.topic == "/state_estimate")
    assert estimates.rate_hz == pytest.approx(10.0) and estimates.largest_gap_s == pytest.approx(0.1)
    assert 5 < found.alerts[0].t_s < 20


def test_a_page_shows_its_estimates(flown):
    log = LogFile(flown[2] / RUN)
    told = samples(log, 10.0)
    states = [x.t_ns for x in told if isinstance(x, shore.StateNow)]
    assert len(states) == SECONDS * 10 and max(np.diff(states)) == 100_000_000
    assert msgspec.json.decode(page_data(log, told, None, 0))["unix_minus_t_ns"] == BEGIN_UNIX_NS


def test_its_tables_have_unix_time(flown):
    for table in tables(LogFile(flown[2] / RUN)).by_topic.values():
        unix_s = [(t + BEGIN_UNIX_NS) / 1e9 for t in table["t_ns"]]
        assert table["unix_s"].to_list() == pytest.approx(unix_s, rel=0, abs=1e-6)


def test_it_repeats_bit_for_bit(flown):
    told, _, folder = flown
    report = replay(Pilot(told.pilot), LogFile(folder / RUN).messages())
    assert report.difference is None and report.steps > 1000


def test_every_lease_has_its_timing(flown):
    after = list(pairwise(LogFile(flown[2] / RUN).messages(OverrideLease, LoopTiming)))[::2]
    assert len(after) == SECONDS * 10
    for lease, timing in after:
        assert isinstance(lease, OverrideLease) and isinstance(timing, LoopTiming)
        assert (timing.index, timing.t_ns, timing.lateness_ms, timing.sent) == (lease.index, lease.t_ns, 0.0, True)
    ages_ms = [x.imu_to_override_ms for _, x in after[20:] if isinstance(x, LoopTiming)]
    assert all(x is not None and 0 <= x < 100 for x in ages_ms)
