"""Leaflet and uPlot beside the console's own files: unchanged, with version and licence; they load nothing."""

import hashlib
import re
import runpy
import tomllib
from importlib.resources import files
from pathlib import Path

import pytest

from companion.shore.console.assets import assets

FOLDER = Path(str(files("companion.shore.console"))) / "web/vendor"
TABLE = tomllib.loads((FOLDER / "vendor.toml").read_text())
SCRIPT = runpy.run_path(str(Path(__file__).resolve().parents[4] / "scripts/vendor"))


@pytest.mark.parametrize("name", TABLE)
def test_files_are_those_of_the_registry(name):
    found = {file: hashlib.sha256((FOLDER / file).read_bytes()).hexdigest() for file in TABLE[name]["sha256"]}
    assert found == TABLE[name]["sha256"]
    assert set(found) == set(SCRIPT["FILES"][name].values())


def test_nothing_else_lies_beside_them():
    listed = {file for table in TABLE.values() for file in table["sha256"]}
    assert {path.name for path in FOLDER.iterdir()} == listed | {"vendor.toml"}


@pytest.mark.parametrize(
    ("name", "pattern", "licence"),
    [
        ("leaflet", r"Leaflet (\d+\.\d+\.\d+), a JS library", "BSD 2-Clause License"),
        ("uPlot", r"leeoniya/uPlot \(v(\d+\.\d+\.\d+)\)", "The MIT License (MIT)"),
    ],
)
def test_versions_and_licences_are_what_the_files_say(name, pattern, licence):
    text = (FOLDER / f"{name}.js").read_text()
    said = re.search(pattern, text)
    assert said and said[1] == TABLE[name.lower()]["version"]
    assert (FOLDER / f"{name}-LICENSE.txt").read_text().startswith(licence)


def test_styles_load_nothing_from_elsewhere():
    served = {path: asset.data.decode() for path, asset in assets().items() if path.startswith("/web/vendor/")}
    assert len(served) == 4
    for path, text in served.items():
        if path.endswith(".css"):
            assert not re.search(r"url\(\s*['\"]?(?:https?:)?//|@import", text), path


def test_an_unknown_library_is_refused(capsys):
    assert SCRIPT["main"](["leaflet"]) == 2 == SCRIPT["main"](["jquery@3.0.0"])
    assert "NAME@VERSION" in capsys.readouterr().err
