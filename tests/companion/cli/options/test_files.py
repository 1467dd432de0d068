"""Files of the wrong kind are named as what they are; those that could be right are left to their readers."""

import argparse
import os

import pytest

from companion.boat.load_run import EXAMPLES
from companion.cli.options import files
from companion.core.configuration import file_kinds as kinds
from tests.companion.command_line import exit_code

OURS = {
    "run_file": "aritra.toml",
    "vessel_file": "boats/twin.toml",
    "site_file": "sites/basin.toml",
    "mission_file": "missions/square.toml",
    "excitation_file": "excitations/library.toml",
    "campaign_file": "campaigns/weak_thruster.toml",
}


def refusal(kind, path) -> str:
    with pytest.raises(argparse.ArgumentTypeError) as refused:
        kind(str(path))
    assert str(refused.value).startswith(f"{path}: ")
    return str(refused.value)


@pytest.mark.parametrize("wanted", OURS)
@pytest.mark.parametrize("given", OURS)
def test_our_own_files_are_told_apart(wanted, given):
    kind, path = getattr(files, wanted), EXAMPLES / OURS[given]
    if wanted == given:
        assert kind(str(path)) == path
    else:
        told = refusal(kind, path)
        assert given.split("_")[0] in told.split(";")[0] and wanted.split("_")[0] in told.split("expected")[1]


def test_every_file_that_comes_with_the_package_is_known():
    for folder, kind in (("boats", kinds.VESSEL), ("sites", kinds.SITE), ("missions", None),
                         ("excitations", kinds.EXCITATION), ("campaigns", kinds.CAMPAIGN)):  # fmt: skip
        for path in (EXAMPLES / folder).iterdir():
            found = kinds.kind_of_file(path.read_bytes())
            assert found == kind if kind else found in (kinds.MISSION, "a GeoJSON file"), path
    assert {kinds.kind_of_file((EXAMPLES / name).read_bytes()) for name in ("aritra.toml", "on-board.toml")} == {
        kinds.RUN
    }
    assert all((EXAMPLES.parent / path).is_file() for path in kinds.EXAMPLES.values())


@pytest.mark.parametrize("name", ["square.plan", "square.waypoints", "square.geojson", "square.toml"])
def test_a_mission_has_four_formats(name):
    assert files.mission_file(str(EXAMPLES / "missions" / name)).name == name


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"", "is empty"),
        (b"\x89MCAP0\r\n\x00", "is an MCAP log"),
        (b"\xa3\x95\x80\x80" + b"\x00" * 9, "is an ArduPilot log"),
        (b"\x89PNG\r\n", "is a picture"),
        (b"PAR1....", "is a Parquet table"),
        (b"<!DOCTYPE html><p>", "is an HTML page"),
        (b'{"a": 1}', "is a JSON file"),
        (bytes(range(32)), "is binary data"),
        ('name = "x"'.encode("utf-16"), "is text in UTF-16, not in UTF-8"),
        (b"\x00" * 7 + b"\x01\xfd" + b"\x09" * 20, "is a telemetry log"),
    ],
)
def test_what_is_no_vessel_file_is_named(tmp_path, content, told):
    (tmp_path / "x").write_bytes(content)
    assert told in refusal(files.vessel_file, tmp_path / "x")


def test_what_its_reader_must_judge_is_let_through(tmp_path):
    for content in (b"format = 1\nname = 'mine'\n", b"format = [", b"# only a comment"):
        (tmp_path / "x").write_bytes(content)
        assert files.vessel_file(str(tmp_path / "x")) and files.any_log(str(tmp_path / "x"))


def test_no_file_a_folder_a_device_a_name_that_cannot_be(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for path, told in ((tmp_path / "none", "No such file"), (tmp_path, "is a folder"), ("/dev/zero", "no regular"),
                       (tmp_path / "pipe", "no regular"), ("a\0b", "null byte"), ("x" * 300, "too long")):  # fmt: skip
        assert told in refusal(files.vessel_file, path)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("log", "info", EXAMPLES / "aritra.toml"), "LOG: .*is a run file; expected a log of `aritra run`"),
        (
            ("run", "--config", EXAMPLES / "boats/cse1.toml"),
            "--config: .*is a vessel file; expected a run file",
        ),
        (("excite", "info", EXAMPLES / "missions/square.plan"), "PLAN: .*is a mission; expected an excitation file"),
        (("diagnose", "x", "--catalogue", EXAMPLES / "aritra.toml"), "LOG: x: No such file"),
    ],
)
def test_the_command_names_option_file_and_kinds(words, told, capsys):
    assert exit_code(*words) == 2
    import re

    assert re.search(told, capsys.readouterr().err)
