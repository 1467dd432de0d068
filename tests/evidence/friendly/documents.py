"""Evidence for what people read: documentation builds without a warning, the notebook runs, logs are in the page."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator

from tests.evidence.house.trees import ROOT
from tests.evidence.line import Line, at_least, exactly
from tests.evidence.pytest_counts import counts, failures

TESTS = {
    "documentation built, searched, links followed": "tests/project/test_docs_site.py",
    "example notebook, run cell by cell": "tests/project/test_notebook.py",
    "logs in the page: listed, downloaded, opened": "tests/processes/console/test_console_logs.py",
}


def documents(full: bool) -> Iterator[Line]:
    """`make docs`, the notebook, the list of logs: by their tests, in processes of their own"""
    for what, path in TESTS.items():
        pytest = [sys.executable, "-P", "-m", "pytest", "-q", path]
        done = subprocess.run(pytest, cwd=ROOT, capture_output=True, text=True, check=False)
        found, failed = counts(done.stdout), failures(done.stdout)
        yield at_least(f"{what}: tests passed", found["passed"], 1)
        wrong = len(failed) + found["skipped"] + (done.returncode != 0)
        yield exactly("... failed or skipped", wrong, 0, note="; ".join(failed))


PARTS = (documents,)
