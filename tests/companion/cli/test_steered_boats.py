"""Commands that know fixed thrusters only say so, in one sentence, of a boat with servos."""

import pytest

from companion.__main__ import main
from tests.support.vessel_fixtures import BOATS

SAYS = "for boats of fixed thrusters so far"


@pytest.mark.parametrize("boat", ["rudder", "azimuth"])
@pytest.mark.parametrize("command", ["identify", "diagnose"])
def test_what_makes_models_of_logs_refuses(tmp_path, capsys, command, boat):
    log = tmp_path / "log.csv"
    log.write_text("t_s\n0\n")
    assert main([command, str(log), "--vessel", str(BOATS / f"{boat}.toml"), "--out", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert SAYS in told and f"{boat}.toml" in told and told.count("\n") == 1


def test_bench_and_excite_refuse(tmp_path, capsys):
    vessel = ["--vessel", str(BOATS / "rudder.toml")]
    assert main(["bench", *vessel]) == 2
    assert SAYS in capsys.readouterr().err
    assert main(["excite", "design", "--out", str(tmp_path / "plan.toml"), *vessel]) == 2
    assert SAYS in capsys.readouterr().err


@pytest.mark.parametrize("command", ["info", "fly"])
def test_a_plan_for_such_a_boat_names_the_vessel_file(tmp_path, capsys, command):
    vessel, plan = BOATS / "rudder.toml", BOATS.parent / "excitations" / "pulses.toml"
    out = ["--out", str(tmp_path / "out")] if command == "fly" else []
    assert main(["excite", command, str(plan), "--vessel", str(vessel), *out]) == 2
    assert capsys.readouterr().err.startswith(f"aritra excite: {vessel}: excitations are {SAYS}")
