"""Signs and sides by `aritra diagnose` and `aritra identify`: put right and told first, or left as found. Seed 7300."""

import msgspec
import pytest

from companion.__main__ import main
from companion.core.model.load_vessel import load_vessel
from companion.core.model.thrusters import configuration_matrix
from companion.logs.readers.table import write_run
from sim.fitting.diagnose.report.findings import Findings
from sim.fitting.identify.record import Record
from tests.sim.fitting.wiring.miswired import BOAT, FP, FS, drive, miswired
from tests.support.vessel_fixtures import BOATS

FILE, FAULT = BOATS / "aritra.toml", f"swapped:{FP}+{FS}"
NAME = f"swapped_pair:{FP}+{FS}"


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("wiring") / "drive.csv"
    write_run(drive(FAULT, seed=7300, seconds=90.0, uwb_hz=5.0), path)
    return path


def diagnosed(log, out, *more, vessel=FILE):
    code = main(["diagnose", str(log), "--vessel", str(vessel), "--out", str(out), "--no-report", *more])
    return code, msgspec.json.decode((out / "findings.json").read_bytes(), type=Findings)


@pytest.mark.long
def test_a_diagnosis_goes_on_with_the_swap_put_right(log, tmp_path, capsys):
    code, found = diagnosed(log, tmp_path / "out")
    assert code == 0 and found.verdict == "named" and [c.name for c in found.causes] == [NAME]
    assert found.summary[0].startswith("Signs and sides: ") and found.wiring.findings[0].name == FAULT
    assert "Signs and sides" in capsys.readouterr().out
    for name in ("wiring.toml", "extended.toml"):
        written = load_vessel((tmp_path / "out" / name).read_text(), name=name)
        assert (configuration_matrix(written) == configuration_matrix(miswired(FAULT))).all()
    for name in ("refitted.toml", "extended_numbers.toml"):
        written = load_vessel((tmp_path / "out" / name).read_text(), name=name)
        assert (configuration_matrix(written) == configuration_matrix(BOAT)).all(), "without causes"
    code, again = diagnosed(log, tmp_path / "again", vessel=tmp_path / "out" / "wiring.toml")
    assert code == 0 and again.verdict == "none" and again.wiring.findings == ()
    assert not (tmp_path / "again" / "wiring.toml").exists()


@pytest.mark.long
def test_as_found_leaves_it_to_the_catalogue(log, tmp_path):
    _, found = diagnosed(log, tmp_path / "out", "--as-found")
    assert NAME in [c.name for c in found.causes] and found.causes[0].parameters == {}
    assert found.wiring.as_found and not (tmp_path / "out" / "wiring.toml").exists()


@pytest.mark.long
def test_an_identification_goes_on_with_the_swap_put_right(log, tmp_path, capsys):
    code = main(["identify", str(log), "--vessel", str(FILE), "--out", str(tmp_path / "out"), "--no-taylor"])
    record = msgspec.json.decode((tmp_path / "out" / "identify.json").read_bytes(), type=Record)
    assert code == 1 and record.wiring.findings[0].name == FAULT and "wiring.toml" in record.files
    vessel = load_vessel((tmp_path / "out" / "vessel.toml").read_text(), name="vessel.toml")
    assert (configuration_matrix(vessel).round(6) == configuration_matrix(miswired(FAULT)).round(6)).all()
    page = (tmp_path / "out" / "report.html").read_text()
    assert page.index("Signs and sides") < page.index("What to believe")
    assert record.structured.converged and record.verdict.believe in ("structured", "base file")
    out = capsys.readouterr().out
    assert out.index("Signs and sides: ") < out.index("on held-out data")
