"""The evidence for the house can fail: another log is another digest, a base that is not here is an error."""

import math
import sys
import tempfile

import pytest

from tests.evidence.house import closed_loop, suite, trees
from tests.evidence.house.rooms import rooms


@pytest.mark.long
def test_the_same_seed_is_the_same_log_and_another_seed_another(tmp_path):
    once = closed_loop.digests(trees.output(trees.start(trees.ROOT, ["log", "1", "1", "2"], tmp_path)))
    again = closed_loop.digests(trees.output(trees.start(trees.ROOT, ["log", "1", "1", "2"], tmp_path)))
    assert once == again
    assert once[1][0] != once[2][0] and min(count for _, count in once.values()) > 100


def test_a_driver_that_fails_is_an_error(tmp_path):
    with pytest.raises(RuntimeError, match="exit code 1"):
        trees.output(trees.start(trees.ROOT, ["log", "not a number"], tmp_path))


def test_a_log_that_differs_falls_short(monkeypatch, tmp_path):
    logs = iter([{seed: f"{seed} {seed}00 9000" for seed in closed_loop.SEEDS} for _ in range(2)])
    changed = {3: "3 333 9000"}
    texts = ["\n".join(next(logs).values()), "\n".join((next(logs) | changed).values())]
    monkeypatch.setattr(closed_loop, "base_tree", tempfile.TemporaryDirectory)
    monkeypatch.setattr(closed_loop, "start", lambda tree, words, cache: texts.pop(0))
    monkeypatch.setattr(closed_loop, "output", lambda text: text)
    *_, same = closed_loop.closed_loop(False)
    assert same.figure == 9 and not same.holds and same.note.endswith("differ: 3")


def test_a_base_that_is_not_in_the_clone_is_an_error(monkeypatch):
    monkeypatch.setattr(trees, "BASE", "0" * 40)
    with pytest.raises(LookupError, match="is not in this clone"), trees.base_tree():
        pass


def test_a_suite_that_fails_falls_short_and_is_counted():
    python = sys.executable
    good = suite.run_suite(trees.ROOT, python, "-c", "print('3 passed, 1 skipped\\n2 passed in 3 s')")
    assert (good.exit_code, good.passed, good.skipped) == (0, 5, 1)
    bad = suite.run_suite(trees.ROOT, python, "-c", "print('1 failed, 3 passed'); raise SystemExit(1)")
    assert [line.holds for run in (good, bad) for line in run.lines("suite")] == [True, False]
    assert [line.judged for line in suite.suite(False)] == [False]


@pytest.mark.long
def test_sizes_are_those_of_this_checkout():
    figures = {line.what: line.figure for line in rooms(False)}
    assert 5 <= figures["modules in the largest folder"] < math.inf
    assert figures["lines of the product"] > figures["lines of the studies"] > 0
