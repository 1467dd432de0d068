"""The page of a log: one file that loads nothing, with what the boat would have told and where its model would go."""

import base64
import gzip
import json
import re
import sys
import tracemalloc
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest
from mcap.opcode import Opcode

from companion.boat.load_run import EXAMPLES
from companion.cli import log
from companion.core.messages import GroundTruth, StateEstimate
from companion.core.telemetry import structs as shore
from companion.logs.log_file import LogEntry, LogError, LogFile
from companion.logs.page import html, view
from companion.logs.page.command import duration_s
from tests.companion.command_line import exit_code
from tests.companion.logs.page.page_logs import page_log
from tests.companion.logs.readers.run_logs import record, simulated
from tests.fault_lab.broken_logs import headers

NEED_POLARS = ("companion.logs.runs", "companion.logs.readers", "sim.fitting")


def run(*argv: object) -> int:
    return exit_code("log", "page", *argv)


def unpacked(page: Path) -> dict:
    packed = re.search(r'id="data">([^<]*)</script>', page.read_text())
    assert packed
    return json.loads(gzip.decompress(base64.b64decode(packed[1])))


@pytest.fixture(scope="module")
def logs(tmp_path_factory) -> tuple[Path, Path]:
    """15 s of a boat that is pushed about (seed 3), and the simulator's own log."""
    folder = tmp_path_factory.mktemp("page")
    return page_log(folder), record(folder / "truth.mcap", [x for x in simulated() if isinstance(x, GroundTruth)])


@pytest.fixture(scope="module")
def page(logs) -> Path:
    out = logs[0].parent / "page.html"
    assert run(logs[0], "--extended", EXAMPLES / "boats" / "aritra.toml", "--truth", logs[1], "-o", out) == log.OK
    return out


def test_the_length_of_ten_hours_does_not_take_their_memory():
    """All stamps at once were 0.8 GB."""
    many = 100_000
    stamps = (LogEntry("/tick", 0, 10**15 + k * 10**7, 0, b"") for k in range(many))
    tracemalloc.start()
    try:
        length_s = duration_s(cast("LogFile", SimpleNamespace(entries=lambda: stamps)))
        assert tracemalloc.get_traced_memory()[1] < many
    finally:
        tracemalloc.stop()
    assert length_s == pytest.approx(1e-2 * (many - 1))


def test_it_holds_what_the_boat_would_have_told(page, logs):
    data = unpacked(page)
    told = [shore.decode(topic, json.dumps(sample).encode()) for topic, sample in data["samples"]]
    states = [x for x in told if isinstance(x, shore.StateNow)]
    logged = {m.t_ns: m for m in LogFile(logs[0]).messages(StateEstimate) if isinstance(m, StateEstimate)}
    assert len(states) > 0.9 * len(logged)
    for x in states:
        assert x.north_m == pytest.approx(logged[x.t_ns].north_m, abs=1e-3)
    assert isinstance(told[0], shore.About)
    assert {"thrusters", "path", "mode", "timing"} <= {topic for topic, _ in data["samples"]}
    assert data["length_s"] == pytest.approx(15.0, abs=0.5)


def test_ghosts_lie_on_the_boats_own_clock(page, logs):
    data = unpacked(page)
    base, extended = data["ghosts"]
    assert (base["name"], extended["name"]) == ("simulated (base)", "simulated (extended)")
    assert base["pieces"] == extended["pieces"]  # one vessel file twice
    truths = {m.t_ns: m for m in LogFile(logs[1]).messages(GroundTruth) if isinstance(m, GroundTruth)}
    for piece in base["pieces"]:
        nearest = min(truths.values(), key=lambda m: abs(m.t_ns * 1e-9 - piece["t_s"]))
        assert abs(nearest.t_ns * 1e-9 - piece["t_s"]) < 0.1
        assert piece["x"][0][:2] == [pytest.approx(nearest.north_m, abs=0.1), pytest.approx(nearest.east_m, abs=0.1)]
        assert piece["off_m"][0] == 0.0
    assert [row[:2] for row in data["errors"]["rows"][:2]] == [["0.5 s", base["name"]], ["0.5 s", extended["name"]]]
    assert all(float(cell) < 1.0 for cell in data["errors"]["rows"][0][2:])


def test_it_loads_nothing_and_every_import_is_inside(page):
    text = page.read_text()
    assert "default-src 'none'" in text
    assert not re.findall(r"""<(?:script|link|img)[^>]*(?:src|href)=["'](?!data:)""", text)
    found = re.search(r'<script type="importmap">(.*?)</script>', text)
    assert found
    modules = json.loads(found[1])["imports"]
    for url in modules.values():
        code = base64.b64decode(url.split(",")[1]).decode()
        for name in re.findall(r"""^\s*import .*from\s*["']([^"']+)["']""", code, re.MULTILINE):
            assert name in modules


def test_names_and_texts_cannot_break_out_of_the_page(tmp_path):
    name = "</script><script>alert(1)</script>"
    page = html.page(name, json.dumps({"title": name}).encode()).decode()
    assert "<script>alert" not in page


def test_the_page_without_ghosts_and_without_polars(logs, tmp_path, capsys, monkeypatch):
    for module in [n for n in sys.modules if n.startswith(NEED_POLARS)]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, "polars", None)
    assert run(logs[0], "-o", tmp_path / "a.html") == log.IMPOSSIBLE
    assert "--no-ghosts" in capsys.readouterr().err
    assert run(logs[0], "--no-ghosts", "-o", tmp_path / "a.html") == log.OK
    assert "MB, 15 s at 10 Hz, ghosts: none" in capsys.readouterr().out
    assert unpacked(tmp_path / "a.html")["ghosts"] == []


def test_what_cannot_be_done_is_exit_code_2_with_the_reason(logs, tmp_path, capsys):
    bare = record(tmp_path / "bare.mcap", simulated()[:400], files=False)
    out, vessel = tmp_path / "a.html", EXAMPLES / "boats" / "aritra.toml"
    for argv, told in (
        ([tmp_path / "absent.mcap"], "absent.mcap: No such file"),
        ([bare, "-o", out], "holds no configuration"),
        ([logs[1], "-o", out, "--no-ghosts"], "no estimate in it"),
        ([logs[0], "-o", out, "--no-ghosts", "--extended", vessel], "--extended says nothing with --no-ghosts"),
        ([logs[0], "-o", out, "--vessel", EXAMPLES / "boats" / "twin.toml"], "another boat's vessel file"),
        ([logs[0], "-o", out, "--vessel", tmp_path / "no.toml"], "no.toml: No such file"),
        ([logs[0], "-o", tmp_path / "no" / "a.html", "--no-ghosts"], "a.html: there is no folder"),
    ):
        assert run(*argv) == log.IMPOSSIBLE
        assert told in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize(("minutes", "rate_hz"), [(1, 10.0), (20, 10.0), (60, 10 / 3), (600, 1.0)])
def test_long_logs_are_thinned(minutes, rate_hz):
    assert view.rate_of(60.0 * minutes) == pytest.approx(rate_hz)


def test_a_thinned_page_has_the_whole_log(logs):
    told = view.samples(LogFile(logs[0]), 1.0)
    states = [x.t_ns * 1e-9 for x in told if isinstance(x, shore.StateNow)]
    gaps = [b - a for a, b in pairwise(states)]
    assert max(gaps) < 1.3
    assert states[-1] - states[0] > 12.0


def test_a_log_without_configuration_is_refused_by_name(tmp_path):
    with pytest.raises(LogError, match="bare"):
        view.samples(LogFile(record(tmp_path / "bare.mcap", simulated()[:50], files=False)), 10.0)


def test_of_a_damaged_log_the_page_shows_the_rest_and_the_command_says_so(tmp_path, capsys):
    path = page_log(tmp_path)
    data = path.read_bytes()
    chunk = [at for at in headers(data) if data[at] == Opcode.CHUNK][-1]
    path.write_bytes(data[: chunk + 60] + b"\0\0\0\0" + data[chunk + 64 :])
    assert run(path, "--no-ghosts", "-o", tmp_path / "x.html") == 1
    assert f"1 damaged chunk(s) left out (the first at byte {chunk}" in capsys.readouterr().out
