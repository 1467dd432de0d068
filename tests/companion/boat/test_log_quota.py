"""Logs within their quota: what goes, in which order, and what never goes."""

import asyncio
import os
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.boat.load_run import setup_of
from companion.boat.log_quota import (
    FRESH_S,
    NAME,
    PERIOD_NS,
    RELEASED_S,
    Stored,
    Swept,
    alerts,
    keep_within,
    new_log,
    sweep,
    to_delete,
)
from companion.boat.preflight import disk_state
from companion.core.configuration.run_file import load_run
from companion.core.configuration.tables import ConfigError
from companion.logs.part_files import part_path
from tests.support.drive_fixture import setup
from tests.support.stand_ins.sim_clock import SimClock

NOW_S = 1_800_000_000.0
RUNNING = "aritra-20270115-080000.mcap"


def part(day, number, size, age_s):
    stem = f"aritra-202701{day:02d}-080000"
    return Stored(f"{stem}.part{number}.mcap" if number else f"{stem}.mcap", size, NOW_S - age_s)


STRANGERS = st.sampled_from(["notes.txt", "best-run.mcap", "aritra-best.mcap", "aritra-20270101-080000.sound.mcap"])
FILES = st.lists(
    st.builds(
        part, st.integers(1, 15), st.integers(0, 3), st.integers(0, 1000), st.floats(-1e6, 1e8, allow_subnormal=False)
    )
    | st.builds(Stored, STRANGERS, st.integers(0, 1000), st.just(0.0)),
    unique_by=lambda file: file.name,
    max_size=25,
)


def stem(name):
    match = NAME.fullmatch(name)
    return match and match[1]


@given(files=FILES, quota=st.integers(0, 5000))
def test_enough_goes_and_no_more_and_never_what_is_spared(files, quota):
    doomed = to_delete(files, quota_bytes=quota, running=RUNNING, now_s=NOW_S)
    ours = [file for file in files if stem(file.name)]
    fresh = {stem(file.name) for file in ours if abs(NOW_S - file.modified_s) < FRESH_S}
    assert len(set(doomed)) == len(doomed) and set(doomed) <= set(ours)
    assert not {stem(file.name) for file in doomed} & {stem(RUNNING), *fresh}
    left = sum(file.size_bytes for file in ours) - sum(file.size_bytes for file in doomed)
    if left > quota:
        kept = set(ours) - set(doomed)
        assert all(stem(file.name) in {stem(RUNNING), *fresh} for file in kept), "something could still go"
    if doomed:
        assert left + doomed[-1].size_bytes > quota, "the last one need not have gone"
    age = {log: max(f.modified_s for f in ours if stem(f.name) == log) for log in map(stem, (f.name for f in ours))}
    for gone in doomed:
        for kept in set(ours) - set(doomed):
            spared = stem(kept.name) in {stem(RUNNING), *fresh}
            older, newer = ((age[log] < RELEASED_S, age[log]) for log in (stem(gone.name), stem(kept.name)))
            assert spared or newer >= older, f"{gone} went before the older {kept}"


def test_the_oldest_log_goes_first_and_of_it_the_oldest_part():
    files = [part(9, 0, 10, 500), part(8, 1, 10, 900), part(8, 0, 10, 950), part(8, 2, 10, 800), part(7, 0, 10, 2000)]
    order = [file.name for file in to_delete(files, quota_bytes=0, running=RUNNING, now_s=NOW_S)]
    assert order == [part(7, 0, 0, 0).name, *(part(8, n, 0, 0).name for n in (0, 1, 2)), part(9, 0, 0, 0).name]
    assert to_delete(files, quota_bytes=50, running=RUNNING, now_s=NOW_S) == []
    assert len(to_delete(files, quota_bytes=49, running=RUNNING, now_s=NOW_S)) == 1


def test_a_wrong_date_deletes_nothing_that_fits():
    """A clock that jumped 60 years ahead, or stands in 1970, makes no log old enough to go."""
    files = [part(day, 0, 100, 1e5 * day) for day in range(1, 10)]
    for now_s in (0.0, NOW_S + 2e9):
        assert to_delete(files, quota_bytes=900, running=RUNNING, now_s=now_s) == []
        names = [file.name for file in to_delete(files, quota_bytes=700, running=RUNNING, now_s=now_s)]
        assert names == [part(day, 0, 0, 0).name for day in (9, 8)]


def test_a_log_of_a_clock_that_was_not_set_goes_last():
    """On a board without a battery for its clock this morning's log is of 1970, and went first."""
    morning = Stored("aritra-19700101-000130.mcap", 10, 700.0)
    dated = [part(day, 0, 10, 1e5 * day) for day in (8, 9)]
    order = to_delete([morning, *dated], quota_bytes=0, running=RUNNING, now_s=NOW_S)
    assert order == [dated[1], dated[0], morning]


def test_new_logs_have_names_of_their_own_that_the_quota_knows(tmp_path):
    now = time.gmtime(0)  # a clock without a battery shows the same time at every boot
    made = []
    for _ in range(3):
        made.append(new_log(tmp_path, now))
        made[-1].touch()
    assert [path.name for path in made] == [f"aritra-19700101-000000{n}.mcap" for n in ("", "-2", "-3")]
    for path in made:
        assert stem(path.name) == path.stem == stem(part_path(path, 7).name)


def fill(folder, *files):
    for file in files:
        (folder / file.name).write_bytes(bytes(file.size_bytes))
        os.utime(folder / file.name, (file.modified_s, file.modified_s))


def test_a_folder_is_swept(tmp_path):
    fill(tmp_path, part(1, 0, 400, 9e5), part(2, 0, 400, 8e5), Stored("aritra-kept.mcap", 4000, NOW_S - 9e6))
    fill(tmp_path, Stored(RUNNING, 300, NOW_S))
    swept = sweep(tmp_path, quota_bytes=800, running=RUNNING, now_s=NOW_S)
    assert swept == Swept((part(1, 0, 0, 0).name,), 700, None)
    assert sorted(p.name for p in tmp_path.iterdir()) == [part(2, 0, 0, 0).name, RUNNING, "aritra-kept.mcap"]
    assert sweep(tmp_path, quota_bytes=800, running=RUNNING, now_s=NOW_S) == Swept((), 700, None)
    full = sweep(tmp_path, quota_bytes=100, running=RUNNING, now_s=NOW_S)
    assert full.left_bytes == 300 and "the one being written needs more" in full.problem


def test_what_cannot_be_deleted_is_told_and_does_not_stop_the_rest(tmp_path):
    (tmp_path / part(1, 0, 0, 0).name).mkdir()  # a folder with a log's name: unlink refuses, also for root
    os.utime(tmp_path / part(1, 0, 0, 0).name, (NOW_S - 9e6,) * 2)
    fill(tmp_path, part(2, 0, 400, 8e5))
    swept = sweep(tmp_path, quota_bytes=1, running=RUNNING, now_s=NOW_S)
    assert swept.deleted == (part(2, 0, 0, 0).name,)
    assert f"cannot delete {part(1, 0, 0, 0).name}: Is a directory" in swept.problem


def test_it_is_looked_after_every_minute_and_a_problem_is_told_once():
    problems = iter([None, "full", "full", None, "full"])
    looked, told = [], []
    clock = SimClock(0)

    def look():
        looked.append(clock.now_ns())
        return Swept((), 0, next(problems))

    async def minutes():
        task = asyncio.create_task(keep_within(look, clock, told.append))
        for n in range(1, 6):
            await clock.advance(PERIOD_NS)
            while len(looked) < n:
                await asyncio.sleep(0.001)
            await asyncio.sleep(0.02)
        task.cancel()

    asyncio.run(minutes())
    assert looked == [n * PERIOD_NS for n in range(1, 6)]
    assert [(alert.t_ns, alert.text) for alert in told] == [(2 * PERIOD_NS, "full"), (5 * PERIOD_NS, "full")]


def test_what_was_deleted_is_told_by_name():
    (alert,) = alerts(Swept(("a.mcap", "b.mcap"), 0, None), None, 5)
    assert (alert.level, alert.text) == ("info", "old logs deleted for log.quota_MB: a.mcap, b.mcap")


def test_a_quota_without_a_folder_is_refused():
    texts = dict(setup().files)
    texts["run.toml"] += "\n[log]\nquota_MB = 100\n"
    with pytest.raises(ConfigError, match=r"my\.toml: log\.quota_MB: needs log\.folder"):
        setup_of(texts, {**{name: name for name in texts}, "run.toml": "my.toml"})
    with pytest.raises(ConfigError, match=r"my\.toml: log\.quota_MB: expected 0\.001 to 1e\+09, found 0"):
        load_run(setup().files["run.toml"] + "\n[log]\nfolder = 'x'\nquota_MB = 0\n", name="my.toml")


def test_a_link_to_a_log_that_is_gone_does_not_end_the_quota(tmp_path):
    """Made by hand, `aritra-latest.mcap` outlives the log it points to; nothing was deleted from then on."""
    for day in (1, 2):
        log = tmp_path / f"aritra-2020010{day}-000000.mcap"
        log.write_bytes(bytes(1000))
        os.utime(log, (1e9 + day, 1e9 + day))
    for link, to in (("aritra-latest.mcap", "gone.mcap"), ("aritra-20200103-000000.mcap", "gone.mcap")):
        (tmp_path / link).symlink_to(to)
    swept = sweep(tmp_path, quota_bytes=1500, running="", now_s=time.time())
    assert swept == Swept(("aritra-20200101-000000.mcap",), 1000, None)
    disk = disk_state(tmp_path, 1.0)
    assert (disk.problem, disk.used_bytes, disk.newest_s) == (None, 1000, 1e9 + 2)


def test_a_log_folder_that_may_not_be_looked_for_is_a_row_and_no_traceback(tmp_path, monkeypatch):
    def refuse(self):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("pathlib.Path.exists", refuse)
    assert disk_state(tmp_path / "root" / "logs", None).problem == "Permission denied"


def test_no_name_is_no_log_folder():
    """It passed for one, so that the quota deleted logs from wherever the program was started."""
    run = 'vessel = "v"\nsite = "s"\nmission = "m"\n[mavlink]\nurl = "x"\n[log]\nfolder = ""\nquota_MB = 1\n'
    with pytest.raises(ConfigError, match=r"run\.toml: log: folder: expected a path, found nothing"):
        load_run(run, name="run.toml")
