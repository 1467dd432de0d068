"""Where a run of the App is logged."""

from __future__ import annotations

import pytest


@pytest.fixture
def path(tmp_path):
    return tmp_path / "run.mcap"
