"""`aritra campaign` in real processes: killed campaigns, killed workers, cases that fail, a real Dask cluster."""

import contextlib
import json
import os
import signal
import subprocess
import threading
import time
from pathlib import Path

import polars as pl
import psutil
import pytest

from companion.__main__ import main
from companion.python_child import aritra
from sim.campaign.journal import NAME
from tests.companion.command_line import exit_code
from tests.support.campaign_fixture import SHORT, campaign_file

ARITRA = aritra("campaign")
DEADLINE_S = 120.0


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The campaign in one process, undisturbed: its file and its results as bytes."""
    folder = tmp_path_factory.mktemp("campaign")
    path = campaign_file(folder)
    assert main(["campaign", str(path), "--out", str(folder / "whole"), "--jobs", "1"]) == 0
    return path, (folder / "whole" / "results.parquet").read_bytes()


def lines(out: Path) -> int:
    """Cases in the journal."""
    return (out / NAME).read_bytes().count(b"\n") - 1 if (out / NAME).exists() else 0


def wait_for(condition) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.mark.long
def test_missions_drive_and_are_told_apart(whole):
    table = pl.read_parquet(whole[1])
    assert table.height == 8 and set(table["mode"]) == {"auto"} and not table["unleased"].any()
    assert table["position_rmse_m"].n_unique() == 8 and table["position_rmse_m"].max() < 0.3
    calm, current = (table.filter(pl.col("weather.V_c_m_s") == v).sort("seed") for v in (0.0, 0.1))
    assert calm["world.north_m"].to_list() == current["world.north_m"].to_list()


@pytest.mark.long
def test_a_killed_campaign_goes_on_where_it_was_and_ends_in_the_same_bytes(whole, tmp_path):
    path, results = whole
    command = [*ARITRA, str(path), "--out", str(tmp_path), "--jobs", "2"]
    running = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    wait_for(lambda: lines(tmp_path) >= 2)
    workers = psutil.Process(running.pid).children(recursive=True)
    running.send_signal(signal.SIGKILL)
    running.wait()
    kept = lines(tmp_path)
    assert 2 <= kept < 8, "it was killed under way"
    assert psutil.wait_procs(workers, timeout=10.0)[1] == [], "workers end with their campaign"
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert f"8 cases of missions, {kept} of them there already" in done.stdout
    assert (tmp_path / "results.parquet").read_bytes() == results


@pytest.mark.long
def test_a_killed_workers_case_is_done_by_another(whole, tmp_path):
    path, results = whole
    running = subprocess.Popen([*ARITRA, str(path), "--out", str(tmp_path), "--jobs", "2"], stdout=subprocess.DEVNULL)
    wait_for(lambda: lines(tmp_path) >= 2)
    told = [json.loads(line) for line in (tmp_path / NAME).read_text().splitlines()[1:]]
    os.kill(int(told[0]["worker"].split(":")[1]), signal.SIGKILL)
    assert running.wait(DEADLINE_S) == 0
    assert (tmp_path / "results.parquet").read_bytes() == results
    assert pl.read_parquet(tmp_path / "timings.parquet")["worker"].n_unique() == 3


def test_a_case_whose_workers_always_die_has_failed(tmp_path):
    path = campaign_file(tmp_path, SHORT.replace("count = 4", "count = 1"), "[0.0, 0.1]", "[0.0]")
    out = tmp_path / "out"
    running = subprocess.Popen([*ARITRA, str(path), "--out", str(out)], stdout=subprocess.PIPE, text=True)
    boss, killed = psutil.Process(running.pid), 0

    def kill() -> bool:
        nonlocal killed
        with contextlib.suppress(psutil.Error):
            for child in boss.children():
                if any("spawn_main" in word for word in child.cmdline()):
                    child.kill()
                    child.wait(10.0)
                    killed += 1
        return running.poll() is not None

    wait_for(kill)
    told = running.communicate()[0]
    assert running.returncode == 1 and killed == 3 and "its worker died 3 times" in told
    assert json.loads((out / "failed.json").read_text())[0]["seed"] == 1


@pytest.mark.long
def test_ctrl_c_keeps_what_is_done_and_leaves_nobody_behind(tmp_path):
    command = [*ARITRA, str(campaign_file(tmp_path)), "--out", str(tmp_path), "--jobs", "2"]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    wait_for(lambda: lines(tmp_path) >= 2)
    workers = psutil.Process(running.pid).children(recursive=True)
    running.send_signal(signal.SIGINT)
    out, err = running.communicate(timeout=DEADLINE_S)
    assert running.returncode == 130 and "interrupted: what is done is kept" in out and "Traceback" not in err
    assert pl.read_parquet(tmp_path / "results.parquet").height == lines(tmp_path)
    assert psutil.wait_procs(workers, timeout=10.0)[1] == []


@pytest.mark.long
def test_a_case_that_cannot_run_is_listed_and_the_others_are_kept(tmp_path, capsys):
    """Of seeds 1 to 4 some draw a battery of less than no volt: possible in the file, not in the world."""
    path = campaign_file(
        tmp_path,
        SHORT.replace("weather.V_c_m_s = [0.0, 0.1]", "weather.V_c_m_s = [0.0]"),
        "world.north_m = { uniform = [7.5, 8.5] }",
        "world.voltage_v = { normal = [15.6, 30.0] }",
    )
    out = tmp_path / "out"
    command = ["campaign", str(path), "--out", str(out), "--jobs", "1"]
    assert main(command) == 1
    table, failed = pl.read_parquet(out / "results.parquet"), json.loads((out / "failed.json").read_text())
    assert table.height == 4 - len(failed) > 0 and failed
    assert all(f["world.voltage_v"] <= 0 and "ConfigError: world.voltage_v: " in f["error"] for f in failed)
    told = capsys.readouterr().out
    assert f"failed: {failed[0]['case']} seed {failed[0]['seed']}: ConfigError" in told
    before = lines(out)
    assert main(command) == 1 and lines(out) == before
    assert main([*command, "--retry"]) == 1 and lines(out) == before + len(failed)


def test_bad_input_is_refused(tmp_path, capsys):
    assert exit_code("campaign", tmp_path / "none.toml") == 2
    assert f"aritra campaign: FILE: {tmp_path / 'none.toml'}: No such file" in capsys.readouterr().err
    path = campaign_file(tmp_path)
    for words in (["--jobs", "0"], ["--jobs", "2", "--scheduler", "tcp://127.0.0.1:1"]):
        with pytest.raises(SystemExit, match="2"):
            main(["campaign", str(path), *words])


# --- a cluster -----------------------------------------------------------------------------------------------


@pytest.mark.long
def test_a_cluster_whose_worker_is_killed_midway_gives_the_same_bytes(whole, tmp_path):
    """Two workers in processes of their own; one is killed while it has a case."""
    distributed = pytest.importorskip("distributed", reason="Dask (extra campaign) is not installed")
    path, results = whole
    killed = []

    def kill(cluster) -> None:
        wait_for(lambda: lines(tmp_path) >= 3)
        (worker,) = (w for w in cluster.scheduler.workers.values() if w.name == 0)
        wait_for(lambda: worker.processing)
        os.kill(cluster.workers[0].pid, signal.SIGKILL)
        killed.append(lines(tmp_path))

    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    ) as cluster:
        killer = threading.Thread(target=kill, args=(cluster,))
        killer.start()
        command = [*ARITRA, str(path), "--out", str(tmp_path), "--scheduler", cluster.scheduler_address]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        killer.join()
    assert done.returncode == 0, done.stdout + done.stderr
    assert killed[0] < 8, "it was killed under way"
    assert (tmp_path / "results.parquet").read_bytes() == results
    workers = pl.read_parquet(tmp_path / "timings.parquet")["worker"]
    assert workers.n_unique() >= 2 and "8 to run on tcp://127.0.0.1:" in done.stdout


def test_no_scheduler_is_said(tmp_path, capsys):
    pytest.importorskip("distributed", reason="Dask (extra campaign) is not installed")
    assert main(["campaign", str(campaign_file(tmp_path)), "--out", str(tmp_path), "--scheduler", "nonsense://x"]) == 1
    assert "no Dask scheduler answers at nonsense://x" in capsys.readouterr().out
