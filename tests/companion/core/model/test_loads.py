"""Munk moment, tether, shallow zone: by hand, by energy, and refused where they would feed the hull."""

from dataclasses import replace as replace_field

import casadi as ca
import numpy as np
import pytest
from msgspec.structs import replace
from scipy.integrate import quad

from companion.core.configuration.tables import ConfigError
from companion.core.model.effects.cross_flow import most_negative_C_d
from companion.core.model.integrate import BufferedStep, step_function
from companion.core.model.load_vessel import load_vessel
from companion.core.model.loads import REGISTRY
from companion.core.model.manoeuvring import StructuredModel, coefficients, damping_force, mass_matrix
from tests.support.vessel_fixtures import BOATS, boat

TEXT = (BOATS / "aritra.toml").read_text()
TETHER = {"north_m": 4.0, "east_m": -1.0, "slack_m": 1.5, "stiffness_N_m": 3.0}
ZONE = {"north_m": 0.5, "east_m": 0.0, "radius_m": 2.0, "share": 1.5}


def having(**terms):
    return replace(boat("aritra"), terms={name: {**p, "source": "test"} for name, p in terms.items()})


def text_with(table):
    return f'{TEXT}\n{table}\nsource = "test"\n'


def pull(vessel, eta, nu=(0.0, 0.0, 0.0)):
    """Force of the terms and the damping beside those of the plain boat, shape (3,)."""
    ours, plain = StructuredModel.of(vessel), StructuredModel.of(boat("aritra"))
    args = ca.DM(np.array(eta, dtype=float)), ca.DM(np.array(nu, dtype=float)), ca.DM.zeros(3)
    return mass_matrix(vessel) @ (np.array(ours.nu_dot(*args)) - np.array(plain.nu_dot(*args))).ravel()


@pytest.mark.parametrize("psi", [0.0, 1.1, -2.5])
def test_a_tether_pulls_towards_its_anchor_and_only_when_taut(psi):
    """From (1, 3) the anchor at (4, -1) is 5 m away: 3.5 m of stretch, 10.5 N along (0.6, -0.8)."""
    X, Y, N = pull(having(tether=TETHER), (1.0, 3.0, psi))
    c, s = np.cos(psi), np.sin(psi)
    assert [c * X - s * Y, s * X + c * Y, N] == pytest.approx([6.3, -8.4, 0.0], abs=1e-9)
    for near in ((4.0, -1.0), (4.9, -2.0)):
        assert pull(having(tether=TETHER), (*near, psi)) == pytest.approx([0, 0, 0], abs=1e-12)


@pytest.mark.parametrize("psi", [0.0, 1.1, -2.5])
def test_a_tether_at_the_stern_turns_the_boat_by_the_cross_product(psi):
    """Fastened 0.6 m aft: r x F about the origin, taut from that place on."""
    X, Y, N = pull(having(tether=TETHER | {"x_t_m": -0.6}), (1.0, 3.0, psi))
    place = np.array([1.0, 3.0]) - 0.6 * np.array([np.cos(psi), np.sin(psi)])
    line = np.array([4.0, -1.0]) - place
    far = np.hypot(*line)
    north, east = 3.0 * (far - 1.5) * line / far
    c, s = np.cos(psi), np.sin(psi)
    assert [c * X - s * Y, s * X + c * Y] == pytest.approx([north, east], abs=1e-9)
    arm = place - np.array([1.0, 3.0])
    assert pytest.approx(arm[0] * east - arm[1] * north, abs=1e-9) == N


def test_cross_flow_is_the_integral_over_the_hull():
    """Oracle: quadrature of the drag per length; 12 strips are within 2 %."""
    vessel = having(cross_flow={"C_d": 0.8})
    half = vessel.hull.length_m / 2
    for nu in ((0.3, 0.4, 0.0), (0.0, 0.0, 0.5), (-0.5, 0.2, -0.6)):

        def drag(x, nu=nu):
            w = nu[1] + x * nu[2]
            return -0.5 * 1000.0 * 0.8 * 1.5 * vessel.hull.draft_m * abs(w) * w

        Y, N = quad(drag, -half, half)[0], quad(lambda x: x * drag(x), -half, half)[0]
        assert pull(vessel, (0, 0, 0.3), nu) == pytest.approx([0.0, Y, N], rel=0.02, abs=0.1)


def test_a_current_turns_by_the_clock_and_stands_where_there_is_none():
    flow = {"V_c_m_s": 0.2, "beta_c_deg": 30.0, "turn_deg_s": 1.5}
    model = StructuredModel.of(having(current=flow))
    for t_s, beta in ((None, 30.0), (0.0, 30.0), (40.0, 90.0)):
        seen = np.array(ca.DM(replace_field(model, t_s=t_s).water_velocity(ca.DM([0.0, 0.0, 0.0])))).ravel()
        expected = [0.2 * np.cos(np.deg2rad(beta)), 0.2 * np.sin(np.deg2rad(beta)), 0.0]
        assert seen == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("name", sorted(REGISTRY))
def test_every_term_takes_arrays_and_expressions_alike(name):
    """The diagnosis calls it with arrays, filter and NMPC with expressions; 20 random motions, seed 6."""
    vessel, rng, term = boat("aritra"), np.random.default_rng(6), REGISTRY[name]
    p = {q.name: q.default + 0.3 * min(1.0, q.upper - q.default) for q in term.parameters}
    moved, symbol = rng.uniform(-2, 2, (2, 3, 20)), (ca.SX.sym("eta", 3), ca.SX.sym("nu", 3))
    for hook, of in ((term.force, (0, 1)), (term.hull_force, (1,)), (term.damping_factor, (0,))):
        if hook is None:
            continue
        boats = () if hook is term.damping_factor else (vessel,)
        arrays, out = (hook(p, *boats, *(each[k] for k in of)) for each in (moved, symbol))
        if hook is term.damping_factor:
            arrays, out = (arrays,), (out,)
        function = ca.Function("f", [symbol[k] for k in of], [ca.vertcat(*out)])
        expected = np.array(function.map(20)(*(moved[k] for k in of)))
        np.testing.assert_allclose(np.broadcast_arrays(*arrays, moved[0, 0])[:-1], expected, rtol=1e-12, atol=1e-12)


def test_a_tether_without_slack_is_a_spring_right_at_its_anchor():
    spring = having(tether=TETHER | {"slack_m": 0.0})
    assert pull(spring, (4.2, -1.0, 0.0)) == pytest.approx([-0.6, 0.0, 0.0], abs=1e-9)
    assert pull(spring, (4.0, -1.0, 0.0)) == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)


def test_a_shallow_zone_damps_more_inside_and_nothing_outside():
    nu = (0.6, -0.2, 0.3)
    plain = np.array(ca.DM(damping_force(coefficients(boat("aritra")), ca.DM(nu)))).ravel()
    zone = having(shallow_zone=ZONE | {"edge_m": 0.1})
    for away, share in ((0.0, 1.5), (1.0, 1.5), (2.0, 0.75), (2.2, 1.5 / (1 + np.exp(2.0))), (3.5, 0.0)):
        assert pull(zone, (0.5, away, 0.3), nu) == pytest.approx(-share * plain, abs=1e-3)


def test_a_shallow_zone_feels_the_water_not_the_ground():
    """Adrift with the current, the zone takes nothing."""
    current = {"V_c_m_s": 0.4, "beta_c_deg": 90.0}
    both, alone = having(current=current, shallow_zone=ZONE), having(current=current)
    args = ca.DM([0.5, 0.0, 0.0]), ca.DM([0.0, 0.4, 0.0]), ca.DM.zeros(3)
    here, there = (np.array(StructuredModel.of(v).nu_dot(*args)) for v in (both, alone))
    assert here == pytest.approx(there, abs=1e-12)


def test_the_munk_moment_is_k_u_v():
    assert pull(having(munk_moment={"k_kg": 12.0}), (0, 0, 0.4), (0.5, -0.3, 0.2)) == pytest.approx([0, 0, -1.8])


@pytest.mark.parametrize(
    "terms",
    [
        {"munk_moment": {"k_kg": 73.0}},
        {"munk_moment": {"k_kg": -73.0}},
        {"asymmetry": {"N_uu_N_s2_m": 22.0}},
        {"munk_moment": {"k_kg": -36.0}, "asymmetry": {"N_uu_N_s2_m": -11.0}},
        {"shallow_zone": ZONE | {"share": 20.0}},
        {"shallow_zone": ZONE | {"share": -0.9}},
        {"tether": TETHER | {"stiffness_N_m": 40.0}},
        {"munk_moment": {"k_kg": 40.0}, "tether": TETHER, "shallow_zone": ZONE},
        {"cross_flow": {"C_d": 1.2}},
        {"cross_flow": {"C_d": 0.999 * most_negative_C_d(boat("aritra"))}},
    ],
    ids="+".join,
)
def test_energy_without_thrust_only_falls(terms):
    """Of the hull and of the stretched tether; 20 random velocities up to 2 m/s, seed 4, 5 s each."""
    vessel = having(**terms)
    M, step = mass_matrix(vessel), BufferedStep(step_function(StructuredModel.of(vessel), 0.01))
    tether = TETHER | {"stiffness_N_m": 0.0} | terms.get("tether", {})

    def energy(x):
        stretch = max(np.hypot(x[0] - tether["north_m"], x[1] - tether["east_m"]) - tether["slack_m"], 0.0)
        return 0.5 * x[3:6] @ M @ x[3:6] + 0.5 * tether["stiffness_N_m"] * stretch**2

    rng = np.random.default_rng(4)
    for _ in range(20):
        x = np.concatenate([rng.uniform(-3, 3, 3), rng.uniform(-2, 2, 3), np.zeros(4)])
        before = energy(x)
        for _ in range(500):
            x = step(x, np.zeros(4), np.zeros(3))
            now = energy(x)
            assert now <= before * (1 + 1e-9)
            before = now


def test_nothing_is_said_where_a_term_is_at_its_default():
    for name in ("munk_moment", "tether", "shallow_zone", "cross_flow", "current", "speed_damping", "asymmetry"):
        assert pull(having(**{name: {}}), (3.0, 2.0, 1.0), (0.5, 0.2, 0.1)) == pytest.approx([0, 0, 0], abs=1e-12)


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ("[terms.munk_moment]\nk_kg = 90.0", r"terms.munk_moment.k_kg: feeds energy .* at most 73.2 kg"),
        ("[terms.asymmetry]\nN_uu_N_s2_m = -23.0", r"terms.asymmetry.N_uu_N_s2_m: feeds energy .* at most 22 N s2/m"),
        ("[terms.cross_flow]\nC_d = -0.9", r"terms.cross_flow.C_d: feeds energy .* holds -0"),
        ("[terms.tether]\nslack_m = -1.0", r"terms.tether.slack_m: expected 0.0 to 1000.0"),
        ("[terms.tether]\nlength_m = 1.0", r"terms.tether.length_m: unknown key"),
        ("[terms.shallow_zone]\nradius_m = 0.0", r"terms.shallow_zone.radius_m: expected 0.01"),
        ("[terms.shallow_zone]\nshare = -1.0", r"terms.shallow_zone.share: expected -0.9"),
        ('[terms.munk_moment]\nk_kg = "much"', r"terms.munk_moment.k_kg: expected a number"),
    ],
)
def test_what_cannot_be_is_refused_by_its_key(table, says):
    with pytest.raises(ConfigError, match=rf"^boat.toml: {says}"):
        load_vessel(text_with(table), name="boat.toml")


def test_a_munk_moment_is_held_by_linear_damping_where_there_is_no_other():
    """2 (sqrt(18 x 3) - 1) / 3 m/s = 4.23 kg."""
    text = TEXT.replace("N_rr_N_m_s2 = -11.0", "N_rr_N_m_s2 = 0.0")
    load_vessel(f'{text}\n[terms.munk_moment]\nk_kg = 4.2\nsource = "test"\n', name="boat.toml")
    with pytest.raises(ConfigError, match=r"at most 4\.23 kg"):
        load_vessel(f'{text}\n[terms.munk_moment]\nk_kg = 4.3\nsource = "test"\n', name="boat.toml")


def test_asymmetry_turns_the_boat_by_its_way_through_the_water_and_the_other_way_astern():
    term = having(asymmetry={"N_uu_N_s2_m": 2.0})
    assert pull(term, (0, 0, 0.4), (0.5, -0.3, 0.2)) == pytest.approx([0, 0, 0.5])
    assert pull(term, (0, 0, 0.4), (-0.5, -0.3, 0.2)) == pytest.approx([0, 0, -0.5])


def test_speed_damping_is_n_ur_u_r_of_the_water_and_takes_energy_ahead_and_astern():
    term = having(speed_damping={"N_ur_N_s2": -3.0})
    assert pull(term, (0, 0, 0.4), (0.5, -0.3, 0.2)) == pytest.approx([0, 0, -0.3])
    assert pull(term, (0, 0, 0.4), (-0.5, -0.3, 0.2)) == pytest.approx([0, 0, -0.3])
    assert pull(term, (0, 0, 0.4), (0.0, 0.3, 0.2)) == pytest.approx([0, 0, 0], abs=1e-12)
