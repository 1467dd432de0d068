"""Habits that this project keeps, held by reading its source."""

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


MOST_PRIVATE = 10
"""Two of pymavlink's own, the senders of a bench; a few more may come with a reason."""


@cache
def trees(top):
    """(file, what it says) of all Python in a folder."""
    files = sorted((ROOT / top).rglob("*.py"))
    return [(str(file.relative_to(ROOT)), ast.parse(file.read_text(encoding="utf-8"))) for file in files]


def private(name):
    return name.startswith("_") and not name.endswith("_") and name not in ("_replace", "_asdict", "_fields", "_make")


def own(node):
    """Whether it is an object's way to itself: self, cls, super()."""
    return (isinstance(node, ast.Name) and node.id in ("self", "cls")) or ast.unparse(node) == "super()"


def privates(tree):
    """(line, name) of what belongs to others and is used, imported or patched though its name begins with _."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and private(node.attr) and not own(node.value):
            yield node.lineno, node.attr
        if isinstance(node, ast.ImportFrom):
            yield from ((node.lineno, name.name) for name in node.names if private(name.name))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr.endswith("attr"):
            texts = [word.value for word in node.args if isinstance(word, ast.Constant) and isinstance(word.value, str)]
            yield from ((node.lineno, text) for text in texts if any(map(private, text.split("."))))


def calls(*tops):
    """(place, name of the function, call) of every call in these folders."""
    for file, tree in (one for top in tops for one in trees(top)):
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                yield f"{file}:{node.lineno}", node.func.attr, node


def test_tests_of_the_product_s_private_parts_are_few():
    found = [f"{file}:{line}: {name}" for file, tree in trees("tests") for line, name in privates(tree)]
    assert len(found) <= MOST_PRIVATE, found


def test_privates_are_seen_however_they_are_reached():
    tree = ast.parse("a._b\nfrom c import _d\npatch.setattr(e, '_f', 1)\nself._g\nsuper()._h\ni.__j__\nk._replace()")
    assert sorted(privates(tree)) == [(1, "_b"), (2, "_d"), (3, "_f")]


def test_text_files_are_read_and_written_in_one_encoding_whatever_the_language():
    texts = [
        (at, call) for at, name, call in calls("companion", "drivers", "sim") if name in ("read_text", "write_text")
    ]
    assert [at for at, call in texts if "encoding" not in [word.arg for word in call.keywords]] == []
    assert len(texts) > 10
