"""The basin recordings as runs; polars reading the same file plainly is the oracle."""

import gzip
import io

import numpy as np
import polars as pl
import pytest

from companion.logs.readers.cse1 import THRUSTERS
from companion.logs.readers.read_run import read_run
from companion.logs.runs.problems import grouped, problems
from companion.logs.runs.run import RunError

RUNS = {"random_run1": (14101, 136 + 10), "random_run3": (7304, 84), "dptest": (13214, 98)}  # 10: on her back


@pytest.mark.parametrize("name", RUNS)
def test_every_row_is_there_and_lost_tracking_is_blank(shared_data, name):
    path = shared_data / "cse1" / f"{name}.csv.gz"
    plain = pl.read_csv(io.BytesIO(gzip.decompress(path.read_bytes())))
    run = read_run(path)
    rows, lost = RUNS[name]
    assert run.table.height == plain.height == rows
    np.testing.assert_allclose(run.table["t_s"], plain["t"], atol=1e-9)
    assert run.thrusters == THRUSTERS
    for i, thruster in enumerate(THRUSTERS, 1):
        np.testing.assert_allclose((run.table[f"pwm_{thruster}"] - 1500) / 400, plain[f"u{i}"], atol=1e-12)
    seen = (plain["tracking_lost"] == 0) & (plain["phi"].abs() < 0.5) & (plain["theta"].abs() < 0.5)
    for column, source in (("north_m", "x"), ("east_m", "y"), ("phi_rad", "phi")):
        assert run.table[column].null_count() == lost
        assert run.table.filter(seen)[column].equals(plain.filter(seen)[source].alias(column))
    turned = run.table.filter(seen)["psi_rad"] - plain.filter(seen)["psi"]
    np.testing.assert_allclose(np.sin(turned / 2), 0.0, atol=1e-9)
    assert run.table["setting_vsp_speed"].equals(plain["vsp_speed"].alias("setting_vsp_speed"))
    assert len([n for n in run.meta.notes if "side or back" in n.text]) == (name == "random_run1")
    assert not {"r_rad_s", "ax_m_s2", "battery_v"} & {c for c in run.table.columns if run.known(c)}


def test_problems_of_random_run1(shared_data):
    found = grouped(problems(read_run(shared_data / "cse1" / "random_run1.csv.gz")))
    assert {p.text.split(":")[0] for p in found["missing"]} == {"battery_v", "r_rad_s", "ax_m_s2"}
    assert 5.0 < sum(p.length_s for p in found["gap"] if "psi" in p.text) < 136 / 20
    assert len([p for p in found["gap"] if "psi" in p.text]) == len([p for p in found["gap"] if "north" in p.text])
    assert found["idle"][0].length_s == pytest.approx(55.2, abs=0.1)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda t: t.replace(",u3", ",w3"), r"a\.csv: line 1: column u3: missing"),
        (lambda t: t.replace("0.05,1.0", "0.05,", 1), r"a\.csv: line 3: a field is blank"),
        (lambda t: t.replace("0.05,1.0", "0.05,abc", 1), r"a\.csv: line 3: x: 'abc' is not a number"),
        (lambda t: t.replace("0.25,0.5", "0.25,1.5", 1), r"a\.csv: line 2: u1\.\.u5: expected -1 to 1"),
    ],
)
def test_a_spoilt_recording_is_refused_with_its_line(tmp_path, change, told):
    head = "t,x,y,z,phi,theta,psi,u1,u2,u3,u4,u5,vsp_speed,tracking_lost\n"
    text = head + "".join(f"{t},1.0,2.0,0.0,0.0,0.0,4.0,0.25,0.5,0,0,0,0.3,{k}\n" for k, t in enumerate((0.0, 0.05)))
    path = tmp_path / "a.csv"
    path.write_text(text)
    run = read_run(path)
    assert run.table["psi_rad"].to_list() == [pytest.approx(4.0 - 2 * np.pi), None]
    assert run.table["pwm_port_sway"].to_list() == [1700.0, 1700.0]
    path.write_text(change(text))
    with pytest.raises(RunError, match=told):
        read_run(path)
