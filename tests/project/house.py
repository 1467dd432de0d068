"""What the house rules are about, read from the sources: modules, folders, classes, imports, private members."""

from __future__ import annotations

import ast
from collections import Counter, defaultdict
from collections.abc import Container, Iterable, Iterator
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


def private_names(paths: Iterable[Path]) -> set[str]:
    """Private names of members that the product's classes and modules define."""
    names: set[str] = set()
    for path in paths:
        scopes = [tree_of(path), *(n for n in ast.walk(tree_of(path)) if isinstance(n, ast.ClassDef))]
        names |= {name for scope in scopes for name in _members(scope)}
    return {name for name in names if name.startswith("_") and not name.endswith("__")}


def private_members(path: Path, private: Container[str]) -> list[str]:
    """Accesses `x._name` in a test, `_name` in `private`: x is not self or cls, `_name` not of a class in the file."""
    tree = tree_of(path)
    own = {name for node in ast.walk(tree) if isinstance(node, ast.ClassDef) for name in _members(node)}
    return [
        f"{path.relative_to(ROOT)}:{node.lineno} {ast.unparse(node)}"
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and node.attr in private and node.attr not in own
        and not (isinstance(node.value, ast.Name) and node.value.id in ("self", "cls"))
    ]  # fmt: skip


def _members(node: ast.AST) -> Iterator[str]:
    """Names that a class or module defines: methods, fields, and attributes that are set on self."""
    for part in ast.iter_child_nodes(node) if not isinstance(node, ast.ClassDef) else ast.walk(node):
        if isinstance(part, (ast.FunctionDef, ast.AsyncFunctionDef)):
            yield part.name
        elif isinstance(part, ast.AnnAssign) and isinstance(part.target, ast.Name):
            yield part.target.id
        elif isinstance(part, ast.Assign):
            yield from (n.id for t in part.targets for n in ast.walk(t) if isinstance(n, ast.Name))
        if isinstance(part, ast.Attribute) and isinstance(part.ctx, ast.Store) and ast.unparse(part.value) == "self":
            yield part.attr
