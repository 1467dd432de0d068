"""The layout for PlotJuggler: its form, and that each curve is in a log, under the name that PlotJuggler gives it."""

import json
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from importlib.resources import files

import pytest
from mcap.reader import make_reader

from tests.companion.logs.page.page_logs import page_log

ROOT = ET.fromstring(files("deploy").joinpath("plotjuggler", "log.xml").read_bytes())


def series(name: str, value: object) -> Iterator[str]:
    """Names of the numbers in a JSON message, as PlotJuggler's parser makes them: a/b for keys, a[0] for places."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from series(f"{name}/{key}", inner)
    elif isinstance(value, list):
        for place, inner in enumerate(value):
            yield from series(f"{name}[{place}]", inner)
    elif isinstance(value, int | float):
        yield name


@pytest.fixture(scope="module")
def logged(tmp_path_factory) -> set[str]:
    """Series of a log of 15 s in the stepped simulation, seed 3."""
    with page_log(tmp_path_factory.mktemp("log")).open("rb") as file:
        messages = make_reader(file).iter_messages()
        return {
            name
            for _, channel, message in messages
            if channel.message_encoding == "json"
            for name in series(channel.topic, json.loads(message.data))
        }


def test_every_curve_is_in_a_log(logged):
    time, plane = (ROOT.findall(f".//plot[@mode='{mode}']/curve") for mode in ("TimeSeries", "XYPlot"))
    names = [c.get("name") for c in time] + [c.get(axis) for c in plane for axis in ("curve_x", "curve_y")]
    assert len(time) > 20 and len(plane) == 2
    assert set(names) - logged == set()


def test_splitters_hold_what_they_say():
    splitters = ROOT.findall(".//DockSplitter")
    assert len(splitters) > 3
    for splitter in splitters:
        sizes = [float(size) for size in splitter.attrib["sizes"].split(";")]
        assert len(sizes) == len(splitter) == int(splitter.attrib["count"])
        assert sum(sizes) == pytest.approx(1.0, abs=1e-4)
    assert all(plot.findall("curve") for plot in ROOT.findall(".//plot"))
