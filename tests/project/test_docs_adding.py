"""docs/adding.md followed to the letter where that is cheap: a vessel, a message, an actuator, an own effect."""

import re
import tomllib
from pathlib import Path
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from companion.boat.load_run import EXAMPLES, setup_of
from companion.core.control.nmpc import Actuation, Nmpc
from companion.core.messages import GroundTruth, Message, OverrideLease, topic
from companion.core.model.actuators.propulsion import ActuatorSet
from companion.core.model.load_vessel import load_vessel
from companion.core.model.manoeuvring import StructuredModel
from companion.core.pilot.pilot import Pilot
from companion.logs.schema import viewer_schema
from sim.fitting.diagnose.catalogue.effect import Effect
from sim.fitting.diagnose.catalogue.user import user_effects
from sim.world.stepped import SteppedRun
from sim.world.world import World, WorldSetup
from tests.support.drive_fixture import setup

DOCS = Path(__file__).resolve().parents[2] / "docs"


def block(page: str, title: str, language: str) -> str:
    """The first block of a language in a section of a page, without its indent."""
    part = (DOCS / page).read_text().split(f"\n## {title}\n")[1].split("\n## ")[0]
    found = re.search(rf"^( *)```{language}\n(.*?)^ *```", part, flags=re.M | re.S)
    assert found
    return re.sub(rf"^{found[1]}", "", found[2], flags=re.M)


def merged(old: dict, new: dict) -> dict:
    return {**old, **{k: merged(old[k], v) if isinstance(v, dict) else v for k, v in new.items()}}


@pytest.fixture
def pontoon(tmp_path) -> str:
    """The example boat with the page's tables in it, written as a file and read back."""
    example = tomllib.loads((EXAMPLES / "boats" / "twin.toml").read_text())
    path = tmp_path / "pontoon.toml"
    path.write_bytes(msgspec.toml.encode(merged(example, tomllib.loads(block("adding.md", "A vessel", "toml")))))
    return path.read_text()


def test_a_new_vessel_loads(pontoon):
    vessel = load_vessel(pontoon, name="pontoon.toml")
    assert (vessel.name, vessel.inertia.mass_kg) == ("pontoon", 48.0)


def test_a_new_vessel_drives_the_first_seconds_of_its_mission(pontoon):
    files = {**setup().files, "vessel.toml": pontoon}
    told = setup_of(files, {name: name for name in files}).pilot
    settings = msgspec.structs.replace(told.nmpc, method="interpreted", rescue_time_s=60.0)
    nmpc = Nmpc(StructuredModel.of(told.vessel), Actuation.of(told.vessel), settings, lambda: 0.0, told.fence)
    world = World(WorldSetup(told.vessel, told.site, start=(8.0, 8.0, 0.35)), 1)
    run = SteppedRun(world, Pilot(told), nmpc.solve)
    assert run.run(lambda r: r.state.helm.mode == "auto", 30.0)
    begun = len(run.messages)
    run.run(lambda r: False, 3.0)
    leases = [m for m in run.messages[begun:] if isinstance(m, OverrideLease)]
    assert len(leases) == 30 and {lease.source for lease in leases} <= {"plan", "shifted_plan", "pd"}
    assert [m for m in run.messages[begun:] if isinstance(m, GroundTruth)][-1].u_m_s > 0


def test_a_new_message_has_a_topic_and_a_schema():
    made: dict = {}
    exec(block("adding.md", "A message", "python"), made)
    (kind,) = (v for v in made.values() if isinstance(v, type) and v.__module__ == "builtins")
    assert issubclass(kind, Message)
    assert f"(`{topic(kind)}`)" in (DOCS / "adding.md").read_text()
    schema = msgspec.json.decode(viewer_schema(kind, kind.__name__))
    assert (schema["title"], schema["type"]) == (kind.__name__, "object")
    assert schema["properties"]["depth_m"]["type"] == "number"
    sent = kind(t_ns=1, t_rx_ns=2, depth_m=3.25)
    assert msgspec.json.decode(msgspec.json.encode(sent), type=kind) == sent


def test_an_effect_of_ones_own_is_picked_up(tmp_path):
    path = tmp_path / "my_effects.py"
    path.write_text(block("diagnose.md", "Your own effects", "python"))
    (effect,) = user_effects(path)(setup().pilot.vessel)
    assert isinstance(effect, Effect) and effect.id == "soft_iron" and set(effect.hooks) == {"imu"}
    y, scene = np.ones((1, 3, 4)), SimpleNamespace(psi_rad=np.array([[0.0, 0.3, 0.8]]))
    assert (effect.hooks["imu"]({"amplitude_deg": 0.0}, scene, y) == y).all()
    changed = effect.hooks["imu"]({"amplitude_deg": 2.0}, scene, y)
    assert changed[0, 2, 0] == pytest.approx(1 + np.radians(2.0) * np.sin(1.6)) and (changed[..., 1:] == 1).all()


def test_a_new_actuator_is_an_object_of_channels_and_components_and_a_line_of_the_set():
    """The page's object, and one of the same two channels that pushes twice as hard, in a set of its own."""
    made: dict = {}
    exec(block("adding.md", "An actuator", "python"), made)
    one, vessel = made["one"], made["vessel"]
    assert (made["thrust"], made["angle"]) == pytest.approx((10.0, 0.5))

    class Double(type(one)):
        def components(self, nu_r, f):
            return [2 * e for e in super().components(nu_r, f)]

    bow = vessel.thrusters[0]
    other = Double(bow, bow.steering, vessel.force_maps[bow.force_map], vessel.propulsion)
    both = ActuatorSet((one, other), ((0, 2), (1, 3)))
    e = np.array(both.components(np.zeros(3), np.array([10.0, 10.0, 0.5, 0.5]))).ravel()
    np.testing.assert_allclose(e[2:], 2 * e[:2])
    assert [c.unit for c in both.channels] == ["N", "N", "rad", "rad"] and both.directions.shape == (3, 4)
