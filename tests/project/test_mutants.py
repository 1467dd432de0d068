"""`scripts/mutants` knows where modules and their tests are, and breaks a module in ways that its tests notice."""

import ast
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = runpy.run_path(str(ROOT / "scripts/mutants"))


@pytest.mark.parametrize("module", SCRIPT["TESTS"])
def test_every_module_of_the_table_is_there_and_has_tests(module):
    assert (ROOT / "companion/core" / f"{module.replace('.', '/')}.py").is_file()
    assert SCRIPT["tests_of"](module)


def test_short_names_are_unique():
    assert len(SCRIPT["SHORT"]) == len(SCRIPT["TESTS"])


def test_a_pattern_without_tests_is_an_error():
    SCRIPT["TESTS"]["nothing"] = ("pilot/test_nothing*.py",)
    with pytest.raises(LookupError, match=r"nothing: no test is called pilot/test_nothing\*\.py"):
        SCRIPT["tests_of"]("nothing")
    del SCRIPT["TESTS"]["nothing"]


def test_changes_of_a_comparison_a_number_and_a_function():
    source = "def f(x):\n    return min(x, 3) if x > 2.0 else -x\n"
    found = {
        (words, ast.unparse(tree).splitlines()[1].strip()) for _, words, tree in SCRIPT["mutants"](ast.parse(source))
    }
    assert ("Gt -> GtE", "return min(x, 3) if x >= 2.0 else -x") in found
    assert ("3 -> 4", "return min(x, 4) if x > 2.0 else -x") in found
    assert ("min -> max", "return max(x, 3) if x > 2.0 else -x") in found
    assert ("minus dropped", "return min(x, 3) if x > 2.0 else +x") in found
    assert all(tree != source.splitlines()[1].strip() for _, tree in found)


def test_an_unknown_module_is_refused():
    done = subprocess.run(
        [sys.executable, ROOT / "scripts/mutants", "hearing"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2 and "invalid choice: 'hearing'" in done.stderr and "link_latency" in done.stderr
