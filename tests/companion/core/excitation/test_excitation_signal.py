"""Segments as thruster forces: within limits, of the shape that their kind promises, refused where out of reach."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from companion.core.configuration.tables import ConfigError
from companion.core.control.allocation import force_limits
from companion.core.excitation.file import Idle, Multisine, Opposed, Pulses, Steps, Zigzag
from companion.core.excitation.signal import axis_reach, cancelling, harmonics, multisine, reach, signal
from companion.core.model.thrusters import configuration_matrix
from tests.support.excitation_fixture import LIBRARY, segments, steps
from tests.support.vessel_fixtures import boat

BOATS = ("aritra", "twin", "cse1")


@pytest.mark.parametrize("name", BOATS)
@settings(max_examples=60, deadline=None)
@given(segment=segments, phase=st.floats(0, 1), side=st.sampled_from([1.0, -1.0]))
@pytest.mark.long
def test_forces_never_exceed_the_thrusters_limits(name, segment, phase, side):
    vessel = boat(name)
    try:
        s = signal(segment, vessel, where="x")
    except ConfigError:
        assume(False)
        return
    lower, upper = force_limits(vessel)
    f = s.force(phase * s.duration_s, side)
    assert f.shape == lower.shape and np.isfinite(f).all()
    assert (f >= lower - 1e-9).all() and (f <= upper + 1e-9).all()


@settings(max_examples=40, deadline=None)
@given(segment=steps, phase=st.floats(0, 1))
def test_body_forces_are_what_was_asked_for_or_refused(segment, phase):
    """Oracle: shares times what each axis can do, from corners of the box of thruster forces."""
    vessel, B = boat("aritra"), configuration_matrix(boat("aritra"))
    try:
        s = signal(segment, vessel, where="x")
    except ConfigError:
        return
    row = min(int(phase * len(segment.levels)), len(segment.levels) - 1)
    wanted = np.array([segment.X, segment.Y, segment.N]) * segment.levels[row]
    most = np.array([[107.48, 84.853], [84.853, 84.853], [59.397, 59.397]])  # 4 cos 45 x limits; by hand
    tau = wanted * np.where(wanted >= 0, most[:, 0], most[:, 1])
    got = B @ s.force((row + 0.5) * segment.hold_s, 1.0)
    assert got == pytest.approx(tau, abs=0.02 * (1 + np.abs(tau).max()))


def test_reach_is_that_of_the_corner_by_hand():
    """Pure surge: all four thrusters the same, each cos 45 along x: 4 x 38 and 4 x 30. Pure sway and yaw: the
    weaker direction of the pairs, 30 N."""
    c = np.cos(np.pi / 4)
    assert axis_reach(boat("aritra"))[:2] == pytest.approx(np.array([[4 * 38 * c, 4 * 30 * c], [4 * 30 * c] * 2]))
    assert axis_reach(boat("twin"))[1] == pytest.approx([0, 0])


@given(st.lists(st.floats(-1, 1), min_size=3, max_size=3))
def test_what_reach_says_can_be_done_and_a_little_more_cannot(direction):
    """Oracle: a projection by bounded least squares."""
    from scipy.optimize import lsq_linear

    d = np.array(direction) * (100, 80, 60)
    assume(np.abs(d).max() > 1)
    vessel = boat("aritra")
    B, limits = configuration_matrix(vessel), force_limits(vessel)
    s = reach(d, vessel)
    miss = [np.abs(B @ lsq_linear(B, k * s * d, bounds=limits).x - k * s * d).max() for k in (0.999, 1.02)]
    assert miss[0] < 1e-3 < miss[1]


@given(st.floats(5, 100), st.floats(0.6, 2), st.lists(st.sampled_from([0.0, 0.1]), min_size=3, max_size=3).filter(any))
def test_harmonics_are_disjoint_and_used_up(period_s, f_max, shares):
    s = Multisine(name="x", X=shares[0], Y=shares[1], N=shares[2], period_s=period_s, f_max_Hz=f_max)
    used = [set(k) for k in harmonics(s)]
    assert sum(map(len, used)) == len(set.union(*used)) == int(f_max * period_s + 1e-9)
    assert [bool(k) for k in used] == [share > 0 for share in shares]


@pytest.mark.parametrize("count", [2, 5, 12, 30])
def test_a_multisine_has_its_lines_and_no_others_and_a_low_crest(count):
    k = np.arange(1, 3 * count, 3)
    s = multisine(k)(np.arange(1024) / 1024)
    lines = np.abs(np.fft.rfft(s)) / 512
    assert np.flatnonzero(lines > 1e-9) == pytest.approx(k)
    assert lines[k] == pytest.approx(lines[k[0]])
    assert np.abs(s).max() == pytest.approx(1.0, abs=0.02)
    assert 1 / np.sqrt((s**2).mean()) < 2.1, "Schroeder's phases; random ones give about 3"


def test_opposed_thrusters_give_no_body_force_and_pulses_are_one_thruster_each():
    vessel = boat("aritra")
    B = configuration_matrix(vessel)
    held = signal(Opposed(name="x", levels=(1.0, -0.5), hold_s=1.0), vessel, where="x")
    assert B @ held.force(0.5, 1.0) == pytest.approx(np.zeros(3), abs=1e-9)
    assert np.abs(held.force(0.5, 1.0)).max() == pytest.approx(30.0)
    assert held.force(1.5, 1.0) == pytest.approx(-0.5 * held.force(0.5, 1.0))
    assert cancelling(boat("twin")).shape == (0, 2)
    pulses = signal(Pulses(name="x", levels=(0.5, -0.5), on_s=1.0, off_s=1.0), vessel, where="x")
    on = np.array([pulses.force(2 * i + 0.5, 1.0) for i in range(8)])
    assert (np.count_nonzero(on, axis=1) == 1).all() and on.sum(axis=0) == pytest.approx([4.0] * 4)
    assert not np.any([pulses.force(2 * i + 1.5, 1.0) for i in range(8)])


def test_a_zigzag_turns_to_both_sides_and_idle_does_nothing():
    vessel = boat("aritra")
    s = signal(Zigzag(name="x", X=0.1, N=0.1, switch_deg=10.0, duration_s=9.0), vessel, where="x")
    tau = [configuration_matrix(vessel) @ s.force(1.0, side) for side in (1.0, -1.0)]
    assert tau[0][2] == pytest.approx(-tau[1][2]) and tau[0][2] > 5 and tau[0][0] == pytest.approx(tau[1][0])
    assert s.switch_rad == pytest.approx(np.deg2rad(10))
    assert not signal(Idle(name="x", duration_s=1.0), vessel, where="x").force(0.5, 1.0).any()


@pytest.mark.parametrize(
    ("name", "segment", "told"),
    [
        ("aritra", Steps(name="x", X=0.9, N=0.9, hold_s=1.0), "together ask for more than the thrusters of aritra"),
        ("twin", Steps(name="x", Y=0.1, hold_s=1.0), ".Y: the thrusters of twin give no such force"),
        ("twin", Opposed(name="x", levels=(0.5,), hold_s=1.0), ".kind: no two thrusters of twin"),
        ("twin", Pulses(name="x", thrusters=("bow",), levels=(0.5,), on_s=1, off_s=1), ".thrusters: no thruster 'bow'"),
    ],
)
def test_what_a_boat_cannot_do_is_refused_by_file_and_key(name, segment, told):
    with pytest.raises(ConfigError) as error:
        signal(segment, boat(name), where="plan.toml: segments[3]")
    assert str(error.value).startswith("plan.toml: segments[3]") and told in str(error.value)


def test_the_library_suits_the_reference_boat():
    for segment in LIBRARY.segments:
        assert signal(segment, boat("aritra"), where=segment.name).duration_s <= 40
