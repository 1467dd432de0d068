"""Random command lines: an exit code that the documentation knows, a sentence that names what is wrong, no traceback.

`scripts/evidence friendly --only command` runs 2000 others. What was found is kept in the tests of its command.
"""

import pytest

from tests.support.fuzzing.command_runs import fuzz_command_lines

SEED = 1


@pytest.mark.parametrize(
    ("count", "seed"),
    [(200, SEED), pytest.param(2000, SEED + 1, marks=[pytest.mark.long, pytest.mark.matrix])],
    ids=["200", "2000"],
)
def test_no_line_ends_in_a_traceback(count, seed, tmp_path):
    out = fuzz_command_lines(count, seed, tmp_path)
    assert out.wrong == {}
    assert out.ended["work begins"] > 0.1 * count and out.ended["exit code 2"] > 0.3 * count


def test_an_undocumented_error_is_seen(monkeypatch, tmp_path):
    def broken(*_):
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr("companion.cli.shore.console.KeyFiles", broken)
    monkeypatch.setattr("companion.cli.boat.wires.open_port_from_url", broken)
    assert any(kind.startswith("ZeroDivisionError") for kind in fuzz_command_lines(60, SEED, tmp_path).wrong)
