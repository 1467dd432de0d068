"""Lock files: the boat's is part of the demo's, the demo's of everything; and what installs from them refuses well."""

import os
import re
import subprocess
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
LOCKS = ("requirements.lock", "requirements-demo.lock", "requirements-dev.lock")


def pins(lock: str) -> dict[str, set[str]]:
    """Package -> its versions with hashes; markers, and comments on who needs it, left out."""
    text = re.sub(r"^ +#.*\n| ;.*(?= \\$)", "", (ROOT / lock).read_text(), flags=re.M)
    found: dict[str, set[str]] = {}
    for name, rest in re.findall(r"^([A-Za-z0-9._-]+)==((?:.+\\\n)*.+)$", text, flags=re.M):
        found.setdefault(name, set()).add(rest)
    return found


def normal(requirement: str) -> str:
    return re.sub(r"[-_.]+", "-", re.split(r"[\[<>=!~; ]", requirement)[0]).lower()


@pytest.mark.parametrize(("small", "large"), [LOCKS[:2], LOCKS[1:]])
def test_each_lock_has_all_of_the_one_before_in_the_same_versions(small, large):
    inside, outside = pins(small), pins(large)
    assert len(inside) > 25 and {name: outside.get(name) for name in inside} == inside


def test_every_dependency_is_locked_where_it_is_needed():
    project, build = PROJECT["project"], PROJECT["dependency-groups"]["build"]
    extras = project["optional-dependencies"]
    wanted = {
        LOCKS[0]: [*project["dependencies"], *build],
        LOCKS[1]: [*extras["demo"], *extras["shore"]],
        LOCKS[2]: [name for extra in extras.values() for name in extra],
    }
    for lock, names in wanted.items():
        assert {normal(name) for name in names} - {"aritra"} - pins(lock).keys() == set(), f"{lock}: make lock"


def test_every_pin_has_hashes():
    assert [
        n for lock in LOCKS for n, rests in pins(lock).items() for rest in rests if "--hash=sha256:" not in rest
    ] == []


def test_the_boat_gets_few_packages_and_no_tools():
    assert len(pins(LOCKS[0])) <= 35
    assert not {"pytest", "playwright", "polars", "aiohttp", "sphinx"} & pins(LOCKS[0]).keys()


@pytest.mark.parametrize(
    ("words", "python", "said"),
    [
        ([], "python3", "usage: scripts/install demo|dev"),
        (["boat"], "python3", "usage: scripts/install demo|dev"),
        (["demo"], "/nothing/python3", "aritra needs Python 3.11 or newer: make PYTHON=python3.12"),
        (["demo"], "false", "aritra needs Python 3.11 or newer: make PYTHON=python3.12"),
    ],
)
def test_what_cannot_be_installed_is_refused_before_anything_is_touched(words, python, said):
    before = (ROOT / ".venv").stat().st_mtime_ns if (ROOT / ".venv").exists() else None
    command = [ROOT / "scripts/install", *words]
    env = {**os.environ, "PYTHON": python}
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=20, check=False)
    assert done.returncode == 2 and said in done.stderr
    assert before == ((ROOT / ".venv").stat().st_mtime_ns if (ROOT / ".venv").exists() else None)


def test_from_wherever_cd_may_go_it_installs_its_own_checkout(tmp_path):
    (tmp_path / "scripts").mkdir()
    python = tmp_path / "python"
    python.write_text("#!/bin/sh\npwd >&2\nexit 1\n")
    python.chmod(0o755)
    env = {**os.environ, "PYTHON": str(python), "CDPATH": str(tmp_path)}
    done = subprocess.run(
        ["scripts/install", "demo"], cwd=ROOT, env=env, capture_output=True, text=True, timeout=20, check=False
    )
    assert done.returncode == 2 and done.stderr.splitlines()[0] == str(ROOT)
