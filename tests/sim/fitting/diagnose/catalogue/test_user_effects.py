"""Effects of a user's own: what is wrong with their file and their hooks is said by file, line, effect and hook."""

import numpy as np
import pytest

from companion.__main__ import main
from companion.boat.load_run import EXAMPLES
from companion.core.configuration.tables import ConfigError
from sim.fitting.diagnose.catalogue import environment, hull, propulsion, sensors
from sim.fitting.diagnose.catalogue.effect import STAGES
from sim.fitting.diagnose.catalogue.user import user_effects
from sim.fitting.diagnose.catalogue.user_hooks import guarded, try_hooks
from tests.support.vessel_fixtures import boat

HOOK = """import numpy as np
from sim.fitting.diagnose.catalogue.effect import Effect, EffectParameter

def hook(p, *given):
    {body}

def effects(vessel):
    size = EffectParameter("size", "1", prior=5.0, smallest=1.0, step=0.3)
    yield Effect("mine", "hull", "", "", (size,), hooks={{"{stage}": hook}})
"""
LOST = r"mine\.py: effect mine: hook"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("def effects(vessel:", "SyntaxError"),
        ("import nothing_of_that_name", "ModuleNotFoundError"),
        ("effects = 3", r"defines no function effects\(vessel\)"),
        ("def effects(vessel): return vessel.nothing", "effects: AttributeError"),
        ("def effects(vessel): return ['a current']", "expected Effect, found str"),
    ],
)
def test_what_is_wrong_with_a_users_file_is_said(tmp_path, text, words):
    path = tmp_path / "mine.py"
    path.write_text(text)
    with pytest.raises(ConfigError, match=rf"mine\.py: .*{words}|mine\.py: {words}"):
        user_effects(path)(boat("aritra"))


def mine(tmp_path, stage, body):
    path = tmp_path / "mine.py"
    path.write_text(HOOK.format(stage=stage, body=body))
    return path


@pytest.mark.parametrize(
    ("stage", "body", "words"),
    [
        (
            "imu",
            "return given[1] * (1 + p['sise'])",
            r"imu: KeyError: 'sise' \(line 5\); parameters of the effect: size",
        ),
        (
            "imu",
            "given[1] * (1 + p['size'])",
            r"imu: expected an array of numbers of shape \(2, 3, 4\), found NoneType",
        ),
        ("imu", "return given[1][..., 0]", r"imu: expected an array of shape \(2, 3, 4\), found \(2, 3\)"),
        ("imu", "return given[1] + given[0].psi", r"imu: AttributeError: .*psi.* \(line 5\)"),
        ("imu", "return given[1] / p['size']", "imu: ZeroDivisionError|imu: expected finite numbers"),
        ("tag", "return given[0].place_m / np.float64(p['size'])", "tag: expected finite numbers, all parameters at"),
        ("thrust", "given[1][..., 0] = 0; return given[1]", "thrust: ValueError: assignment destination is read-only"),
        ("thrust", "return given[0].x if p['size'] else given[1]", r"thrust: expected an array of shape \(2, 3, 4\)"),
        ("pwm", "return list(given[0])", r"pwm: expected an array of numbers of shape \(3, 4\), found list"),
        (
            "force",
            "return (0.0, 0.0, p['size'])",
            r"force: expected an array of numbers of shape \(2, 3, 3\), found tuple",
        ),
        ("water", "return np.zeros((2, 3))", r"water: expected an array of shape \(2, 3, 2\), found \(2, 3\)"),
        ("hull", "return None", "hull: expected coefficients by name, found NoneType: does it end in a return"),
        ("hull", "return {'X_u_N_s_m': -1.0}", "hull: expected all coefficients, M11_kg is missing"),
        ("maps", "return given[0].propulsion", "maps: expected a VesselFile, found Propulsion"),
    ],
)
def test_what_is_wrong_with_a_users_hook_is_said(tmp_path, stage, body, words):
    with pytest.raises(ConfigError, match=f"{LOST} {words}"):
        user_effects(mine(tmp_path, stage, body))(boat("aritra"))


@pytest.mark.parametrize(
    ("stage", "body"),
    [
        ("force", "return np.array([0.0, 0.0, p['size']])"),
        ("water", "return p['size'] * np.ones((*given[0].psi_rad.shape, 2))"),
        ("imu", "given[1][..., 0] += p['size']; return given[1]"),
        ("tag", "return given[1] + given[0].carried(p['size'], 0.0)"),
        ("hull", "return {**given[0], 'X_u_N_s_m': given[0]['X_u_N_s_m'] * (1 + p['size'])}"),
        ("maps", "return given[0]"),
    ],
)
def test_a_sound_hook_does_what_it_did(tmp_path, stage, body):
    (effect,) = user_effects(mine(tmp_path, stage, body))(boat("aritra"))
    assert effect.id == "mine" and set(effect.hooks) == {stage}


def test_a_hook_that_goes_wrong_in_a_fit_only_is_named_as_well(tmp_path):
    (effect,) = user_effects(mine(tmp_path, "pwm", "return given[0] if len(given[0]) == 3 else None"))(boat("aritra"))
    with pytest.raises(ConfigError, match=f"{LOST} pwm: expected an array of numbers of shape"):
        effect.hooks["pwm"]({"size": 0.0}, np.ones((4, 4)))


@pytest.mark.parametrize("name", ["aritra", "twin"])
def test_the_catalogues_own_hooks_pass_the_trial(name):
    vessel = boat(name)
    entries = [
        *hull.base(vessel), *hull.effects(vessel), *propulsion.base(vessel), *propulsion.effects(vessel, ((1.5, 1.0),)),
        *environment.effects(vessel, ((1.0, 2.0),), 3.0), *sensors.accelerometers(vessel, True),
        *sensors.effects(vessel, True),
    ]  # fmt: skip
    for entry in entries:
        try_hooks(guarded(entry, "own"), vessel, "own")
    assert {stage for e in entries for stage in e.hooks} == set(STAGES)


def test_a_diagnosis_says_so_before_it_reads_a_log(tmp_path, capsys):
    path, log = mine(tmp_path, "imu", "return given[1] * p['sise']"), tmp_path / "drive.csv"
    log.write_text("no,log\n1,2\n")
    vessel = EXAMPLES / "boats" / "aritra.toml"
    words = ["diagnose", str(log), "--vessel", str(vessel), "--catalogue", str(path), "--out", str(tmp_path / "out")]
    assert main(words) == 2
    assert f"{path}: effect mine: hook imu: KeyError: 'sise' (line 5)" in capsys.readouterr().err
