"""The documentation as a site: built without a warning, complete, and read and searched without a network."""

import re
import runpy
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.console_fixture import chromium

core = pytest.importorskip("docutils.core", reason="the extra `docs` is not installed")
pytest.importorskip("sphinx", reason="the extra `docs` is not installed")
pytest.importorskip("furo", reason="the extra `docs` is not installed")
pytest.importorskip("myst_parser", reason="the extra `docs` is not installed")

ROOT = Path(__file__).resolve().parents[2]
DOCSTRINGS = runpy.run_path(str(ROOT / "docs/site/docstrings.py"))
ELSEWHERE = re.compile(
    r"""<(?:script|img|link|iframe)[^>]+(?:src|href)=["'](?:https?:)?//|@import|url\(["']?(?:https?:)?//"""
)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    out = tmp_path_factory.mktemp("docs") / "site"
    done = subprocess.run(
        [sys.executable, "-P", ROOT / "scripts/docs", out], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return out


@pytest.mark.long
def test_every_page_and_every_package_is_there(site):
    pages = [ROOT / "README.md", ROOT / "CHANGELOG.md", *(ROOT / "docs").rglob("*.md")]
    assert [p for p in pages if not (site / p.relative_to(ROOT)).with_suffix(".html").is_file()] == []
    rooms = [
        init.parent.relative_to(ROOT)
        for top in ("companion/core", "drivers")
        for init in (ROOT / top).rglob("__init__.py")
    ]
    assert len(rooms) > 15 and [r for r in rooms if not (site / "api" / f"{'.'.join(r.parts)}.html").is_file()] == []
    model = (site / "api/companion.core.model.html").read_text()
    assert "StructuredModel" in model and "The 3-DOF manoeuvring model" in model


@pytest.mark.long
def test_links_to_files_of_the_project_lead_to_copies_as_text(site):
    links = re.findall(r'href="\.\./(files/[^"]+)"', (site / "docs/architecture.html").read_text())
    assert len(links) > 20 and [link for link in links if not (site / link).is_file()] == []


@pytest.mark.long
def test_nothing_is_loaded_from_elsewhere(site):
    loud = [f for kind in ("*.html", "*.css") for f in site.rglob(kind) if ELSEWHERE.search(f.read_text())]
    assert loud == []


@pytest.mark.long
def test_search_works_from_a_folder(site):
    if shutil.which("chromium") is None:
        pytest.skip("there is no Chromium on this machine")
    with chromium() as browser:
        page, asked = browser.new_page(), []
        page.on("request", lambda request: asked.append(request.url))
        page.goto(f"file://{site}/search.html?q=riccati")
        page.wait_for_selector("#search-results li a")
        assert "companion.core.control.rti" in page.inner_text("#search-results")
        assert asked and [url for url in asked if not url.startswith(("file:", "data:"))] == []


def test_a_folder_with_other_things_is_left_alone(tmp_path, capsys):
    (tmp_path / "thesis.tex").write_text("years")
    assert runpy.run_path(str(ROOT / "scripts/docs"))["main"]([str(tmp_path)]) == 2
    assert (tmp_path / "thesis.tex").read_text() == "years" and "must be new" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("lines", "wanted"),
    [
        (["Rate of `x`, *not* |x|."], ["Rate of ``x``\\ , \\*not\\* \\|x\\|.", ""]),
        (["As", "", "    a = b*c", "      d"], ["As", "", "::", "", "        a = b*c", "          d", ""]),
        (["- one", "  more", "- two"], ["- one", "  more", "", "- two", ""]),
        (["x_ and `f_` \\"], ["x\\_ and ``f_``\\  \\\\", ""]),
    ],
)  # fmt: skip
def test_docstrings_are_plain_text(lines, wanted):
    made = DOCSTRINGS["as_restructured_text"](lines)
    assert made == wanted
    settings = {"report_level": 1, "halt_level": 1}  # any remark of docutils is an error
    core.publish_doctree("\n".join(made), settings_overrides=settings)
