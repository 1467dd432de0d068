"""Verdicts from what was found, and files named by a user."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sim.fitting.diagnose.catalogue.effect import Effect, EffectParameter
from sim.fitting.diagnose.report import verdict
from sim.fitting.diagnose.report.findings import Adequacy, verdict_of
from sim.fitting.diagnose.selection.adequacy import AdequacyJudgement
from sim.fitting.diagnose.selection.candidate_score import Candidate
from sim.fitting.diagnose.selection.masking import NO_MASKING, Masking
from sim.fitting.diagnose.selection.search import AcceptedCause, SearchResult

GOOD, BAD = Adequacy(passed=True), Adequacy(passed=False, depends_on=("heading",))


@pytest.mark.parametrize(
    ("names", "rivals", "adequacy", "wanted"),
    [
        ([], {}, None, ("none", (), {})),
        ([], {}, GOOD, ("none", (), {})),
        ([], {}, BAD, ("unknown", (), {})),
        (["lag"], {}, GOOD, ("named", ("lag",), {})),
        (["lag"], {}, BAD, ("partial", ("lag",), {})),
        (["lag"], {"lag": [("dead_time", 5.9)]}, GOOD, ("ambiguous", ("lag",), {"lag": ("dead_time",)})),
        (["lag"], {"lag": [("dead_time", 6.1)]}, GOOD, ("named", ("lag",), {})),
        (
            ["lag", "wash"],
            {"lag": [("wind", 9.0)], "wash": [("dead_time", 1.0), ("tether", 2.0)]},
            GOOD,
            ("ambiguous", ("lag", "wash"), {"wash": ("dead_time", "tether")}),
        ),
        (["lag"], {"lag": [("dead_time", -2.0)]}, None, ("ambiguous", ("lag",), {"lag": ("dead_time",)})),
        (["lag", "dead_time"], {"lag": [("dead_time", 1.0)]}, GOOD, ("named", ("lag", "dead_time"), {})),
        (["lag", "wash"], {"lag": [("dead_time", 1.0)]}, BAD, ("partial", ("wash",), {"lag": ("dead_time",)})),
        (["lag"], {"lag": [("dead_time", 1.0)]}, BAD, ("unknown", (), {"lag": ("dead_time",)})),
        (["accel_bias"], {"accel_bias": [("tilt", 0.0)]}, GOOD, ("named", ("accel_bias",), {})),
    ],
)
def test_the_verdict(names, rivals, adequacy, wanted):
    assert verdict_of(names, rivals, {"accel_bias": ("tilt",)}, adequacy) == wanted


def cause(name: str, fitted: str, contains: str = "") -> AcceptedCause:
    return AcceptedCause(entry(name, contains), Candidate(fitted, 50.0, 50.0, np.ones(1), np.eye(1), 5.0, 4.0), fitted)


def entry(name: str, contains: str = "") -> Effect:
    return Effect(name, "hull", "", "", (EffectParameter("a", "1", 1.0, 1.0, 0.3),), {}, contains=contains)


def test_rivals_have_the_names_of_findings_and_are_not_there_already():
    """A wind that was gusty in the end, a current that was steady, a tether at one of its places."""
    fit: Any = SimpleNamespace(effects=[entry("turning_current", "current"), entry("current"), entry("lag")])
    rivals = {
        "wind": [("tether", 2.0), ("turning_current", 3.0), ("lag", 4.0)],
        "tether": [("wind", 1.0)],
        "current": [("turning_current", 5.0)],
    }
    selection: Any = SimpleNamespace(rivals=rivals)
    causes = (cause("gusty_wind", "wind"), cause("tether", "tether@-0.6"), cause("current", "current"))
    found = SearchResult(selection, causes).rivals(fit)
    assert found == {
        "gusty_wind": [("tether", 2.0), ("lag", 4.0)],
        "tether": [("gusty_wind", 1.0)],
        "current": [("turning_current", 5.0)],
    }
    assert verdict_of([c.effect.name for c in causes], found, {}, GOOD)[2] == {
        "gusty_wind": ("lag",),
        "current": ("turning_current",),
    }
    turned = (cause("lag", "lag"), cause("turning_current", "turning_current@0.1", "current"))
    late: Any = SimpleNamespace(rivals={"lag": [("current", 0.5), ("wash", 1.0)]})
    assert SearchResult(late, turned).rivals(fit) == {"lag": [("wash", 1.0)]}


def test_causes_that_fall_with_others_are_told_and_what_is_left_over_is_judged_without_their_masking(monkeypatch):
    """A gusty wind that smooth functions make unnecessary, and a wash that was there only beside it; then a tether."""
    judged = iter(
        AdequacyJudgement(left, withdrawn=frozenset({id_})) for left, id_ in ((GOOD, "wind"), (BAD, "tether"))
    )
    stay = iter([{"lag", "tether"}, {"lag"}])
    asked: list[Masking] = []

    def adequate(_fit, _selection, _ambient, masking, _known):
        asked.append(masking)
        return next(judged)

    def without(found, _fit, _gone):
        names = next(stay)
        return SearchResult(found.selection, tuple(c for c in found.causes if c.effect.name in names))

    monkeypatch.setattr(SearchResult, "without", without)
    none: Any = None
    causes = (cause("gusty_wind", "wind"), *(cause(name, name) for name in ("wash", "lag", "tether")))
    sound, found, withdrawn = verdict.withdraw_unsupported(none, SearchResult(none, causes), None, adequate, False)
    assert [c.effect.name for c in found.causes] == ["lag"] and not sound.adequacy.passed
    assert withdrawn == {"gusty_wind": verdict.UNNEEDED, "wash": verdict.FALLEN, "tether": verdict.UNNEEDED}
    assert asked == [Masking.of(["gusty_wind"]), NO_MASKING], (
        "and no more: a tether masks nothing, and nothing fell with it"
    )


def judged(**gains: tuple[float, float]) -> Any:
    """Intervals of the gain by channel, at the horizon by which causes are judged."""
    return SimpleNamespace(
        errors=[SimpleNamespace(horizon_s=verdict.JUDGED_S, channel=k, gain_ci95=v) for k, v in gains.items()]
    )


@pytest.mark.parametrize(
    ("said", "causes", "gains", "why"),
    [
        ("named", [("lag", True)], {"position": (-0.3, -0.1), "heading": (-0.2, 0.1)}, verdict.HARMFUL),
        ("named", [("lag", True)], {"position": (-0.3, -0.1), "heading": (0.1, 0.2)}, ""),
        ("partial", [("lag", True)], {"position": (-0.46, 0.24), "heading": (-0.38, 0.35)}, verdict.UNPROVEN),
        ("partial", [("lag", True)], {"position": (-0.46, 0.24), "heading": (0.01, 0.35)}, ""),
        ("partial", [("lag", True), ("wash", False)], {"position": (-0.46, 0.24)}, verdict.UNPROVEN),
        ("partial", [("wash", False)], {"position": (-0.46, 0.24)}, ""),
        ("named", [("lag", True)], {"position": (-0.46, 0.24)}, ""),
        ("partial", [("", False), ("lag", True)], {"position": (-0.46, 0.24)}, ""),
    ],
    ids=["harm", "helps too", "doubt", "helps", "doubt of one", "no doubt", "nothing left over", "chance beside it"],
)
def test_held_out_readings_take_causes_back(said, causes, gains, why):
    there: Any = SimpleNamespace(
        verdict=said, causes=[SimpleNamespace(fitted=id_, form_doubtful=doubt) for id_, doubt in causes]
    )
    assert verdict.held_out_objection(there, judged(**gains)) == why
