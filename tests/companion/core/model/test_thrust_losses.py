"""Thrust lost to water that moves past: the textbook's formulas, the wake's side, the Jacobians, refused files."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.core.configuration.tables import ConfigError
from companion.core.configuration.vessel_file import Wash
from companion.core.model.effects.wash import jet_sign
from companion.core.model.load_vessel import load_vessel
from companion.core.model.manoeuvring import StructuredModel
from companion.core.model.thrust_losses import apply_thrust_losses, has_thrust_losses
from tests.support.vessel_fixtures import BOATS, boat

BASE = boat("aritra")
NAMES = [t.name for t in BASE.thrusters]
FRONT_PORT, FRONT_STARBOARD, REAR_PORT, REAR_STARBOARD = range(4)
force = st.floats(-30, 38)
velocity = st.tuples(st.floats(-1.5, 1.5), st.floats(-0.8, 0.8), st.floats(-1, 1))


def having(advance=0.0, *wash, share_s_m=0.0, at_N=None):
    pairs = tuple(Wash(behind=NAMES[b], ahead=NAMES[a], share=s, at_N=at_N) for b, a, s in wash)
    lost = {"advance_loss_sqrt_N_s_m": advance, "advance_loss_s_m": share_s_m}
    return replace(BASE, propulsion=replace(BASE.propulsion, **lost, wash=pairs))


def lost(vessel, nu_r, f):
    return np.array(ca.DM(apply_thrust_losses(vessel, ca.DM(nu_r), ca.DM(f)))).ravel()


def test_a_file_without_any_of_it_is_b_f_to_the_last_operation():
    model, f = StructuredModel.of(BASE), ca.SX.sym("f", 4)
    assert not has_thrust_losses(having()) and not has_thrust_losses(having(0.0, (2, 0, 0.0)))
    assert has_thrust_losses(having(0.1)) and has_thrust_losses(having(0.0, (2, 0, 0.1)))
    assert model.is_linear_in_f
    plain = ca.Function("a", [f], [ca.mtimes(ca.DM(model.B), f)])
    assert ca.Function("b", [f], [model.thrust(None, None, f)]).n_instructions() == plain.n_instructions()


@settings(max_examples=60, deadline=None)
@given(velocity, st.lists(force, min_size=4, max_size=4))
def test_advance_loss_is_that_of_a_propeller_with_t_nn_and_t_nu(nu_r, f):
    """T = T_nn n |n| + T_nu |n| u_a with n from the bollard force; u_a by the cross product omega x r."""
    k, T_nn = 0.7, 0.0146
    for i, t in enumerate(BASE.thrusters):
        at = np.array(nu_r)[:2] + np.cross([0, 0, nu_r[2]], [t.x_m, t.y_m, 0])[:2]
        u_a = at @ [np.cos(np.deg2rad(t.azimuth_deg)), np.sin(np.deg2rad(t.azimuth_deg))]
        n = np.sign(f[i]) * np.sqrt(abs(f[i]) / T_nn)
        T = T_nn * n * abs(n) - k * np.sqrt(T_nn) * abs(n) * u_a
        assert lost(having(k), nu_r, f)[i] == pytest.approx(T, abs=0.02 + 0.2 * (abs(f[i]) < 1))


@settings(max_examples=60, deadline=None)
@given(velocity, st.lists(force, min_size=4, max_size=4))
def test_a_share_of_thrust_is_lost_with_each_metre_per_second(nu_r, f):
    """Oracle: f (1 - k u_i), u_i the speed along the way that the thruster pushes; the hidden cases' equation."""
    for i, t in enumerate(BASE.thrusters):
        a = np.deg2rad(t.azimuth_deg)
        at = np.array(nu_r)[:2] + np.cross([0, 0, nu_r[2]], [t.x_m, t.y_m, 0])[:2]
        along = np.sign(f[i]) * (at @ [np.cos(a), np.sin(a)])
        assert lost(having(share_s_m=0.3), nu_r, f)[i] == pytest.approx(f[i] * (1 - 0.3 * along), abs=0.05)


def test_a_wash_may_be_stated_at_another_thrust():
    told = [19.0, 10.0, 8.0, 6.0]
    stated = having(0.0, (REAR_PORT, FRONT_PORT, 0.4 * 30 / 38), at_N=30.0)
    assert lost(stated, (0, 0, 0), told) == pytest.approx(
        lost(having(0.0, (REAR_PORT, FRONT_PORT, 0.4)), (0, 0, 0), told)
    )


def test_at_rest_and_without_force_nothing_is_lost():
    vessel = having(0.7, (REAR_PORT, FRONT_PORT, 0.4))
    assert lost(having(0.7, share_s_m=0.3), (0, 0, 0), (5, -5, 20, 1)) == pytest.approx((5, -5, 20, 1))
    assert not lost(vessel, (1.0, 0.5, 0.5), (0, 0, 0, 0)).any()


def test_wash_weakens_the_one_in_the_jet_by_its_share():
    """Ahead, the front pair blows astern, towards the rear pair; f_max of aritra is 38 N."""
    vessel = having(0.0, (REAR_PORT, FRONT_PORT, 0.4))
    told = np.array([19.0, 10.0, 8.0, 6.0])
    assert lost(vessel, (0, 0, 0), told) == pytest.approx([19, 10, 8 * (1 - 0.4 * 0.5), 6], abs=1e-3)
    assert lost(vessel, (0, 0, 0), [-19, 10, 8, 6]) == pytest.approx([-19, 10, 8, 6], abs=1e-6)
    assert jet_sign(BASE.thrusters[FRONT_PORT], BASE.thrusters[REAR_PORT]) == 1
    assert jet_sign(BASE.thrusters[REAR_PORT], BASE.thrusters[FRONT_PORT]) == -1


def test_wash_never_turns_a_thruster_round():
    vessel = having(0.0, (REAR_PORT, FRONT_PORT, 1.0), (REAR_PORT, FRONT_STARBOARD, 1.0))
    assert lost(vessel, (0, 0, 0), (60, 60, 8, 6))[REAR_PORT] == 0.0


@pytest.mark.parametrize("k", [{"advance": 2.0}, {"share_s_m": 0.35}], ids=str)
def test_jacobians_are_finite_everywhere(k):
    vessel = having(k.get("advance", 0.0), (REAR_PORT, FRONT_PORT, 0.9), share_s_m=k.get("share_s_m", 0.0))
    nu, f = ca.SX.sym("nu", 3), ca.SX.sym("f", 4)
    J = ca.Function("J", [nu, f], [ca.jacobian(apply_thrust_losses(vessel, nu, f), ca.vertcat(nu, f))])
    for at in ((0, 0, 0, 0), (1e-9, 0, -1e-9, 0), (0.05, -0.05, 38, -30)):
        slope = np.array(J(ca.DM([1.0, -0.5, 0.3]), ca.DM(at)))
        assert np.isfinite(slope).all() and np.abs(slope).max() < 15


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        ("slew_N_s = 0.0", r"propulsion.slew_N_s: expected 0.001 to 1e\+06, found 0"),
        ("advance_loss_sqrt_N_s_m = 9.0", r"propulsion.advance_loss_sqrt_N_s_m: expected -5 to 5, found 9"),
        ('wash = [{behind = "bow", ahead = "rear_port", share = 0.1}]', r"propulsion.wash\[0\].behind: no thruster"),
        (
            'wash = [{behind = "rear_port", ahead = "rear_port", share = 0.1}]',
            r"propulsion.wash\[0\].ahead: a thruster",
        ),
        ('wash = [{behind = "rear_port", ahead = "front_port", share = 1.1}]', r"propulsion.wash\[0\].share: expected"),
        ('wash = [{behind = "rear_port", share = 0.1}]', r"propulsion.wash\[0\].ahead: missing key"),
    ],
)
def test_what_cannot_be_is_refused_by_its_key(lines, says):
    text = (BOATS / "aritra.toml").read_text().replace("rate_limit_N_s = 120.0", f"rate_limit_N_s = 120.0\n{lines}")
    with pytest.raises(ConfigError, match=rf"^boat.toml: {says}"):
        load_vessel(text, name="boat.toml")
