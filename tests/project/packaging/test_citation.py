"""What others need to cite, use and type-check the project: licence, citation, classifiers, `py.typed`."""

import re
import tomllib
from pathlib import Path

import pytest

yaml = pytest.importorskip("yaml", reason="PyYAML is not installed: the extra `dev`")
classifiers = pytest.importorskip(
    "trove_classifiers", reason="trove-classifiers is not installed: requirements-dev.lock"
)

ROOT = Path(__file__).resolve().parents[3]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text())
ROOT_KEYS = {"abstract", "authors", "cff-version", "keywords", "license", "message", "title", "type", "version"}
"""Those that we use, of the keys that the Citation File Format 1.2.0 allows at the top."""


def test_the_citation_has_the_form_of_its_format():
    assert CITATION["cff-version"] == "1.2.0" and CITATION["type"] == "software"
    assert CITATION.keys() == ROOT_KEYS
    assert all(isinstance(CITATION[key], str) for key in ROOT_KEYS - {"authors", "keywords"})
    assert all(list(author) == ["name"] for author in CITATION["authors"])


def test_the_citation_says_what_the_package_says():
    assert CITATION["version"] == PROJECT["version"] and CITATION["license"] == PROJECT["license"] == "MIT"
    assert CITATION["authors"] == PROJECT["authors"] == [{"name": "The Aritra authors"}]


@pytest.mark.parametrize("page", ["CITATION.cff", "docs/paper.md"])
def test_the_paper_has_its_full_title(page):
    title = "Data driven identification and model predictive control for a catamaran surface vessel"
    assert title in " ".join((ROOT / page).read_text().split())


def test_licence_files_are_there():
    assert (ROOT / "LICENSE").read_text().startswith("MIT License\n\nCopyright (c) 2026 The Aritra authors\n")
    assert sum(len(list(ROOT.glob(pattern))) for pattern in PROJECT["license-files"]) == 3


def test_classifiers_exist():
    assert set(PROJECT["classifiers"]) <= classifiers.classifiers


@pytest.mark.parametrize("package", ["companion", "drivers", "sim"])
def test_packages_are_typed(package):
    assert (ROOT / package / "py.typed").is_file()


def test_the_changelog_has_the_unreleased_and_this_version():
    headings = re.findall(r"^## (.+)$", (ROOT / "CHANGELOG.md").read_text(), flags=re.M)
    assert headings[0] == "Unreleased" and PROJECT["version"] == headings[1].split()[0]
