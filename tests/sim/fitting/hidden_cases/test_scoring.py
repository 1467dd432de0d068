"""Scoring of findings.json on hand-made answers, and what the report makes of them."""

import csv
import json

import pytest

from tests.hidden import gain, report, score, scoring

GAIN = {"id": "thruster_gain:rear_port", "params": {"thruster": "rear_port", "gain": 0.8}}
FLOW = {"id": "current", "params": {"V_c_m_s": 0.08, "beta_c_deg": -170.0}}


def truth(*causes, kind="medium", depends=None):
    hidden = {"name": "gyre", "depends_on": depends} if depends else None
    return {"kind": kind, "causes": list(causes), "outside": hidden, "uwb_hz": 5}


def found(verdict, *ids, **more):
    return {"verdict": verdict, "causes": [{"name": i, "parameters": {}} for i in ids]} | more


@pytest.mark.parametrize(
    ("case", "findings", "outcome", "points"),
    [
        (truth(GAIN), found("named", GAIN["id"]), "exact", 1.0),
        (truth(GAIN), found("named", "thruster_gain:front_port"), "wrong", -1.0),
        (truth(GAIN), found("named", GAIN["id"], "wind"), "wrong", 0.0),
        (truth(GAIN, FLOW, kind="two"), found("named", "current"), "part", 0.5),
        (truth(GAIN), found("partial", GAIN["id"]), "part", 1.0),
        (truth(GAIN), found("none"), "missed", 0.0),
        (truth(GAIN), found("unknown", "wind"), "abstained", 0.0),
        (truth(GAIN), found("ambiguous", "wind", ambiguous_with=["tether"]), "abstained", 0.0),
        (truth(GAIN), found("ambiguous", "wind", ambiguous_with=[GAIN["id"]]), "ambiguous_right", 0.5),
        (truth(kind="none"), found("none"), "exact", 1.0),
        (truth(kind="none"), found("named", "wind"), "wrong", -1.0),
        (truth(kind="none"), found("unknown"), "false_unknown", 0.0),
        (truth(kind="none"), found("ambiguous", "wind", "current"), "false_unknown", 0.0),
        (truth(kind="outside", depends=["position"]), found("unknown", depends_on=["position"]), "unknown_right", 1.0),
        (truth(kind="outside", depends=["position"]), found("partial", "wind", depends_on=["position"]),
         "unknown_right", 1.0),
        (truth(kind="outside", depends=["thruster"]), found("unknown", depends_on=["thruster:rear_port"]),
         "unknown_right", 1.0),
        (truth(kind="outside", depends=["position"]), found("unknown", depends_on=["time", "position"]),
         "unknown_elsewhere", 0.0),
        (truth(kind="outside", depends=["position"]), found("named", "tether"), "wrong", -1.0),
        (truth(kind="outside", depends=["position"]), found("none"), "missed", 0.0),
        (truth(FLOW, kind="variant"), found("partial", "current"), "exact", 1.0),
        (truth(GAIN), None, "failure", 0.0),
        (truth({"id": "swapped_pair:a+b", "params": {}}), found("named", "swapped_pair:b+a"), "exact", 1.0),
        (truth({"id": "accel_bias", "params": {}}), found("named", "tilt"), "exact", 1.0),
    ],
)  # fmt: skip
def test_rules_of_scoring(case, findings, outcome, points):
    result = scoring.judge(case, findings)
    assert (result["outcome"], result["points"]) == (outcome, pytest.approx(points))
    assert result["exact"] == (outcome in ("exact", "unknown_right"))


def test_parameters_intervals_and_directions():
    told = {"V_c_m_s": {"value": 0.076, "ci95": [0.07, 0.079]}, "beta_c_deg": {"value": 188.0, "ci95": [185, 192]}}
    findings = {"verdict": "named", "causes": [{"name": "current", "parameters": told}]}
    by_key = {p["key"]: p for p in scoring.judge(truth(FLOW), findings)["parameters"]}
    assert by_key["V_c_m_s"]["covered"] is False
    assert by_key["beta_c_deg"]["covered"] is True  # -170 is 190
    assert by_key["size"]["relative_error"] == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("findings", "words"),
    [
        ({"verdict": "sure"}, "verdict 'sure'"),
        ({"verdict": "named", "causes": {}}, None),
        ({"verdict": "named", "causes": "wind"}, "name"),
        ({"verdict": "named", "causes": [{"id": "wind"}]}, "name"),
        (found("named", "current") | {"causes": [{"name": "current", "parameters": [1]}]}, "parameters"),
    ],
)
def test_findings_in_another_form_are_refused(findings, words):
    if words is None:
        assert scoring.judge(truth(FLOW), findings)["outcome"] == "abstained"
        return
    with pytest.raises(scoring.MalformedError, match=words):
        scoring.judge(truth(FLOW), findings)


def test_the_report_counts_what_happened():
    results = [
        scoring.judge(truth(GAIN), found("named", GAIN["id"])) | {"index": 0},
        scoring.judge(truth(GAIN), found("named", "thruster_gain:front_port")) | {"index": 1},
        scoring.judge(truth(FLOW), found("unknown")) | {"index": 2},
        scoring.judge(truth(kind="none"), found("none")) | {"index": 3},
    ]
    table = {r["true"]: r for r in csv.DictReader(report.confusion_csv(results).splitlines())}
    assert table["thruster_gain"]["thruster_gain"] == "1"
    assert table["thruster_gain"]["thruster_gain (other thruster)"] == "1"
    assert table["current"]["unknown"] == "1"
    assert table["none"]["none"] == "1"
    lines = {a.strip(): c for a, _, c in report.goals(results)}
    assert lines["one medium cause, exact set"].startswith("33 % (1 of 3")
    assert "| 1 | medium | thruster_gain:rear_port | thruster_gain:front_port | wrong" in report.markdown(results, {})
    low, high = report.wilson(28, 30)
    assert (low, high) == (pytest.approx(0.787, abs=0.001), pytest.approx(0.982, abs=0.001))


def test_gain_counts_against_what_the_true_causes_gain_when_they_are_refitted():
    E = {"base": 9.0, "refit": 5.0, "extended": 2.0, "true": 0.5}
    assert gain.to_structure(E, {"E": {"extended": 1.0}}) == {"to_structure": pytest.approx(0.75)}
    assert "to_structure" not in gain.to_structure(E, {"E": {"extended": 4.9}}), "nothing to be gained"
    assert "to_structure" not in gain.to_structure(E, {"why_not": "no file"})


def test_a_stopped_scoring_is_resumed_only_with_the_same_cases(tmp_path, monkeypatch, capsys):
    case = {"index": 0, "kind": "none", "wall_s": 1.0, "cpu_s": 1.0} | scoring.judge(truth(kind="none"), found("none"))
    monkeypatch.setattr(score, "run_case", lambda options, index: case | {"index": index})
    words = ["--cases", "3", "--jobs", "1", "--out", str(tmp_path), "--resume"]
    assert score.main([*words, "--nonce", "a", "--first", "1"]) == 0
    assert score.main([*words, "--nonce", "a"]) == 0
    kept = json.loads((tmp_path / "results.json").read_text())
    assert [r["index"] for r in kept["results"]] == [0, 1, 2, 3]
    said, summary = capsys.readouterr().out, (tmp_path / "summary.md").read_text()
    assert said.count("case 1") == 1 and "- cases: 4, 0 to 3" in summary
    with pytest.raises(SystemExit):
        score.main([*words, "--nonce", "b"])
    assert "results.json is of other cases: nonce a, not b" in capsys.readouterr().err
