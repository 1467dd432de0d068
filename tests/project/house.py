"""What the house rules are about, read from the sources: modules, folders, classes, imports, private members."""

from __future__ import annotations

import ast
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from configparser import ConfigParser
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PRODUCT = ("companion", "drivers", "sim")
STUDIES = ROOT / "sim/studies"
MOST_MODULES, MOST_LINES, FAMILY = 15, 300, 3


def modules(*rooms: str, root: Path = ROOT) -> Iterator[Path]:
    """Every module below these folders of the root."""
    for room in rooms:
        yield from sorted((root / room).rglob("*.py"))


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


def outside_studies(paths: Iterable[Path]) -> list[Path]:
    """All of these but research."""
    return [path for path in paths if STUDIES not in path.parents]


def line_count(path: Path) -> int:
    return len(path.read_text().splitlines())


def modules_in_folders(paths: Iterable[Path]) -> Counter[Path]:
    """Number of modules beside each other in every folder, `__init__` not counted."""
    return Counter(path.parent for path in paths if path.stem != "__init__")


def public_classes(paths: Iterable[Path]) -> dict[str, list[Path]]:
    """Name of every public class at the top of a module -> where it is defined."""
    places = defaultdict(list)
    for path in paths:
        for node in tree_of(path).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(path)
    return dict(places)


def families(paths: Iterable[Path]) -> dict[Path, dict[str, list[str]]]:
    """Folder -> word -> modules called `word_...`, where they are at least three: what a name holds together."""
    groups: dict[Path, dict[str, list[str]]] = defaultdict(lambda: defaultdict(list))
    for path in paths:
        word, underscore, _ = path.stem.partition("_")
        if word and underscore:
            groups[path.parent][word].append(path.stem)
    wide = {
        folder: {word: sorted(stems) for word, stems in words.items() if len(stems) >= FAMILY}
        for folder, words in groups.items()
    }
    return {folder: words for folder, words in wide.items() if words}


def contracts(text: str) -> dict[str, dict[str, list[str]]]:
    """Name of each import contract -> its lists: source_modules, containers."""
    parser = ConfigParser()
    parser.read_string(text)
    lists = ("source_modules", "containers")
    return {
        parser[section]["name"]: {key: parser[section][key].split() for key in lists if key in parser[section]}
        for section in parser.sections()
        if section.startswith("importlinter:contract:")
    }


def not_folders(contract: dict[str, list[str]], root: Path = ROOT) -> list[str]:
    """Source modules and containers of a contract that are no folders with an `__init__`."""
    named = [name for names in contract.values() for name in names]
    return [name for name in named if not (root / name.replace(".", "/") / "__init__.py").is_file()]


def imports(path: Path) -> Iterator[str]:
    """Dotted names that a module imports, anywhere in it."""
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def path_changes(path: Path) -> list[int]:
    """Lines that touch `sys.path`, in any spelling of the import."""
    lines = []
    for node in ast.walk(tree_of(path)):
        whole = isinstance(node, ast.Attribute) and ast.unparse(node) == "sys.path"
        part = isinstance(node, ast.ImportFrom) and node.module == "sys" and any(a.name == "path" for a in node.names)
        syspath = isinstance(node, ast.Attribute) and node.attr == "syspath_prepend"
        lines += [node.lineno] if whole or part or syspath else []
    return lines


def private_members(path: Path) -> list[str]:
    """Accesses `x._name` of a test, where x is not self or cls and `_name` is no member of a class in the same file.

    Names that begin and end with two underscores are Python's, not the product's.
    """
    tree = tree_of(path)
    own = {name for node in ast.walk(tree) if isinstance(node, ast.ClassDef) for name in _members(node)}
    accesses = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and node.attr.startswith("_") and not node.attr.endswith("__"):
            owner = node.value.id if isinstance(node.value, ast.Name) else ""
            if owner not in ("self", "cls") and node.attr not in own:
                accesses.append(f"{path.relative_to(ROOT)}:{node.lineno} {ast.unparse(node)}")
    return accesses


def _members(node: ast.ClassDef) -> Iterator[str]:
    """Names that a class defines: methods, fields, and attributes that it sets on self."""
    for part in ast.walk(node):
        if isinstance(part, (ast.FunctionDef, ast.AsyncFunctionDef)):
            yield part.name
        elif isinstance(part, ast.AnnAssign) and isinstance(part.target, ast.Name):
            yield part.target.id
        elif isinstance(part, ast.Assign):
            yield from (target.id for target in part.targets if isinstance(target, ast.Name))
        if isinstance(part, ast.Attribute) and isinstance(part.ctx, ast.Store) and ast.unparse(part.value) == "self":
            yield part.attr
