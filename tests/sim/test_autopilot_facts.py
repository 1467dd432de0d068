"""Every fact of the table holds on the simulated autopilot."""

import facts_protocol
import facts_rc
import facts_wiring
import pytest
from autopilot_facts import FACTS, NOT_SIMULATED

MODULES = facts_wiring, facts_rc, facts_protocol


@pytest.mark.parametrize("row", FACTS, ids=lambda row: row.words)
def test_fact(row):
    row.check()


def test_the_table_is_whole():
    assert {row.check.__module__ for row in FACTS} == {module.__name__ for module in MODULES}
    assert len(FACTS) > 45
    assert len({row.words for row in FACTS}) == len(FACTS)
    assert {row.section for row in FACTS} == set(NOT_SIMULATED)
