"""docs/architecture.md against the code: folders, import contracts, layers, modes, rungs; and paths in every page."""

import ast
import configparser
import importlib
import re
from pathlib import Path
from typing import get_args, get_type_hints

import pytest

from companion.core.messages import OverrideLease
from companion.core.pilot.modes import MODES, THRUSTERS

ROOT = Path(__file__).resolve().parents[2]
ARCHITECTURE = ROOT / "docs" / "architecture.md"
TOPS = ("companion", "drivers", "sim", "deploy", "scripts", "tests")
PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "SECURITY.md", *(ROOT / "docs").rglob("*.md")])


def section(title: str) -> str:
    return ARCHITECTURE.read_text().split(f"\n## {title}\n")[1].split("\n## ")[0]


def first_column(text: str) -> list[str]:
    """What stands in backticks at the head of each row of a section's tables."""
    return re.findall(r"^\| `([^`]+)` \|", text, flags=re.M)


def folders() -> set[str]:
    """Every folder of the project that holds files of its own, as in `drivers/uwb/`."""
    files = [f for top in TOPS for f in (ROOT / top).rglob("*") if f.is_file() and "__pycache__" not in f.parts]
    return {f"{f.parent.relative_to(ROOT).as_posix()}/" for f in files}


def test_the_map_names_every_folder_and_no_other():
    named, there = first_column(section("Map of rooms")), folders()
    mirrors = {f for f in there if f.startswith("tests/") and any(t.startswith(f[6:]) for t in there) and f != "tests/"}
    assert len(named) == len(set(named)), "each folder once"
    assert there - mirrors - set(named) == set(), "the map lacks folders"
    assert set(named) - there == set(), "the map names folders that are not there"


def contracts() -> configparser.ConfigParser:
    parser = configparser.ConfigParser()
    parser.read(ROOT / ".importlinter")
    return parser


def test_import_contracts_are_those_of_the_linter():
    found = [name.rpartition(":")[2] for name in contracts().sections() if "contract" in name]
    assert first_column(section("Who may import whom")) == found


@pytest.mark.parametrize(("contract", "word"), [("layers", "core"), ("fitting", "fitting")])
def test_layers_are_those_of_the_linter(contract, word):
    block = re.search(rf"^{word}: (.+?)(?:\n\n|\n```)", section("Who may import whom"), flags=re.M | re.S)
    assert block
    shown = [line.strip() for line in block[1].splitlines()]
    assert shown == contracts()[f"importlinter:contract:{contract}"]["layers"].split("\n")[1:]


def test_modes_and_what_their_thrusters_do():
    rows = re.findall(r"^\| `(\w+)` \| (\w+) \|$", section("Modes: who may drive"), flags=re.M)
    assert [mode for mode, _ in rows] == list(MODES)
    assert dict(rows) == THRUSTERS


def test_rungs_of_the_fallback_ladder_are_sources_of_leases():
    sources = get_args(get_type_hints(OverrideLease)["source"])
    assert first_column(section("Fallback ladder")) == [s for s in sources if s not in ("excitation", "manual")]


@pytest.mark.parametrize(
    "words",
    [
        "gate that rejects a range", "thrusters go neutral", "a DVL", "thrust map of a T200", "mission file is parsed",
        "writes the log", "the model's damping", "STOP does on the boat", "cause of the diagnosis is defined",
        "times out overrides",
    ],
)  # fmt: skip
def test_the_index_answers(words):
    row = next(line for line in section("Where is ...?").splitlines() if words in line)
    assert "](" in row, "with a link, which another test follows"


NOT_HERE = {"my_effects.py", "companion/data"}
"""A user's own file in an example; a place that a decision did not take."""


def spans(page: Path) -> list[str]:
    """What stands in backticks, blocks left out."""
    return re.findall(r"`([^`\n]+)`", re.sub(r"^```.*?^```", "", page.read_text(), flags=re.M | re.S))


def paths(page: Path) -> list[str]:
    """Paths of this project in a page: with a folder, or the name of a module alone."""
    words = [word for span in spans(page) for word in re.findall(r"(?<![\w~$/<>.-])[\w.-]+(?:/[\w.-]+)*/?", span)]
    inside = [word.rstrip("/.") for word in words if "/" in word and word.split("/")[0] in TOPS]
    return inside + [word for word in words if re.fullmatch(r"\w+\.py", word)]


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_paths_in_a_page_exist(page):
    names = {f.name for top in TOPS for f in (ROOT / top).rglob("*.py")}
    for path in set(paths(page)) - NOT_HERE:
        assert (ROOT / path).exists() or path in names, f"{page.name}: {path}"


def resolves(dotted: str) -> bool:
    """Whether a dotted name is a module, or something in one."""
    parts = dotted.split(".")
    for n in range(len(parts), 0, -1):
        place = ROOT.joinpath(*parts[:n])
        if (place / "__init__.py").exists() or place.with_suffix(".py").exists():
            found = importlib.import_module(".".join(parts[:n]))
            return n == len(parts) or hasattr(found, parts[n])
    return False


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_modules_named_in_a_page_exist(page):
    for span in spans(page):
        for dotted in re.findall(r"(?<![\w./])(?:companion|drivers|sim|tests)(?:\.\w+)+", span):
            assert resolves(dotted), f"{page.name}: {dotted}"


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_imports_in_examples_work(page):
    for block in re.findall(r"^```python\n(.*?)^```", page.read_text(), flags=re.M | re.S):
        for node in ast.walk(ast.parse(block)):
            if isinstance(node, ast.ImportFrom) and node.module:
                module = importlib.import_module(node.module)
                assert [a.name for a in node.names if not hasattr(module, a.name)] == [], f"{page.name}: {node.module}"


def test_paths_are_found():
    assert len(paths(ARCHITECTURE)) > 50


def test_every_term_of_the_glossary_has_its_module():
    rows = [line for line in (ROOT / "docs" / "glossary.md").read_text().splitlines() if line.startswith("| ")]
    rows = [row for row in rows if not row.startswith("| term |")]
    terms = [row.split(" | ")[0] for row in rows]
    assert len(terms) > 90 and len(terms) == len(set(terms))
    for row in rows:
        module = re.fullmatch(r"\| [^|]+ \| [^|]+ \| `([^`]+)` \|", row)
        assert module and (ROOT / module[1]).is_file(), row


def test_numbers_of_the_method_are_those_of_the_code():
    rows = re.findall(r"^\| `([\w.]+)` \| ([\d., ]+) \|", (ROOT / "docs" / "method.md").read_text(), flags=re.M)
    assert len(rows) > 12
    for dotted, value in rows:
        module, _, name = dotted.rpartition(".")
        found = getattr(importlib.import_module(module), name)
        wanted = [float(number) for number in value.split(",")]
        assert list(found if isinstance(found, tuple) else (found,)) == wanted, dotted


def anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as they are made for Markdown on the usual forges."""
    titles = re.findall(r"^#+ (.+)$", re.sub(r"^```.*?^```", "", page.read_text(), flags=re.M | re.S), flags=re.M)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_anchors_of_links_exist(page):
    for target, anchor in re.findall(r"\]\(([^)\s#:]*)#([^)\s]+)\)", page.read_text()):
        there = page.parent / target if target else page
        if there.suffix == ".md":
            assert anchor in anchors(there), f"{page.name}: {target}#{anchor}"
