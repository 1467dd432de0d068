"""The hidden-effect cases: own hand, honest files, sizes that can be seen, scoring by the stated rules.

Seeds: every case is drawn from a nonce that stands in the test.
"""

import ast
import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from companion.core.model.load_vessel import load_vessel
from companion.logs.readers.read_run import read_run
from companion.logs.runs.problems import problems
from sim.world.environment import Moment
from sim.world.plant import Plant
from tests.hidden import draw, fixed, gain, names, score, write
from tests.hidden.effects import catalogue as effects
from tests.hidden.effects import imperfections, outside
from tests.hidden.plant.hull import HullMotion
from tests.hidden.plant.sail import Recorded, replay, sail
from tests.hidden.plant.sensors import fix_clean, imu_clean, stamp_delay
from tests.hidden.plant.vessel import read_vessel, vessel_toml
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
    early = replace(vessel.propulsion, dead_time_s=vessel.propulsion.dead_time_s - 0.001)  # stamps in whole ns
    start, volts, steps = (15.0, 15.0, 0.6, 0.0, 0.0, 0.0), 15.1, 30 * STEPS_HZ
    rng = np.random.default_rng(5)
    pwm = [(k, [float(p) for p in rng.integers(1250, 1750, 4)]) for k in range(0, steps, 2 * STEPS_HZ)]
    mine = replay(world, pwm, [(0, volts)], 0.0, {0: start}, steps)
    plant = Stiff(replace(vessel, propulsion=early), np.array(start), step_ns=round(1e9 / STEPS_HZ), voltage_v=volts)
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


# -- effects -------------------------------------------------------------------------------------------------------


def test_the_catalogue_is_complete():
    assert tuple(effects.CATALOGUE) == names.FAMILIES
    assert len(names.FAMILIES) == 39  # 42 with one gain for each of four thrusters
    assert len(outside.OUTSIDE) >= 6
    for entry in outside.OUTSIDE:
        assert set(entry.depends_on) <= set(names.DEPENDENCIES)


@pytest.fixture(scope="module")
def calm():
    """A noise-free run of 25 s of a boat as believed, and its start."""
    case = draw.draw("effects", 0, kind="none", uwb_hz=5)
    world, start = case.base, (17.0, 12.0, 0.8, 0.0, 0.0, 0.0)
    rng = np.random.default_rng(8)
    pwm = [(k, [float(p) for p in rng.integers(1300, 1700, 4)]) for k in range(0, 25 * STEPS_HZ, 3 * STEPS_HZ // 2)]
    return world, start, pwm, noise_free(world, start, pwm)


def noise_free(world, start, pwm):
    track = sail(world, Recorded(pwm), 25.0, 0.0, start, [np.random.default_rng(1), np.random.default_rng(2)])
    t = track.fix_step * STEP_S
    imu = imu_clean(world, track.imu_step * STEP_S, track.state, track.rate, track.tilt)
    fix = fix_clean(world.sense, track.fix_state)
    late = stamp_delay(world.sense, t) - 0.1
    return imu[:, :4], np.stack([np.interp(t - late, t, fix[:, i]) for i in range(2)], 1)


def nats(a, b, sense):
    """Half the sum of squared differences in sigmas: what perfect knowledge of the rest would give."""
    imu = (a[0] - b[0]) / (sense.heading_sigma, sense.gyro_sigma, sense.accel_sigma, sense.accel_sigma)
    return 0.5 * float((imu**2).sum() + (((a[1] - b[1]) / sense.uwb_sigma) ** 2).sum())


@pytest.mark.parametrize("family", [f for f in names.FAMILIES if f != "nlos"])
def test_each_effect_at_medium_size_changes_the_readings(family, calm):
    world, start, _, quiet = calm
    effect = effects.CATALOGUE[family]
    params = effect.draw(np.random.default_rng(4), 4 * effect.smallest, world)
    if "t_on_s" in params:
        params["t_on_s"] = 5.0
    if family == "clock_drift":
        params["drift"] *= 300 / 25  # what five minutes would show
    if family == "shallow_zone":
        params |= {"north_m": start[0], "east_m": start[1]}
    plain = noise_free_with(effect.apply, params, calm)
    assert nats(plain, quiet, world.sense) > 5  # ten minutes: over 100
    for name, variant in effect.variants.items():
        if name not in ("warms", "late", "on_off"):  # these differ over minutes
            assert nats(noise_free_with(variant, params, calm), plain, world.sense) > 0.5


def noise_free_with(apply, params, calm):
    world, start, pwm, _ = calm
    changed = world.copy()
    apply(changed, params)
    return noise_free(changed, start, pwm)


def test_blocked_fixes_lie_away_from_their_anchor():
    case = draw.draw("nlos", 0, kind="medium", family="nlos", uwb_hz=10, train_s=60.0)
    track, said = write.record(case.world, case, 0, 60.0, 0.0, case.open_rng())
    t = said.fixes[:, 0] - case.world.sense.latency
    at = np.rint(t * 10).astype(int)
    off = said.fixes[:, 1:] - fix_clean(case.world.sense, track.fix_state[at])
    far = np.hypot(*off.T) > 0.35
    assert 0.3 * case.world.sense.nlos < far.mean() < 1.5 * case.world.sense.nlos


@pytest.mark.parametrize("entry", outside.OUTSIDE, ids=lambda e: e.name)
def test_each_outside_effect_changes_the_readings(entry, calm):
    world, start, pwm, quiet = calm
    changed = world.copy()
    entry.make(changed, np.random.default_rng(3), 1.0)
    assert nats(noise_free(changed, start, pwm), quiet, world.sense) > 50


def test_signs_and_units_are_as_documented(calm):
    world, start, _, quiet = calm

    def readings(family, **params):
        return noise_free_with(effects.CATALOGUE[family].apply, params, calm)

    assert readings("heading_offset", offset_deg=2.0)[0][:, 0] - quiet[0][:, 0] == pytest.approx(math.radians(2.0))
    assert readings("gyro_bias", b_r_rad_s=0.01)[0][:, 1] - quiet[0][:, 1] == pytest.approx(0.01)
    assert readings("accel_bias", b_x_m_s2=0.05, b_y_m_s2=0.0)[0][:, 2] - quiet[0][:, 2] == pytest.approx(0.05)
    turned = readings("imu_misalignment", yaw_deg=90.0)[0]
    assert turned[:, 2] == pytest.approx(quiet[0][:, 3])
    adrift = world.copy()
    effects.CATALOGUE["current"].apply(adrift, {"V_c_m_s": 0.2, "beta_c_deg": 90.0})
    end = replay(adrift, [], [(0, 15.0)], 0.0, {0: start}, 60 * STEPS_HZ)[-1]
    assert end[1] - start[1] > 5.0
    assert abs(end[0] - start[0]) < 1.0
    windy = world.copy()
    effects.CATALOGUE["wind"].apply(windy, {"V_w_m_s": 8.0, "beta_w_deg": 0.0})
    assert replay(windy, [], [(0, 15.0)], 0.0, {0: start}, 20 * STEPS_HZ)[-1][0] < start[0] - 0.5


# -- drawing -------------------------------------------------------------------------------------------------------


def test_a_nonce_draws_every_kind_and_every_family_equally():
    kinds = [draw.kind_of("deal", i) for i in range(60)]
    assert {k: kinds.count(k) for k in names.KINDS} == {k: 3 * draw.BLOCK.count(k) for k in names.KINDS}
    cases = [draw.draw("deal", i, kind="medium") for i in range(len(names.FAMILIES))]
    assert {c.causes[0].family for c in cases} == set(names.FAMILIES)
    assert all(c.causes[0].deviation >= 2.8 * c.causes[0].smallest for c in cases)
    small = [draw.draw("deal", i, kind="small").causes[0] for i in range(38)]
    assert all(1.4 < c.deviation / c.smallest < 2.2 for c in small if c.family != "dead_time")
    assert [draw.draw("a", 3).kind, draw.draw("a", 3).causes] == [draw.draw("a", 3).kind, draw.draw("a", 3).causes]
    assert draw.draw("a", 3).base != draw.draw("b", 3).base


def test_several_causes_do_not_clash():
    for i in range(40):
        families = {c.family for c in draw.draw("several", i, kind="three").causes}
        assert len(families) == 3
        assert all(len(families & clash) < 2 for clash in effects.CLASHES)


def test_imperfections_are_many_and_below_what_is_worth_naming():
    owner = {key: family for family, keys in imperfections.OWNERS.items() for key in keys}
    for i in range(20):
        done = draw.draw("small-things", i, kind="none").imperfections
        assert len(done) >= 30
        for key, amount in done.items():
            if key in imperfections.SMALL and key in owner:
                assert abs(amount) <= imperfections.SHARE * effects.CATALOGUE[owner[key]].smallest
        shares = [abs(v) for k, v in done.items() if k.startswith("gain share")]
        assert len(shares) == 4
        assert max(shares) <= 0.5 * effects.CATALOGUE["thruster_gain"].smallest


# -- files ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("index", range(3))
def test_the_files_are_runs_and_say_nothing_of_the_truth(index, tmp_path):
    case = draw.draw("files", index, train_s=25.0)
    case.with_reference, case.as_csv = True, index == 1
    truth = write.write_case(case, tmp_path)
    load_vessel((tmp_path / "base.toml").read_text(), name="base.toml")
    back = read_vessel((tmp_path / "base.toml").read_text())
    assert vessel_toml(back, "boat") == vessel_toml(case.base, "boat")
    suffix, zero = ".csv" if case.as_csv else ".parquet", []
    for name in ("reference", "train1", "train2", "held_out"):
        run = read_run(tmp_path / f"{name}{suffix}")
        assert not [c for c in run.table.columns if c.startswith(("true_", "extra_"))]
        serious = {"gap", "clock jump", "not a number", "disagree", "edited", "out of order", "duplicate", "missing"}
        assert not serious & {p.kind for p in problems(run)}
        assert run.table["north_m"].drop_nulls().len() > 0.9 * 25 * case.base.sense.uwb_hz - 2
        zero.append(run.meta.zero_ns)
    assert zero == sorted(zero)
    everything = b"".join(p.read_bytes() for p in tmp_path.iterdir() if p.name != "base.toml")
    for secret in (case.nonce, case.kind, *(c.family for c in case.causes)):
        assert secret.encode() not in everything
    assert write.seal(truth) == (tmp_path / "seal.txt").read_text().strip()
    assert write.seal(truth | {"kind": "other"}) != write.seal(truth)


def test_the_same_nonce_writes_the_same_bytes(tmp_path):
    for folder in ("a", "b"):
        write.write_case(draw.draw("again", 4, train_s=15.0), tmp_path / folder)
    files = sorted(p.name for p in (tmp_path / "a").iterdir())
    assert len(files) >= 5
    assert all((tmp_path / "a" / f).read_bytes() == (tmp_path / "b" / f).read_bytes() for f in files)


def test_the_fixed_set_is_what_it_says():
    cases = fixed.fixed_cases()
    assert [c.causes[0].family for c in cases.values() if c.causes] == list(fixed.FAMILIES)
    assert all(c.base.sense.uwb_hz == 5 and c.train_s == 300.0 for c in cases.values())


# -- gain, and the whole way ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("family", ["thruster_gain", "current", "uwb_lever_arm"])
def test_the_true_cause_gains_and_a_wrong_one_does_not(family, tmp_path):
    case = draw.draw("gain", 1, kind="medium", family=family, uwb_hz=5, train_s=30.0)
    case.world, case.calm = case.base.copy(), case.base.copy()  # no imperfections: base plus cause is the truth
    cause = case.causes[0]
    effects.CATALOGUE[family].apply(case.world, cause.params)
    told = {k: {"value": v} for k, v in cause.params.items() if k != "thruster"}
    hidden = write.write_case(case, tmp_path)
    findings = {"refitted_vessel": "base.toml", "extended_vessel": "base.toml"}
    right = findings | {"causes": [{"name": cause.id, "parameters": told}]}
    assert gain.relative_gain(case, hidden, right, tmp_path)["gain"] == pytest.approx(1.0, abs=1e-6)
    wrong = findings | {"causes": [{"name": "gyro_scale", "parameters": {"scale": {"value": 0.1}}}]}
    assert gain.relative_gain(case, hidden, wrong, tmp_path)["gain"] < 0.1
    assert "why_not" in gain.relative_gain(case, hidden, {"causes": []}, tmp_path)
    incomplete = findings | {"causes": [{"name": "wind"}]}
    assert "V_w_m_s" in gain.relative_gain(case, hidden, incomplete, tmp_path)["why_not"]


STAND_IN = """
import json, pathlib, sys
out = pathlib.Path(sys.argv[sys.argv.index("--out") + 1])
assert all(pathlib.Path(a).is_file() for a in sys.argv[1:3]), sys.argv
out.mkdir()
(out / "findings.json").write_text(json.dumps({"verdict": "none", "causes": []}))
"""


def test_the_command_from_drawing_to_report(tmp_path, capsys):
    (tmp_path / "program.py").write_text(STAND_IN)
    words = ["--nonce", "n", "--cases", "2", "--out", str(tmp_path / "out"), "--seconds", "12", "--jobs", "1"]
    command = f"{sys.executable} {tmp_path / 'program.py'}"
    assert score.main([*words, "--kind", "none", "--command", command]) == 0
    results = json.loads((tmp_path / "out" / "results.json").read_text())["results"]
    assert [r["outcome"] for r in results] == ["exact", "exact"]
    assert all(r["memory_mb"] > 0 and r["wall_s"] > 0 for r in results)
    assert json.loads((tmp_path / "out" / "sealed" / "case_0001.json").read_text())["kind"] == "none"
    assert "nothing hidden: any name" in capsys.readouterr().out
    assert score.main([*words, "--command", f"{sys.executable} -P -c pass"]) == 0
    failed = json.loads((tmp_path / "out" / "results.json").read_text())["results"]
    assert [r["outcome"] for r in failed] == ["failure", "failure"]
    assert "no findings.json" in failed[0]["why"]
    with pytest.raises(SystemExit) as stop:
        score.main([*words, "--kind", "small", "--family", "swapped_pair"])
    assert stop.value.code == 2
