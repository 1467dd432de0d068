"""`aritra vessel new`: the same file from options and from answers; what is wrong is one sentence."""

import argparse

import pytest

from companion.boat.load_run import EXAMPLES
from companion.cli import vessel
from companion.core.model.load_vessel import load_vessel
from tests.companion.command_line import exit_code

SIZE = ("--size", "1.2", "0.93")


def new(out, *words):
    return exit_code("vessel", "new", "--out", out, *words)


def test_options_alone_write_a_file_that_loads(tmp_path, capsys):
    path = tmp_path / "boat.toml"
    assert new(path, *SIZE, "--mass", "17", "--layout", "differential", "--position", "gnss") == 0
    found = load_vessel(path.read_text(), name=path.name)
    assert (found.name, found.inertia.mass_kg, len(found.thrusters)) == ("boat", 17.0, 2)
    assert found.sensors.gnss and not found.sensors.uwb
    said = capsys.readouterr().out
    assert f"aritra identify LOG --vessel {path}" in said and "the mass" not in said
    assert f'to try it: cp -rn deploy/. my, in my/lake.toml vessel = "{path}"' in said


def test_five_answers_at_a_terminal_write_the_same(tmp_path, capsys):
    asked = []
    answers = iter(["1.2", "1.2 0.93", "many", "guess", "y", "differential", "", "gnss"])

    def ask(question):
        asked.append(question)
        return next(answers)

    empty = dict.fromkeys(q.key for q in vessel.QUESTIONS)
    args = argparse.Namespace(**empty, name="boat", out=tmp_path / "asked.toml")
    assert vessel.new(args, ask) == 0
    assert len(vessel.QUESTIONS) == 5 and len(asked) == 8  # three answers were asked for again
    said = capsys.readouterr().out
    assert (
        "expected two numbers" in said
        and "'many': expected a mass [kg]" in said
        and "'y': expected differential" in said
    )
    assert "measure next: the mass" in said
    assert new(tmp_path / "boat.toml", *SIZE, "--layout", "differential", "--position", "gnss") == 0
    assert (tmp_path / "boat.toml").read_text() == (tmp_path / "asked.toml").read_text()


def test_a_file_that_cannot_be_written_is_one_sentence(capsys):
    assert new("/proc/boat.toml", *SIZE, "--mass", "17", "--layout", "differential", "--position", "gnss") == 2
    assert "aritra vessel: /proc/boat.toml: " in capsys.readouterr().err


def test_the_command_to_go_on_with_takes_a_path_with_spaces(tmp_path, capsys):
    path = tmp_path / "my boat.toml"
    assert new(path, *SIZE, "--layout", "x") == 0
    assert f"aritra identify LOG --vessel '{path}' --out DIR" in capsys.readouterr().out


def test_answers_that_end_early_write_nothing(tmp_path, capsys):
    def ask(question):
        raise EOFError

    args = argparse.Namespace(size=["1", "0.4"], mass=None, layout=None, thruster=None, position=None, name=None,
                              out=tmp_path / "boat.toml")  # fmt: skip
    assert vessel.new(args, ask) == 2
    assert "nothing was written" in capsys.readouterr().err
    assert not args.out.exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "--size: missing, and there is no terminal to ask at"),
        (SIZE, "--layout: missing"),
        ((*SIZE, "--layout", "y"), "--layout: 'y': unknown value; choose from differential, x, bow"),
        (("--size", "1.2", "wide"), "--size: 'wide': expected a beam [m], 0.02 to 20"),
        ((*SIZE, "--layout", "x", "--mass", "-3"), "--mass: '-3': expected a mass [kg]"),
        ((*SIZE, "--layout", "x", "--thruster", "t500"), "--thruster: 't500': expected `t200`, or the most force"),
        ((*SIZE, "--layout", "x", "--mass", "5000"), "mass: 5000 kg on 2 hulls of 1.2 x 0.24 m would lie"),
    ],
)
def test_what_is_wrong_is_one_sentence(tmp_path, capsys, words, message):
    path = tmp_path / "boat.toml"
    assert new(path, *words) == 2
    assert message in capsys.readouterr().err
    assert not path.exists()


def test_what_exists_is_not_overwritten(tmp_path, capsys):
    path = tmp_path / "boat.toml"
    path.write_text("mine")
    assert new(path, *SIZE, "--layout", "x") == 2
    assert "exists already" in capsys.readouterr().err and path.read_text() == "mine"


def test_the_blueboat_is_what_it_writes_where_nothing_is_published(tmp_path):
    path = tmp_path / "blueboat.toml"
    assert new(path, "--size", "1.195", "0.93", "--mass", "17", "--layout", "differential", "--position", "gnss") == 0
    made, kept = (load_vessel(p.read_text(), name=p.name) for p in (path, EXAMPLES / "boats" / "blueboat.toml"))
    by_formula = {
        "hull": ("draft_m",),
        "inertia": ("I_z_kg_m2", "X_udot_kg", "Y_vdot_kg", "N_rdot_kg_m2"),
        "damping": ("Y_v_N_s_m", "N_r_N_m_s", "Y_vv_N_s2_m2", "N_rr_N_m_s2"),
    }
    for table, keys in by_formula.items():
        for key in keys:
            found, expected = (getattr(getattr(v, table), key) for v in (kept, made))
            assert found == pytest.approx(expected, rel=0.01), key
