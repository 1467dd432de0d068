"""Sizes of folders and files, names of classes, private members in tests, walls between the rooms."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from tests.evidence.house.trees import BASE, ROOT, base_is_here, git
from tests.evidence.line import Line, at_most, exactly, information
from tests.project.house import (
    MOST_LINES,
    MOST_MODULES,
    PRODUCT,
    contracts,
    line_count,
    modules,
    modules_in_folders,
    not_folders,
    outside_studies,
    private_members,
    private_names,
    public_classes,
)

PRODUCT_LINES = 48_000
PRIVATE_MEMBERS = 10
SHOWN = 5


def rooms(full: bool) -> Iterator[Line]:
    """Rooms: sizes of folders and files, names used twice, private members in tests, walls"""
    everything = [*PRODUCT, "deploy", "tests", "scripts"]
    folder, most = modules_in_folders(modules(*everything)).most_common(1)[0]
    yield at_most("modules in the largest folder", most, MOST_MODULES, "", _relative(folder))
    long = {_relative(p): line_count(p) for p in modules(*everything) if line_count(p) > MOST_LINES}
    yield exactly(f"files above {MOST_LINES} lines", len(long), 0, "", _some([f"{p} {n}" for p, n in long.items()]))
    twice = [name for name, places in public_classes(modules(*PRODUCT)).items() if len(places) > 1]
    yield exactly("public class names used twice", len(twice), 0, "", _some(twice))
    names = private_names(modules(*PRODUCT))
    private = [access for path in modules("tests") for access in private_members(path, names)]
    yield at_most("private members of the product used in tests", len(private), PRIVATE_MEMBERS, "", _some(private))
    yield from _walls()
    yield from _lines()


def _walls() -> Iterator[Line]:
    named = contracts((ROOT / ".importlinter").read_text())
    by_folder = [name for name, contract in named.items() if contract and not not_folders(contract)]
    yield exactly("import contracts that name folders only", len(by_folder), len(named), "", f"of {len(named)}")
    program = "import sys; from importlinter.cli import lint_imports_command as c; sys.exit(c())"
    words = [sys.executable, "-c", program]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    yield exactly("import contracts are kept: exit code", done.returncode, 0, "", _last_line(done.stdout))


def _lines() -> Iterator[Line]:
    """Lines of Python now, and at the base commit."""
    product = sum(map(line_count, outside_studies(modules(*PRODUCT, "deploy"))))
    studies = sum(map(line_count, modules("sim/studies")))
    tests = sum(map(line_count, modules("tests", "scripts")))
    before = f"{product:,}; base commit not in this clone"
    before_tests = "base commit not in this clone"
    if base_is_here():
        base = _lines_at_base(*PRODUCT, "deploy")
        before = f"{product:,}; product and studies {base:,} at {BASE}, {product + studies:,} now"
        before_tests = f"{tests:,}; {_lines_at_base('tests', 'scripts'):,} at {BASE}"
    yield at_most("lines of the product", product, PRODUCT_LINES, "", before)
    yield information("lines of the studies", studies)
    yield information("lines of the tests", tests, "", before_tests)


def _lines_at_base(*folders: str) -> int:
    """Lines of all modules below these folders at the base commit."""
    names = [n for n in git("ls-tree", "-r", "--name-only", BASE, *folders).splitlines() if n.endswith(".py")]
    return sum(len(git("show", f"{BASE}:{name}").splitlines()) for name in names)


def _relative(path: Path) -> str:
    return str(path.relative_to(ROOT))


def _some(found: list[str]) -> str:
    more = f" and {len(found) - SHOWN} more" if len(found) > SHOWN else ""
    return ", ".join(found[:SHOWN]) + more


def _last_line(text: str) -> str:
    return (text.strip().splitlines() or [""])[-1]
