"""Ranges that repeat themselves are left out, and others are not."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from companion.core.messages import AnchorRange, UwbPosition, UwbRanges
from companion.core.pilot.trust.sensors.repeated_ranges import RepeatedRangesMonitor

S = 1_000_000_000


def ranges(t_s, *values):
    told = tuple(AnchorRange(anchor=f"A{i}", range_m=v) for i, v in enumerate(values))
    return UwbRanges(t_ns=round(t_s * S), t_rx_ns=round(t_s * S), tag="tag", ranges=told)


def heard(messages):
    """What each message came to: None (as it is), the message instead, or "withheld"; and all alerts."""
    monitor, out, alerts = RepeatedRangesMonitor(), [], []
    state = monitor.initial
    for message in messages:
        state, report = monitor.on_message(state, message, message.t_ns)
        out.append("withheld" if report.withhold else report.instead)
        alerts += [(a.t_ns / S, a.level, a.text) for a in report.alerts]
    return out, alerts


def test_a_tag_that_repeats_itself_is_left_out_at_once_and_told_after_a_moment():
    out, alerts = heard([ranges(0, 1.0, 2.0), *(ranges(k, 1.5, 2.5) for k in range(1, 6)), ranges(6, 1.6, 2.4)])
    assert out == [None, None, *["withheld"] * 4, None]  # two repeats of two anchors are no chance, one may be
    assert [(t, level) for t, level, _ in alerts] == [(3, "error"), (6, "info")] and "repeats" in alerts[0][2]


def test_four_anchors_that_all_repeat_themselves_are_told_of_at_once():
    _, alerts = heard([ranges(k, 1.0, 2.0, 3.0, 4.0) for k in range(2)])
    assert [(t, level) for t, level, _ in alerts] == [(1, "error")]


def test_a_tag_that_renews_its_ranges_once_a_second_and_says_them_ten_times_is_not_told_of():
    _, alerts = heard([ranges(k / 10, 5.0 + k // 10, 6.0 + k // 10) for k in range(60)])
    assert alerts == []


def test_one_anchor_that_hangs_costs_that_anchor():
    out, alerts = heard([ranges(k, 5.0, 2.0 + 0.01 * k, 3.0 - 0.02 * k) for k in range(8)])
    assert out[:5] == [None] * 5
    assert all([r.anchor for r in m.ranges] == ["A1", "A2"] for m in out[5:])
    assert len(alerts) == 1 and "anchor A0" in alerts[0][2]


@given(seed=st.integers(0, 1000), rate=st.sampled_from([1.0, 10.0]))
def test_a_boat_at_rest_loses_next_to_nothing_to_chance(seed, rate):
    """At 1 cm and 0.1 m of noise; of 300 cycles with four anchors."""
    rng = np.random.default_rng(seed)
    out, alerts = heard([ranges(k / rate, *np.round(10.0 + rng.normal(0, 0.1, 4), 2)) for k in range(300)])
    assert sum(o is not None for o in out) <= 2 and not [a for a in alerts if "tag repeats" in a[2]]


def test_positions_of_a_tag_that_repeats_itself_are_left_out_too():
    place = [(1.0, 2.0), (1.1, 2.0), *[(1.1, 2.0)] * 3, (1.2, 2.1)]
    told = [UwbPosition(t_ns=k * S, t_rx_ns=k * S, tag="t", x_m=x, y_m=y, z_m=0.0) for k, (x, y) in enumerate(place)]
    out, alerts = heard(told)
    assert out == [None, None, *["withheld"] * 3, None]
    assert [(t, level) for t, level, _ in alerts] == [(3, "error"), (5, "info")]
