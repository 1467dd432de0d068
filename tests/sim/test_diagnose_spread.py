"""What of long logs is fitted: so much and no more, from everywhere, and nothing twice."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from run_logs import clean_run

from sim.diagnose.clock import Clock
from sim.diagnose.spread import LONGEST_S, PIECE_S, spread
from sim.identify.job_split import Log, Split, Used


def found(*lengths_s: float) -> Split:
    """Logs of which all is fitted."""
    logs = [Log(f"log {i}", clean_run(seconds, i)) for i, seconds in enumerate(lengths_s)]
    used = tuple(Used(log, ((0.0, seconds),), ()) for log, seconds in zip(logs, lengths_s, strict=True))
    return Split(tuple(log.run for log in logs), (), used, "all")


def lasting(some: Split) -> float:
    return sum(high - low for used in some.used for low, high in used.fitted_s)


def test_what_is_short_is_fitted_whole():
    short = found(400.0, 500.0)
    assert spread(short) is short


@settings(max_examples=8, deadline=None)
@given(st.lists(st.integers(60, 1800), min_size=1, max_size=3).filter(lambda some: sum(some) > LONGEST_S))
def test_of_long_logs_so_much_is_fitted_and_from_everywhere(lengths_s):
    """Seconds of the pieces; none overlap; no two neighbours that are left out lie further apart than the share."""
    some = spread(found(*map(float, lengths_s)))
    assert lasting(some) == pytest.approx(LONGEST_S, abs=1.5 * PIECE_S)
    assert len(some.fitted) == sum(len(used.fitted_s) for used in some.used)
    gap_s = PIECE_S * (sum(lengths_s) / LONGEST_S + 2)
    for used in some.used:
        edges = [edge for interval in used.fitted_s for edge in interval]
        assert (np.diff(edges) > 0).all()
        assert all(after[0] - before[1] <= gap_s for before, after in pairwise(used.fitted_s))
    if len(lengths_s) == 1:
        assert {Clock.of(some.fitted).ahead_s(piece) for piece in some.fitted} == {0.0}, (
            "pieces of one log keep its clock"
        )


def test_the_rule_says_what_was_left_out():
    assert "of 40 minutes to fit, pieces of 50 s" in spread(found(2400.0)).rule
