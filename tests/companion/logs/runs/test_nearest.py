"""The nearest stamp, against all of them."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from companion.logs.runs.nearest import distance, nearest

TIMES = st.lists(st.integers(-50, 50), min_size=1, max_size=12)


@given(TIMES.map(sorted), TIMES)
def test_no_other_stamp_is_nearer_and_of_two_the_later_counts(stamps, at):
    stamps, at = np.array(stamps), np.array(at)
    found, away = nearest(stamps, at), np.abs(stamps[:, None] - at)
    assert (distance(stamps, at) == away.min(axis=0)).all()
    assert [stamps[k] for k in found] == [max(s for s in stamps if abs(s - t) == abs(stamps - t).min()) for t in at]
    assert nearest(stamps, at[:, None]).shape == (len(at), 1)
