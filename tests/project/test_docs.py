"""The documents keep up with the code: keys, terms, topics, links, command lines, and the form of the ADRs."""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from companion.__main__ import parser
from companion.cli.options import files
from companion.core.configuration import run_file, sensors, site_file, vessel_file
from companion.core.excitation import file as excitation_file
from companion.core.model.loads import REGISTRY
from companion.logs.schema import KINDS
from drivers.uwb import CODECS

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = sorted([ROOT / "README.md", ROOT / "CHANGELOG.md", ROOT / "SECURITY.md", *DOCS.rglob("*.md")])
ADRS = sorted((DOCS / "adr").glob("*.md"))
SECTIONS = ["Decision", "Why", "Alternatives", "Consequence"]


def quoted(text: str) -> set[str]:
    """Every word that stands in `code`, also several in one pair of backticks."""
    spans = re.findall(r"(?<!`)(`+)(?!`)(.+?)(?<!`)\1(?!`)", text)
    return {word for _, span in spans for word in re.findall(r"[\w./-]+", span)}


def keys(module) -> set[str]:
    """Keys of every table that a module defines."""
    tables = [t for t in vars(module).values() if isinstance(t, type) and issubclass(t, msgspec.Struct)]
    return {field.encode_name for t in tables if t.__module__ == module.__name__ for field in msgspec.structs.fields(t)}


@pytest.mark.parametrize(
    ("module", "page"),
    [
        (vessel_file, "vessel-file.md"),
        (sensors, "vessel-file.md"),
        (run_file, "run-file.md"),
        (site_file, "run-file.md"),
        (excitation_file, "excite.md"),
    ],
)
def test_every_key_is_in_its_reference(module, page):
    assert len(keys(module)) > 5
    assert keys(module) - quoted((DOCS / page).read_text()) == set()


def test_every_term_parameter_and_wire_format_is_in_the_reference():
    words = quoted((DOCS / "vessel-file.md").read_text())
    wanted = {*REGISTRY, *CODECS, *(p.name for term in REGISTRY.values() for p in term.parameters)}
    assert wanted - words == set()


def test_every_term_is_listed_with_its_bounds_and_default():
    text = (DOCS / "vessel-file.md").read_text()
    for term in REGISTRY.values():
        for p in term.parameters:
            row = f"| `{p.name}` | {p.unit} | {p.default:g} | {p.lower:g} to {p.upper:g} |"
            assert row in text, row


def test_every_topic_is_in_the_reference():
    assert set(KINDS) - quoted((DOCS / "logs.md").read_text()) == set()


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_relative_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
        if not re.match(r"[a-z]+:|#", target):
            assert (page.parent / target.partition("#")[0]).exists(), f"{page.name}: {target}"


def command_lines() -> Iterator[tuple[str, str]]:
    """(page, line) of every `aritra ...` shown, in a block or in a sentence."""
    for page in PAGES:
        text = page.read_text()
        blocks = re.findall(r"^```\w*\n(.*?)^```", text, flags=re.M | re.S)
        lines = [line.strip() for block in blocks for line in block.splitlines()]
        spans = re.findall(r"`(aritra [^`]+)`", re.sub(r"^```.*?^```", "", text, flags=re.M | re.S))
        for line in [*lines, *(" ".join(span.split()) for span in spans)]:
            if found := re.match(r"(?:\$ )?(?:\.venv/bin/)?aritra( .+)", line):
                yield page.name, found[1]


def test_command_lines_are_found():
    assert len(list(command_lines())) > 15


@pytest.mark.parametrize(("page", "line"), sorted(set(command_lines())))
def test_command_lines_parse(page, line, capsys, monkeypatch):
    monkeypatch.setattr(files, "head_of", lambda path: b"a file of any kind")
    words = shlex.split(line, comments=True)
    if len(words) == 1 or words == ["log", words[-1]]:  # a command named in a sentence: its help exists
        words.append("--help")
    try:
        parser().parse_args(words)
    except SystemExit as end:
        assert end.code == 0, f"{page}: aritra{line}: {capsys.readouterr().err}"


def test_adrs_are_numbered_without_gaps():
    assert [int(adr.name[:4]) for adr in ADRS] == list(range(1, len(ADRS) + 1))


@pytest.mark.parametrize("adr", ADRS, ids=lambda p: p.stem)
def test_adrs_have_their_sections(adr):
    text = adr.read_text()
    assert re.match(rf"# {int(adr.name[:4])}\. \S", text)
    assert re.findall(r"^## (.+)$", text, flags=re.M) == SECTIONS
    assert all(len(part.split()) >= 10 for part in text.split("\n## ")[1:])
    assert len(text.split()) <= 400, "half a page to a page"
