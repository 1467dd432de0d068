"""Container image and compose file, read: what is copied exists, commands are understood, nothing listens outside."""

import json
import re
import shlex
import tomllib
from pathlib import Path

import pytest

from companion.__main__ import parser

yaml = pytest.importorskip("yaml", reason="PyYAML is not installed: the extra `dev`")

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "deploy" / "container"
IMAGE = [
    (word, rest)
    for word, _, rest in (line.partition(" ") for line in (FOLDER / "Containerfile").read_text().splitlines())
    if word != "#"
]
COMPOSE = yaml.safe_load((FOLDER / "compose.yaml").read_text())


def all_of(instruction: str) -> list[str]:
    return [rest for word, rest in IMAGE if word == instruction]


def test_the_image_copies_what_the_package_is_made_of():
    copied = [source for rest in all_of("COPY") for source in rest.split()[:-1]]
    assert [name for name in copied if not (ROOT / name).exists()] == []
    packages = re.search(r"^packages = (\[.*\])$", (ROOT / "pyproject.toml").read_text(), flags=re.M)
    assert packages and set(json.loads(packages[1])) | {"LICENSE", "pyproject.toml", "README.md"} <= set(copied)


def test_the_image_is_made_of_known_instructions_and_locked_packages_and_runs_as_nobody_special():
    known = {"FROM", "RUN", "WORKDIR", "COPY", "USER", "VOLUME", "LABEL", "ENTRYPOINT", "CMD"}
    assert {word for word, _ in IMAGE} <= known and IMAGE[0][0] == "FROM"
    installs = [rest for rest in all_of("RUN") if "pip install" in rest]
    assert ["--require-hashes" in rest or "--no-deps" in rest for rest in installs] == [True, True]
    assert all_of("USER") == ["aritra"] and json.loads(*all_of("ENTRYPOINT")) == ["aritra"]
    parser().parse_args(json.loads(*all_of("CMD")))


def test_blueos_finds_what_it_asks_of_an_extension_and_its_container_is_the_console():
    labels = dict(pair.split("=", 1) for rest in all_of("LABEL") for pair in shlex.split(rest))
    assert labels.keys() == {"version", "type", "tags", "requirements", "authors", "company", "permissions"}
    assert labels["version"] == tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert all(isinstance(json.loads(labels[name]), list) for name in ("tags", "authors"))
    created = json.loads(labels["permissions"])  # what Docker's API takes where a container is made
    args = parser().parse_args(created["Cmd"])
    assert args.command == "shore" and args.command_key == [] and "--token" not in created["Cmd"]
    (bind,) = created["HostConfig"]["Binds"]
    assert bind.partition(":")[2] == str(args.logs) and created["HostConfig"]["NetworkMode"] == "host"


@pytest.mark.parametrize("name", COMPOSE["services"])
def test_a_service_has_a_command_that_is_understood(name):
    service = COMPOSE["services"][name]
    args = parser().parse_args(service["command"])
    assert args.command == {"shore": "shore", "boats": "demo"}[name]
    assert service["image"] == "${ARITRA_IMAGE:-aritra}"
    assert service["volumes"] == ["results:/data"] and "results" in COMPOSE["volumes"]


def test_the_console_listens_on_this_machine_alone_and_has_the_boats_keys():
    shore, boats = (COMPOSE["services"][name] for name in ("shore", "boats"))
    assert shore["network_mode"] == boats["network_mode"] == "host" and "ports" not in shore
    assert "--host" not in shore["command"] and "--token" not in shore["command"]
    assert Path(shore["command"][2]) == Path(boats["command"][-1]) and boats["depends_on"] == ["shore"]
    assert (FOLDER / shore["build"]["context"] / shore["build"]["dockerfile"]).resolve() == FOLDER / "Containerfile"
