"""Every fact of the table holds on the simulated autopilot."""

import pytest

from tests.sim.world.autopilot.facts import protocol, rc, wiring
from tests.sim.world.autopilot.facts.facts import FACTS, NOT_SIMULATED

MODULES = wiring, rc, protocol


@pytest.mark.parametrize("row", FACTS, ids=lambda row: row.words)
def test_fact(row):
    row.check()


def test_the_table_is_whole():
    assert {row.check.__module__ for row in FACTS} == {module.__name__ for module in MODULES}
    assert len(FACTS) > 45
    assert len({row.words for row in FACTS}) == len(FACTS)
    assert {row.section for row in FACTS} == set(NOT_SIMULATED)
