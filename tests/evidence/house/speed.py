"""Nothing became slower by moving: the same computations in both trees, in turn."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from tests.evidence.house.trees import BASE, ROOT, base_tree, output, start
from tests.evidence.line import Line, at_most

ROUNDS = 5
GOAL = 1.05
WHAT = ("NMPC over the states of a mission", "structured fit of a 60 s log", "60 s of the stepped world")


def speed(full: bool) -> Iterator[Line]:
    """Speed: processor time here over that at the base commit, median of five rounds in turn"""
    yield from ratios_to(BASE)


def ratios_to(commit: str) -> Iterator[Line]:
    """The three computations here over those at a commit."""
    with base_tree(commit) as base, tempfile.TemporaryDirectory() as folder:
        children = [start(tree, ["rounds"], Path(folder) / str(i)) for i, tree in enumerate((base, ROOT))]
        try:
            for child in children:
                _line_of(child, "")
            seconds = np.array([_round(children, k) for k in range(ROUNDS)])  # (rounds, trees, computations)
            for child in children:
                output(child)
        finally:
            for child in children:
                child.kill()
                child.wait()
    ratios = seconds[:, 1] / seconds[:, 0]
    for k, what in enumerate(WHAT):
        before, now = np.median(seconds[:, :, k], axis=0)
        note = (
            f"{before:.3f} s at {commit}, {now:.3f} s now; ratios {ratios[:, k].min():.3f} to {ratios[:, k].max():.3f}"
        )
        yield at_most(f"{what}: now / before", float(np.median(ratios[:, k])), GOAL, "", note)


def _round(children: list[subprocess.Popen[str]], k: int) -> list[list[float]]:
    """Seconds of each computation in each tree, one tree after the other; who begins alternates."""
    rows = [[0.0] * len(WHAT) for _ in children]
    for i in (0, 1) if k % 2 == 0 else (1, 0):
        rows[i] = [float(word) for word in _line_of(children[i], "go\n").split()]
    return rows


def _line_of(child: subprocess.Popen[str], order: str) -> str:
    """The child's next line, after it was given an order."""
    assert child.stdin and child.stdout
    child.stdin.write(order)
    child.stdin.flush()
    line = child.stdout.readline()
    if not line:
        raise RuntimeError(f"{child.args} ended with {child.wait()}")
    return line
