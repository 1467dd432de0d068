"""Drawing hidden-effect cases, their files, and the command from drawing to report."""

import json
import sys

import pytest

from companion.core.model.load_vessel import load_vessel
from companion.logs.readers.read_run import read_run
from companion.logs.runs.problems import problems
from tests.hidden import draw, fixed, gain, names, score, write
from tests.hidden.effects import catalogue as effects
from tests.hidden.effects import imperfections
from tests.hidden.plant.vessel import read_vessel, vessel_toml

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


@pytest.mark.parametrize("index", [0, 1, pytest.param(2, marks=pytest.mark.long)])
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


@pytest.mark.parametrize("family", ["thruster_gain", "current", pytest.param("uwb_lever_arm", marks=pytest.mark.long)])
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
