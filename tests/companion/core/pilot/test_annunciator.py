"""What people are told as it changes, and for how long the boat may go on blind."""

from msgspec.structs import replace

from companion.core.estimation.health import SETTLES
from companion.core.messages import AnchorRange, OverrideLease, StateEstimate, UwbRanges
from companion.core.pilot import annunciator
from companion.core.pilot.annunciator import AnnunciatorState

S = 1_000_000_000
ESTIMATE = StateEstimate(
    t_ns=0, north_m=0.0, east_m=0.0, psi_rad=0.0, u_m_s=0.0, v_m_s=0.0, r_rad_s=0.0, covariance=(0.0,) * 36,
    accel_bias_m_s2=(0.0, 0.0), gyro_bias_rad_s=0.0, anchor_bias_m={}, disturbance_n=(0.0, 0.0, 0.0),
    health="healthy", reason="",
)  # fmt: skip
LEASE = OverrideLease(
    t_ns=0, index=0, channels=(9,), pwm_us=(1500,), valid_for_s=0.3, source="plan", reason="", f_command_n=(0.0,)
)


def told(step, seen, messages):
    texts = []
    for message in messages:
        seen, alerts = step(seen, message)
        texts.append([(a.level, a.text) for a in alerts])
    return seen, texts


def test_health_is_told_once_per_change():
    sick = replace(ESTIMATE, health="degraded", reason="no UWB for 3.0 s")
    _, texts = told(annunciator.at_estimate, AnnunciatorState(), [ESTIMATE, ESTIMATE, sick, sick, ESTIMATE])
    assert texts == [
        [("info", "state estimate healthy")], [],
        [("warning", "state estimate degraded: no UWB for 3.0 s")], [],
        [("info", "state estimate healthy")],
    ]  # fmt: skip


def test_the_ladder_is_told_when_it_is_entered_and_left_but_not_the_start():
    pd = replace(LEASE, source="pd", reason="no plan in time")
    neutral = replace(LEASE, source="neutral")
    _, texts = told(annunciator.at_lease, AnnunciatorState(), [neutral, LEASE, pd, pd, LEASE, neutral])
    assert texts == [
        [], [], [("warning", "driving by pd: no plan in time")], [], [("info", "the controller's plans are back")], []
    ]  # fmt: skip


def test_an_unknown_anchor_is_told_once():
    cycle = UwbRanges(t_ns=0, t_rx_ns=0, tag="tag", ranges=(
        AnchorRange(anchor="0CA8", range_m=1.0), AnchorRange(anchor="1151", range_m=2.0)))  # fmt: skip
    seen, first = annunciator.at_ranges(AnnunciatorState(), cycle, ("1151", "0ca8"))
    assert len(first) == 1 and "0CA8 is not in the site file (it knows 1151, 0ca8)" in first[0].text
    assert annunciator.at_ranges(seen, cycle, ("1151", "0ca8")) == (seen, [])


def test_blind_counts_from_the_first_degraded_estimate_and_starts_again_when_it_heals():
    sick = [replace(ESTIMATE, health="degraded", t_ns=k * S) for k in range(1, 20)]
    seen, _ = told(annunciator.at_estimate, AnnunciatorState(), sick[:10])
    assert annunciator.degraded_too_long(seen, 16 * S, 15.0) is None
    assert annunciator.degraded_too_long(seen, 17 * S, 15.0) == "state estimate degraded for more than 15 s"
    well = [replace(ESTIMATE, t_ns=k * S) for k in (15, 16, 17)]
    healed, _ = told(annunciator.at_estimate, seen, [*well, sick[18]])
    assert annunciator.degraded_too_long(healed, 25 * S, 15.0) is None


def test_a_first_estimate_may_settle_also_where_the_imu_is_heard_after_the_first_position():
    """Two of nine starts were stopped: 5 s counted from the first estimate, which took 8 s to settle."""
    first = replace(ESTIMATE, health="degraded", reason=f"{SETTLES}; no IMU", t_ns=S)
    settles = [replace(ESTIMATE, health="degraded", reason=SETTLES, t_ns=k * S) for k in range(2, 10)]
    seen, texts = told(annunciator.at_estimate, AnnunciatorState(), [first, *settles])
    assert annunciator.degraded_too_long(seen, 9 * S, 5.0) is None
    assert [len(alerts) for alerts in texts] == [1] + 8 * [0]
    deaf = [replace(first, t_ns=k * S) for k in range(10, 17)]
    seen, _ = told(annunciator.at_estimate, seen, deaf)
    assert annunciator.degraded_too_long(seen, 16 * S, 5.0), "without an IMU it does not settle"
    healed, _ = told(annunciator.at_estimate, seen, [replace(ESTIMATE, t_ns=k * S) for k in (17, 18, 19)])
    late, _ = told(annunciator.at_estimate, healed, [replace(s, t_ns=s.t_ns + 20 * S) for s in settles])
    assert annunciator.degraded_too_long(late, 29 * S, 5.0), "a gap later on counts from its beginning"
