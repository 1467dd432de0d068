"""Ranges that come late, or are turned, are said to be so; a current, a compass and a model that are off are not."""

import cmath
import math
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from companion.core.configuration.site_file import Anchor
from companion.core.constants import GRAVITY_M_S2
from companion.core.messages import AnchorRange, ImuSample, OperatorCommand, UwbRanges
from companion.core.pilot.trust.sensors.path_check import PathMonitor, PathState
from tests.companion.core.pilot.monitors.monitor_fixture import view
from tests.support.drive_fixture import setup
from tests.support.vessel_fixtures import boat

S = 1_000_000_000
CORNERS_M = ((0.0, 0.0), (0.0, 40.0), (40.0, 0.0), (40.0, 40.0))
ANCHORS = tuple(
    Anchor(id=f"a{i}", north_m=n, east_m=e, down_m=-2.0, source="assumed") for i, (n, e) in enumerate(CORNERS_M)
)


def course(t_s):
    """Heading, speed ahead and specific force (ahead, to starboard) of a boat that speeds up to and fro in a curve."""
    psi, u = 0.15 * t_s, 0.6 + 0.4 * math.sin(0.8 * t_s)
    return psi, u, (0.32 * math.cos(0.8 * t_s), 0.15 * u)


def found(delay_s=0.0, *, flow=0.0, scale=1.0, compass_rad=0.0, bias=0.0, place=lambda at: at, rate_Hz=1, end_s=40.0,
          seed=1, **shown):  # fmt: skip
    """Monitor's state after the boat was watched with ranges so late and the rest off; `place`: where they put the tag;
    `shown`: of the view.
    """
    vessel = boat("aritra")
    uwb = replace(vessel.sensors.uwb, x_m=0.3, y_m=0.0, z_m=0.0)
    sensors = replace(vessel.sensors, uwb=uwb)
    site = replace(setup(None).pilot.site, anchors=ANCHORS)
    monitor, state, rng = PathMonitor(sensors, site), PathState(), np.random.default_rng(seed)
    places, at = [], np.array([15.0, 15.0])
    for k in range(round(10 * end_s)):
        t_ns, (psi, u, force) = k * S // 10, course(k / 10)
        at = at + 0.1 * (u * np.array([math.cos(psi), math.sin(psi)]) + (0.0, flow))
        places.append(at + 0.3 * np.array([math.cos(psi), math.sin(psi)]))
        sample = ImuSample(
            t_ns=t_ns, t_rx_ns=t_ns, ax_m_s2=force[0] + bias, ay_m_s2=force[1], az_m_s2=-GRAVITY_M_S2, p_rad_s=0.0,
            q_rad_s=0.0, r_rad_s=0.15, source="RAW_IMU",
        )  # fmt: skip
        state, _ = monitor.on_message(state, sample, t_ns)
        if k % round(10 / rate_Hz) == 0:
            tag = place(places[max(0, k - round(10 * delay_s))])
            ranges = tuple(
                AnchorRange(
                    anchor=a.id, range_m=math.dist((*tag, 0.0), (a.north_m, a.east_m, a.down_m)) + rng.normal(0, 0.1)
                )
                for a in ANCHORS
            )
            state, _ = monitor.on_message(state, UwbRanges(t_ns=t_ns, t_rx_ns=t_ns, tag="t", ranges=ranges), t_ns)
        belief = SimpleNamespace(x=np.array([*place(at), psi + compass_rad, u, 0.0, 0.15]), tilt=(0.0, 0.0))
        seen = replace(view(t_ns), **{"belief": belief, "model_nu": (scale * u, 0.0, 0.15), "driving": True, **shown})
        state, _ = monitor.on_tick(state, seen)
    return state


@pytest.mark.parametrize("rate_Hz", [1, 10])
@pytest.mark.parametrize("delay_s", [1.0, 1.5])
def test_ranges_that_come_late_are_found_with_their_delay(delay_s, rate_Hz):
    (finding,) = found(delay_s, rate_Hz=rate_Hz).findings
    assert finding.what == "position" and f"about {delay_s:g} s late" in finding.text
    assert finding.t_ns <= 20 * S


def turned(degrees):
    turn = cmath.rect(1.0, math.radians(degrees))
    return lambda at: np.array([(z := 20 + 20j + turn * (complex(*at) - 20 - 20j)).real, z.imag])


@pytest.mark.parametrize("rate_Hz", [1, 10])
@pytest.mark.parametrize("degrees", [90, 180, -120])
def test_ranges_of_anchors_that_stand_elsewhere_are_found_with_the_turn(degrees, rate_Hz):
    state = found(place=turned(degrees), rate_Hz=rate_Hz)
    (finding,) = state.findings
    side = "starboard" if degrees > 0 else "port"
    assert state.untrusted and finding.what == "position"
    assert f"about {abs(degrees)} degrees to {side}" in finding.text or degrees == 180
    assert finding.t_ns <= 8 * S


@pytest.mark.parametrize("off", [{"compass_rad": 1.2}, {"place": lambda at: at[::-1]}])
def test_so_are_a_compass_that_is_far_off_and_mirrored_anchors(off):
    assert found(**off).untrusted


@pytest.mark.parametrize("scale", [-1.0, 0.0, 2.0])
def test_thrusters_that_do_not_obey_are_not_taken_for_it(scale):
    assert not found(scale=scale).findings


OFF = {
    "nothing": {},
    "a current": {"flow": 0.2},
    "a model that is a quarter too slow": {"scale": 0.75},
    "a compass": {"compass_rad": 0.2},
    "the accelerometer": {"bias": 0.1},
}


@pytest.mark.long
@pytest.mark.parametrize("rate_Hz", [1, 10])
@pytest.mark.parametrize("off", OFF)
def test_what_else_may_be_off_makes_no_delay(off, rate_Hz):
    for seed in range(3):
        assert not found(rate_Hz=rate_Hz, seed=seed, **OFF[off]).findings


@pytest.mark.parametrize("shown", [{"learning": True}, {"thrusters_suspected": "front_port"}, {"driving": False}])
def test_it_is_not_judged_by_a_model_that_nobody_believes(shown):
    assert not found(1.5, **shown).findings


def test_what_may_be_a_turn_keeps_thrusters_from_being_blamed():
    state = found(place=turned(60), end_s=3.6)
    assert state.is_suspect and not state.findings
    assert found(place=turned(60), end_s=5.6).findings
    assert not found().is_suspect and not found(scale=0.75).is_suspect


def test_a_path_that_was_reckoned_with_thrusters_that_did_not_obey_is_forgotten():
    assert not found(place=turned(90), thrusters_changed=True).path


def test_a_new_start_forgets_it_and_a_stop_does_not():
    state, monitor = found(1.5), PathMonitor(boat("aritra").sensors, setup(None).pilot.site)
    for command, kept in (("stop", True), ("start", False)):
        after, _ = monitor.on_message(state, OperatorCommand(t_ns=0, command=command), 0)
        assert bool(after.findings) == kept


def test_ranges_that_wait_for_an_imu_wait_for_as_long_as_they_tell_something():
    """A night with the autopilot off and the tag on."""
    monitor, state = PathMonitor(boat("aritra").sensors, setup(None).pilot.site), PathState()
    seen = replace(view(0), belief=SimpleNamespace(), driving=False)
    for k in range(100):
        m = UwbRanges(t_ns=k * S, t_rx_ns=k * S, tag="t", ranges=(AnchorRange(anchor="a0", range_m=5.0),))
        state, _ = monitor.on_message(state, m, k * S)
        state, _ = monitor.on_tick(state, replace(seen, t_ns=k * S))
    assert 10 < len(state.cycles) < 15


def test_numbers_that_are_none_are_not_kept():
    monitor, state = PathMonitor(boat("aritra").sensors, setup(None).pilot.site), PathState()
    rates = {"p_rad_s": 0.0, "q_rad_s": 0.0, "r_rad_s": 0.0, "source": "RAW_IMU"}
    sample = ImuSample(t_ns=0, t_rx_ns=0, ax_m_s2=math.inf, ay_m_s2=0.0, az_m_s2=0.0, **rates)
    ranges = UwbRanges(t_ns=0, t_rx_ns=0, tag="t", ranges=(AnchorRange(anchor="a0", range_m=math.nan),))
    for message in (sample, ranges):
        assert monitor.on_message(state, message, 0)[0] is state
