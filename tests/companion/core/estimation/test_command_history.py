"""Commands of channels with dead times of their own, against one timeline for each channel."""

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from companion.core.estimation.command_history import TimedCommand, active_command, insert_command

MS = 1_000_000
GIVEN = st.lists(st.tuples(st.integers(0, 400), st.floats(-9, 9), st.floats(-9, 9)), min_size=1, max_size=12)


@given(GIVEN, st.sampled_from([(0.1, 0.05), (0.0, 0.3), (0.2, 0.2)]), st.integers(0, 900))
def test_each_channel_follows_its_own_timeline(given_, dead_s, at_ms):
    """The oracle: a command of a channel acts from its instant on, and replaces what was to follow it there."""
    start = TimedCommand(-(1 << 62), np.zeros(2))
    line, alone = (start,), [(start,), (start,)]
    for t_ms, *f in given_:
        line = insert_command(line, t_ms * MS, tuple(f), np.array(dead_s))
        for i in range(2):
            alone[i] = insert_command(alone[i], t_ms * MS, (f[i],) * 2, dead_s[i])
    for t_ns in (at_ms * MS, at_ms * MS + 1):
        now, until_ns = active_command(line, t_ns)
        for i in range(2):
            assert now[i] == active_command(alone[i], t_ns)[0][0]
        assert until_ns is None or until_ns > t_ns
    assert all(a.acts_ns < b.acts_ns for a, b in pairwise(line))
