"""The boat of the hidden-effect cases: no import of what is judged, the same equations, energy that falls."""

import ast
import sys
from pathlib import Path

import numpy as np
import pytest

from companion.core.model.load_vessel import load_vessel
from sim.world.environment import Moment
from sim.world.plant import Plant
from tests.hidden import draw
from tests.hidden.plant.hull import HullMotion
from tests.hidden.plant.sail import replay
from tests.hidden.plant.vessel import vessel_toml
from tests.hidden.plant.world import STEP_S, STEPS_HZ

PACKAGE = Path(draw.__file__).parent
ALLOWED = {"numpy", "scipy", "polars", *sys.stdlib_module_names}


# -- the other author ----------------------------------------------------------------------------------------------


def test_it_imports_nothing_of_what_it_judges():
    seen = 0
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            tops = []
            if isinstance(node, ast.Import):
                tops = [alias.name.split(".")[0] for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{path.name}: relative import"
                within = (node.module or "").startswith("tests.hidden")
                tops = [] if within else [(node.module or "").split(".")[0]]
            elif isinstance(node, ast.Name):
                assert node.id not in ("__import__", "importlib", "exec", "eval"), path.name
            seen += len(tops)
            assert set(tops) <= ALLOWED, f"{path.name}: imports {tops}"
    assert seen > 40


class Stiff(Plant):
    """The companion's plant on a pack without inner resistance."""

    @property
    def current_a(self):
        return 0.0


@pytest.mark.parametrize(("current", "wind"), [((0.0, 0.0), (0.0, 0.0)), ((0.12, 70.0), (4.0, 200.0))])
def test_two_hands_wrote_the_same_equations(current, wind):
    case = draw.draw("two-hands", 0, kind="none")
    world = case.base.copy()
    world.water.V_c, world.water.beta_c_deg = current
    world.water.V_w, world.water.beta_w_deg = wind
    if not wind[0]:
        world.hull.frontal = world.hull.lateral = 0.0  # the companion's plant has the drag of calm air, this one not
    vessel = load_vessel(vessel_toml(world, "boat"), name="base.toml")
    start, volts, steps = (15.0, 15.0, 0.6, 0.0, 0.0, 0.0), 15.1, 30 * STEPS_HZ
    rng = np.random.default_rng(5)
    pwm = [(k, [float(p) for p in rng.integers(1250, 1750, 4)]) for k in range(0, steps, 2 * STEPS_HZ)]
    mine = replay(world, pwm, [(0, volts)], 0.0, {0: start}, steps)
    plant = Stiff(vessel, np.array(start), step_ns=round(1e9 / STEPS_HZ), voltage_v=volts)
    weather, commands, theirs = Moment(*current, *wind, np.zeros(3), 0.0, 0.0), dict(pwm), []
    for k in range(steps):
        if k in commands:
            plant.command(plant.motion.t_ns, tuple(commands[k]))
        theirs.append(plant.motion.x[:6])
        plant.step(weather)
    off = np.abs(mine[:, :6] - np.array(theirs))
    assert np.ptp(mine[:, :2], axis=0).max() > 2.0
    assert off[:, :2].max() < (0.001 if wind[0] else 1e-5)  # wind is held over a step here


@pytest.mark.parametrize("index", range(6))
def test_energy_falls_without_thrust(index):
    world = draw.draw("energy", index, kind="none").world
    world.water.ambient_V_c = (0.0, 0.0)
    hull = HullMotion(world)
    s = (0.0, 0.0, 0.3, 0.9, -0.6, 1.2)
    before = first = hull.energy(*s[3:])
    for _ in range(20 * STEPS_HZ):
        s = hull.step(s, ((0.0,) * 3,) * 3, (0.0, 0.0), 1.0, STEP_S)
        now = hull.energy(*s[3:])
        assert now <= before * (1 + 1e-12)
        before = now
    assert before < 0.1 * first
