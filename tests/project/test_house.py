"""The rules of the house: how large files and folders are, what names mean, who imports whom. Each rule can fail."""

from __future__ import annotations

import textwrap

import pytest

from tests.project.house import (
    MOST_LINES,
    MOST_MODULES,
    PRODUCT,
    ROOT,
    contracts,
    families,
    imports,
    line_count,
    modules,
    modules_in_folders,
    not_folders,
    outside_studies,
    path_changes,
    private_members,
    private_names,
    public_classes,
)

EVERYWHERE = (*PRODUCT, "tests", "scripts", "deploy")
CONTRACTS = contracts((ROOT / ".importlinter").read_text())


def relative(paths):
    return [str(path.relative_to(ROOT)) for path in paths]


@pytest.fixture
def tree(tmp_path):
    """Write modules, given as path -> source; their paths."""

    def write(**sources):
        paths = [tmp_path / f"{name.replace('__', '/')}.py" for name in sources]
        for path, source in zip(paths, sources.values(), strict=True):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(textwrap.dedent(source))
        return paths

    return write


# --- the house ---------------------------------------------------------------------------------------------


def test_no_folder_has_more_than_15_modules_beside_each_other():
    counts = modules_in_folders(modules(*EVERYWHERE))
    assert {str(f.relative_to(ROOT)): n for f, n in counts.items() if n > MOST_MODULES} == {}


def test_no_file_has_more_than_300_lines():
    long = [path for path in modules(*EVERYWHERE) if line_count(path) > MOST_LINES]
    assert {name: line_count(ROOT / name) for name in relative(long)} == {}


@pytest.mark.long
def test_public_classes_have_names_of_their_own():
    places = public_classes(modules(*PRODUCT))
    assert len(places) > 300
    assert {name: relative(paths) for name, paths in places.items() if len(paths) > 1} == {}


def test_no_family_of_modules_is_held_together_by_a_prefix():
    found = families(outside_studies(modules(*PRODUCT)))
    assert {str(folder.relative_to(ROOT)): words for folder, words in found.items()} == {}


@pytest.mark.parametrize("name", CONTRACTS)
def test_import_contracts_name_folders(name):
    assert CONTRACTS[name]
    assert not_folders(CONTRACTS[name]) == []


def test_nobody_imports_the_studies():
    outside = outside_studies(modules(*PRODUCT))
    assert relative(p for p in outside if any(f"{name}.".startswith("sim.studies.") for name in imports(p))) == []


@pytest.mark.long
def test_no_test_changes_the_path_of_imports():
    assert {name: path_changes(ROOT / name) for name in relative(modules("tests")) if path_changes(ROOT / name)} == {}


# --- each rule can fail ------------------------------------------------------------------------------------


def test_modules_are_counted_by_folder(tree):
    paths = tree(a__one="", a__two="", a__b__three="")
    (paths[0].parent / "__init__.py").touch()
    counts = modules_in_folders(modules("a", root=paths[0].parents[1]))
    assert sorted(counts.values()) == [1, 2]


def test_lines_are_counted(tree):
    (path,) = tree(long="x = 1\n" * (MOST_LINES + 1))
    assert line_count(path) == MOST_LINES + 1


def test_a_public_class_used_twice_is_seen(tree):
    paths = tree(
        a="class Point: ...\nclass _Own: ...", b="class Point: ...\nclass _Own: ...\ndef f():\n    class In: ..."
    )
    assert public_classes(paths) == {"Point": paths}


def test_a_family_is_three_of_one_word(tree):
    names = ("a__log_read", "a__log_write", "a__log_to_text", "a__log", "a__logs_x", "b__log_read", "b__log_write")
    paths = tree(**dict.fromkeys(names, ""))
    assert families(paths) == {paths[0].parent: {"log": ["log_read", "log_to_text", "log_write"]}}


def test_a_contract_that_names_a_module_is_seen(tree):
    (path,) = tree(a__b__c="")
    (path.parent / "__init__.py").touch()
    (_, read), *_ = contracts("[importlinter:contract:x]\nname = X\nsource_modules =\n    a.b\n    a.b.c\n").items()
    assert not_folders(read, path.parents[2]) == ["a.b.c"]


def test_imports_are_seen_wherever_they_stand(tree):
    (path,) = tree(a="from sim import studies\ndef f():\n    import sim.studies.paper")
    assert list(imports(path)) == ["sim.studies", "sim.studies.paper"]


@pytest.mark.parametrize(
    "line", ["sys.path.insert(0, '.')", "sys.path = []", "from sys import path", "monkeypatch.syspath_prepend('.')"]
)
def test_changes_of_the_path_are_seen(tree, line):
    assert path_changes(*tree(a=line)) == [1]


def test_private_members_are_those_of_the_product(monkeypatch, tree):
    product, path = tree(
        product="""
        _cache = {}
        class Thing:
            _busy: bool
            def __init__(self): self._inner, self._set, self.open = 1, 2, 3
            def _method(self): local._other = 1
        """,
        test="""
        class Own:
            def _method(self): self._set = self._busy
        Own()._method(), own._set
        thing._busy, thing.__dict__, row._replace(a=1), thing.part._inner
        module._cache
        """,
    )
    private = private_names([product])
    assert private == {"_cache", "_busy", "_inner", "_set", "_method"}
    monkeypatch.setattr("tests.project.house.ROOT", path.parent)
    seen = [access.partition(" ")[2] for access in private_members(path, private)]
    assert sorted(seen) == ["module._cache", "thing._busy", "thing.part._inner"]
