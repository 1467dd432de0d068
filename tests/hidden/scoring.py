"""One findings.json against one sealed truth: names, abstentions, dependency, parameters. Rules: README.md.

points = share of the true causes named - number of wrong names      an abstention is 0
nothing hidden: 1 for "none"; outside the catalogue: 1 for "unknown" or "partial" with the right dependency
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from tests.hidden.effects.catalogue import CATALOGUE
from tests.hidden.names import VERDICTS, canonical, family

Findings = Mapping[str, Any]


class MalformedError(ValueError):
    """findings.json lacks what scoring needs, or has it in another form."""


def judge(truth: Mapping[str, Any], findings: Findings | None) -> dict[str, Any]:
    """Outcome of one case. `findings` None: the program gave none. Raises MalformedError."""
    causes = {canonical(c["id"]): c for c in truth["causes"]}
    shell = {"kind": truth["kind"], "truth": sorted(causes), "uwb_hz": truth["uwb_hz"],
             "tilt": truth.get("tilt_told", True), "outside": (truth["outside"] or {}).get("name")}  # fmt: skip
    if findings is None:
        return shell | {"outcome": "failure", "verdict": "failure", "named": [], "wrong": [], "points": 0.0,
                        "exact": False, "hits": [], "parameters": []}  # fmt: skip
    verdict = findings.get("verdict")
    if verdict not in VERDICTS:
        raise MalformedError(f"verdict {verdict!r}: expected one of {', '.join(VERDICTS)}")
    listed = {canonical(_text(c, "name")): c for c in _list(findings, "causes")}
    passable = set(truth.get("passable", ())) - set(causes)
    named = set(listed) - passable if verdict in ("named", "partial") else set()
    if verdict == "named" and listed.keys() <= passable and passable:
        verdict = "none"  # what it names is so; it was not asked for
    hits = sorted(named & set(causes))
    result = shell | {
        "verdict": verdict,
        "named": sorted(named),
        "hits": hits,
        "wrong": sorted(named - set(causes)),
        "exact": bool(causes) and named == set(causes) and (verdict == "named" or truth["kind"] == "variant"),
        "parameters": [],
    }
    if truth["outside"]:
        return result | _outside(truth["outside"], findings, result)
    if verdict == "ambiguous" and causes:
        candidates = set(listed) | {canonical(n) for n in _rivals(findings)}
        right = set(causes) <= candidates
        return result | {
            "exact": False,
            "outcome": "ambiguous_right" if right else "abstained",
            "points": 0.5 if right else 0.0,
        }
    if truth["kind"] != "variant":
        result["parameters"] = [p for name in hits for p in _parameters(name, causes[name], listed[name])]
    else:
        result["flagged"] = verdict == "partial" or any(bool(listed[n].get("form_doubtful")) for n in hits)
    return result | _plain(causes, result)


def _plain(causes: Mapping[str, Any], result: dict[str, Any]) -> dict[str, Any]:
    wrong, verdict = result["wrong"], result["verdict"]
    if not causes:
        points = 1.0 if verdict == "none" else -float(len(wrong))
        outcome = "exact" if verdict == "none" else "wrong" if wrong else "false_unknown"
        return {"outcome": outcome, "points": points, "exact": verdict == "none"}
    points = len(result["hits"]) / len(causes) - len(wrong)
    if wrong:
        outcome = "wrong"
    elif result["exact"]:
        outcome = "exact"
    else:
        outcome = "part" if result["hits"] else "missed" if verdict == "none" else "abstained"
    return {"outcome": outcome, "points": points}


def _outside(outside: Mapping[str, Any], findings: Findings, result: dict[str, Any]) -> dict[str, Any]:
    """No name is right. "named" confirms falsely; under "partial" names are only noted."""
    depends = [str(d) for d in _list(findings, "depends_on")]
    words = [d.split(":", 1)[0] for d in depends]
    spoke = result["verdict"] in ("unknown", "partial")
    right = spoke and bool(words) and words[0] in outside["depends_on"]
    confirmed = result["verdict"] == "named"
    outcome = ("wrong" if confirmed else "unknown_right" if right else "unknown_elsewhere" if spoke
               else "missed" if result["verdict"] == "none" else "abstained")  # fmt: skip
    return {
        "outcome": outcome,
        "exact": right,
        "points": -float(len(result["wrong"])) if confirmed else float(right),
        "wrong": result["wrong"] if confirmed else [],
        "falsely_confirmed": confirmed,
        "dependency_right": right,
        "dependency_listed": spoke and bool(set(words) & set(outside["depends_on"])),
        "depends_on": depends,
    }


def _parameters(name: str, cause: Mapping[str, Any], listed: Findings) -> list[dict[str, Any]]:
    """Each numeric parameter that both sides have; the relative error belongs to the size, on its first entry."""
    effect = CATALOGUE[family(name)]
    given = listed.get("parameters", {})
    if not isinstance(given, Mapping):
        raise MalformedError(f"causes: {name}: parameters: expected an object by parameter name")
    out = []
    for key, true in cause["params"].items():
        told = given.get(key)
        if isinstance(true, bool) or not isinstance(true, (int, float)) or not isinstance(told, Mapping):
            continue
        value = _number(told.get("value"), f"{name}: {key}: value")
        entry = {"id": name, "key": key, "true": true, "value": value, "covered": _covered(key, true, told)}
        out.append(entry)
    keys = effect.reported or effect.size
    if keys and all(isinstance(given.get(k), Mapping) for k in keys):
        off = [float(given[k]["value"]) - float(cause["params"][k]) for k in keys]
        size = [float(cause["params"][k]) - effect.neutral for k in keys]
        error = math.hypot(*off) / max(math.hypot(*size), 1e-12)
        out.append({"id": name, "key": "size", "relative_error": error})
    return out


def _covered(key: str, true: float, told: Mapping[str, Any]) -> bool | None:
    """Whether the 95 % interval holds the truth; directions wrap round, a wave's by 180 degrees."""
    ends = told.get("ci95")
    if not isinstance(ends, (list, tuple)) or len(ends) != 2:
        return None
    low, high = (_number(e, f"{key}: ci95") for e in ends)
    turn = 180.0 if key == "beta_wave_deg" else 360.0 if key.endswith(("beta_c_deg", "beta_w_deg", "phase_deg")) else 0
    shifts = (0.0,) if not turn else tuple(turn * k for k in range(-2, 3))
    return any(low <= true + s <= high for s in shifts)


def _rivals(findings: Findings) -> list[str]:
    """ambiguous_with: names, sets of names, or objects with a name."""
    out: list[str] = []
    for entry in _list(findings, "ambiguous_with"):
        if isinstance(entry, str):
            out.append(entry)
        elif isinstance(entry, Mapping):
            out.append(_text(entry, "name"))
        elif isinstance(entry, list):
            out += [str(e) for e in entry]
    return out


def _list(findings: Findings, key: str) -> list[Any]:
    value = findings.get(key) or []
    if isinstance(value, str):
        return [value]
    if not isinstance(value, list):
        raise MalformedError(f"{key}: expected a list")
    return value


def _text(entry: Any, key: str) -> str:
    if not isinstance(entry, Mapping) or not isinstance(entry.get(key), str):
        raise MalformedError(f"causes: each needs a text {key!r}")
    return entry[key]


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise MalformedError(f"causes: {where}: expected a number")
    return float(value)


def confusion_cells(result: Mapping[str, Any]) -> list[tuple[str, str]]:
    """(row, column) for the confusion matrix: a true family against what was said of it."""
    wrong = [family(w) for w in result["wrong"]]
    said = wrong or [result["verdict"] if result["verdict"] != "named" else "not named"]
    if not result["truth"]:
        return [(f"outside: {result['outside']}" if result["outside"] else "none", s) for s in said]
    cells = []
    for name in result["truth"]:
        if name in result["hits"]:
            cells.append((family(name), family(name)))
        else:
            words = said if result["outcome"] != "ambiguous_right" else ["ambiguous, true among them"]
            cells += [(family(name), f"{s} (other thruster)" if s == family(name) else s) for s in words]
    return cells
