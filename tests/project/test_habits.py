"""Habits that this project keeps, held by reading its source."""

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


MOST_PRIVATE = 10
"""Two of pymavlink's own, the senders of a bench; a few more may come with a reason."""


def trees(top, words):
    """(file, what it says) of the Python in a folder that has one of these words in it: parsing is what takes long."""
    for file in sorted((ROOT / top).rglob("*.py")):
        if any(word in (text := file.read_text(encoding="utf-8")) for word in words):
            yield str(file.relative_to(ROOT)), ast.parse(text)


def private(name):
    return name.startswith("_") and not name.endswith("_") and name not in ("_replace", "_asdict", "_fields", "_make")


def own(node):
    """Whether it is an object's way to itself: self, cls, super()."""
    name = node.func if isinstance(node, ast.Call) else node
    return isinstance(name, ast.Name) and name.id in ("self", "cls", "super")


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


def calls(names, *tops):
    """(place, call) of every call of methods of these names in these folders."""
    for file, tree in (one for top in tops for one in trees(top, names)):
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in names:
                yield f"{file}:{node.lineno}", node


def test_tests_of_the_product_s_private_parts_are_few():
    found = [
        f"{file}:{line}: {name}"
        for file, tree in trees("tests", ("._", " _", "attr("))
        for line, name in privates(tree)
    ]
    assert len(found) <= MOST_PRIVATE, found


def test_privates_are_seen_however_they_are_reached():
    tree = ast.parse("a._b\nfrom c import _d\npatch.setattr(e, '_f', 1)\nself._g\nsuper()._h\ni.__j__\nk._replace()")
    assert sorted(privates(tree)) == [(1, "_b"), (2, "_d"), (3, "_f")]


def test_text_files_are_read_and_written_in_one_encoding_whatever_the_language():
    texts = list(calls(("read_text", "write_text"), "companion", "drivers", "sim"))
    assert [at for at, call in texts if "encoding" not in [word.arg for word in call.keywords]] == []
    assert len(texts) > 10
