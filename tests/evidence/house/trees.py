"""Two trees of the project side by side: a worktree of the base commit, and this checkout; programs in either."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
BASE = os.environ.get("ARITRA_BASE", "77ec2d3")
"""The commit to compare with: the last one before every module got its folder."""
DRIVER = Path(__file__).with_name("driver.py")


def git(*words: str, root: Path = ROOT) -> str:
    """What git says; CalledProcessError where it fails."""
    done = subprocess.run(["git", "-C", str(root), *words], check=True, capture_output=True, text=True)
    return done.stdout


def base_is_here(base: str | None = None) -> bool:
    """Whether the base commit is in this clone."""
    if not shutil.which("git"):
        return False
    words = ["git", "-C", str(ROOT), "cat-file", "-e", f"{base or BASE}^{{commit}}"]
    return subprocess.run(words, check=False, capture_output=True).returncode == 0


@contextmanager
def base_tree(base: str | None = None) -> Iterator[Path]:
    """A worktree of a commit (None: BASE) in a temporary folder; LookupError where this clone lacks the commit."""
    base = base or BASE
    if not base_is_here(base):
        raise LookupError(f"commit {base} is not in this clone: fetch it, or name another one in ARITRA_BASE")
    with tempfile.TemporaryDirectory(prefix="aritra-base-") as folder:
        tree = Path(folder) / "tree"
        git("worktree", "prune")
        git("worktree", "add", "--detach", "--quiet", str(tree), base)
        try:
            yield tree
        finally:
            git("worktree", "remove", "--force", str(tree))


def start(tree: Path, words: Sequence[str], cache: Path) -> subprocess.Popen[str]:
    """`driver.py WORDS` with the packages of a tree, one thread, and machine code kept in `cache`."""
    env = {**os.environ, "PYTHONPATH": str(tree), "ARITRA_CACHE": str(cache), "OMP_NUM_THREADS": "1"}
    # -P: the folder of the driver is no place to import from
    command = [sys.executable, "-P", str(DRIVER), str(tree), *words]
    return subprocess.Popen(command, cwd=tree, env=env, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE)


def output(child: subprocess.Popen[str]) -> str:
    """All that a child prints until it ends; RuntimeError where it fails."""
    text, _ = child.communicate()
    if child.returncode:
        raise RuntimeError(f"{child.args}: exit code {child.returncode}")
    return text
