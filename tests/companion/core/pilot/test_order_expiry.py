"""How long an order waits in `starting`."""

import pytest

from companion.core.pilot.modes import MODES, WANTED, ModeState
from companion.core.pilot.order_expiry import NOBODY_S, WAITS_S, expiry, has_expired
from companion.core.pilot.state import PilotState

S = 1_000_000_000


def waiting(mode="starting", wanted="auto", ordered_ns=5 * S):
    helm = ModeState(mode, wanted, "no heartbeat")
    return PilotState(estimator=None, monitors={}, f_command_n=(), helm=helm, ordered_ns=ordered_ns)


@pytest.mark.parametrize(("heartbeat_ns", "limit_s"), [(None, NOBODY_S), (S, NOBODY_S), (1000 * S, WAITS_S)])
def test_it_waits_so_long_and_no_longer(heartbeat_ns, limit_s):
    until_ns = 5 * S + round(limit_s * S)
    assert expiry(waiting(), heartbeat_ns, until_ns) is None
    for order, wanted in WANTED.items():
        why = expiry(waiting(wanted=wanted), heartbeat_ns, until_ns + 1)
        assert why == f"{order} expired after {limit_s:.0f} s (no heartbeat): give it again"
        assert why and has_expired(order, why) and not has_expired("manual", why)


def test_a_short_silence_long_after_the_order_is_waited_for():
    assert expiry(waiting(), 60 * S, 69 * S) is None
    assert expiry(waiting(), 60 * S, 71 * S)


def test_only_an_order_that_waits_expires():
    for mode in set(MODES) - {"starting"}:
        assert expiry(waiting(mode), None, 1000 * S) is None
    assert expiry(waiting(ordered_ns=None), None, 1000 * S) is None
