"""The NMPC of boats with a rudder or azimuth thrusters: derivatives, limits, and plans against IPOPT."""

from functools import cache

import casadi as ca
import numpy as np
import pytest

from companion.core.control.nmpc import Actuation, NmpcSettings
from companion.core.control.nmpc.effort import control_residual
from companion.core.control.nmpc.production import production
from companion.core.control.nmpc.stage import advance, advance_jacobian
from companion.core.control.rti.iteration import Rti
from companion.core.guidance.reference_row import COLUMNS
from companion.core.model.manoeuvring import StructuredModel
from sim.bench.controller.nlp import Nlp
from tests.companion.core.control.nmpc_world import leg_rows
from tests.companion.core.control.rti_fixture import WAYS
from tests.support.vessel_fixtures import boat

S = NmpcSettings()
NAMES = ("rudder", "azimuth")


@cache
def rti(name: str, compiler) -> Rti:
    vessel = boat(name)
    return Rti(production(StructuredModel.of(vessel), Actuation.of(vessel), S), compiler=compiler)


def under_way(one: Rti, rng):
    """Near a leg, servos and thrusters anywhere within half their limits."""
    ocp = one.ocp
    x0 = np.r_[rng.normal(size=2) * 0.5, rng.normal() * 0.4, 0.4 + rng.normal() * 0.1, rng.normal(size=2) * 0.05,
               rng.uniform(ocp.c_min, ocp.c_max) / 2]  # fmt: skip
    one.X[:], one.C[:], one.active[:], one.shift[0] = x0, x0[6:], 0.0, 0.0
    one.x0[:], one.p[:], one.q[:] = x0, leg_rows(x0, S, angle=rng.normal() * 0.2), rng.normal(size=3) * (0.5, 0.5, 0.1)


@pytest.mark.parametrize("name", NAMES)
def test_the_variational_jacobian_is_that_of_the_step(name):
    model, n = StructuredModel.of(boat(name)), len(boat(name).controls)
    x, c, d = ca.SX.sym("x", 6 + n), ca.SX.sym("c", n), ca.SX.sym("d", 3)
    z, next_ = ca.vertcat(x, c), advance(model, x, c, d, 0.2)
    both = ca.Function("both", [x, c, d], [ca.jacobian(next_, z), advance_jacobian(model, x, c, d, 0.2)])
    rng = np.random.default_rng(3)
    for _ in range(20):
        one, other = both(rng.normal(size=6 + n), rng.normal(size=n), rng.normal(size=3))
        np.testing.assert_allclose(np.array(ca.DM(one)), np.array(ca.DM(other)), atol=1e-9)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("compiler", WAYS)
@pytest.mark.long
def test_repeated_it_ends_where_ipopt_ends_and_keeps_to_its_limits(name, compiler):
    """Seed 5. In a second local minimum IPOPT may end elsewhere, from the kernel's own plan it does not."""
    one, rng = rti(name, compiler), np.random.default_rng(5)
    nlp = Nlp(one.ocp)
    solver = nlp.solver("ipopt", expand=True, tolerance=1e-9)
    for _ in range(3):
        under_way(one, rng)
        for k in range(60):
            one.damped(1.0 if k < 6 else 0.5 if k < 30 else 0.25)
        info, ocp = one.info(), one.ocp
        answer = nlp.call(solver, nlp.join(one.X, one.C), one.x0, one.p, one.q)
        assert info.excess < 1e-6 and info.cost == pytest.approx(float(answer["f"]), rel=2e-3)
        assert (ocp.c_min - 1e-9 <= one.C).all() and (ocp.c_max + 1e-9 >= one.C).all()
        assert (np.abs(one.C - one.X[:-1, 6:]) <= ocp.rate_n + 1e-6).all()


@pytest.mark.parametrize(("name", "columns"), [("rudder", {0: 1.0, 1: 10.0}), ("azimuth", {0: 1.0, 3: 10.0})])
def test_a_change_of_one_radian_costs_like_one_of_ten_newtons(name, columns):
    vessel = boat(name)
    n, model = len(vessel.controls), StructuredModel.of(vessel)
    x, c, row, d = ca.SX.sym("x", 6 + n), ca.SX.sym("c", n), ca.SX.sym("row", len(COLUMNS)), ca.SX.sym("d", 3)
    r = control_residual(S, model, Actuation.of(vessel), x, c, row, d)
    by_f = np.array(ca.DM(ca.Function("by", [x, c, row, d], [ca.jacobian(r, x)])(0, 0, 0, 0)))[:, 6:]
    for channel, scale in columns.items():
        assert np.linalg.norm(by_f[:, channel]) == pytest.approx(np.sqrt(S.rate) * scale)
