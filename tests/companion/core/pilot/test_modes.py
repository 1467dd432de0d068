"""The mode table: every mode with every event, and what must hold of them all. Through the pilot: test_pilot_modes."""

import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.core.messages import Alert
from companion.core.pilot.modes import (
    AT_REST,
    EVENTS,
    MODES,
    NEEDS,
    OVER,
    TABLE,
    THRUSTERS,
    WANTED,
    ModeState,
    apply_conditions,
    apply_event,
    waits_for,
)

PAIRS = [(mode, event) for mode in MODES for event in EVENTS]
DRIVING = {"auto", "hold", "excitation", "manual"}
OPERATOR = {"stop", "start", "hold", "excite", "manual"}
TROUBLE = (
    "link_lost", "unfit", "degraded", "fence_breached", "battery_low", "battery_critical", "override_ignored",
    "outputs_cut", "outputs_still", "solver_failing", "loop_lag", "link_late", "untrusted", "crippled", "rc_takeover",
    "disarmed", "mode_changed", "interlock_trip", "sticks_lost",
)  # fmt: skip
SOMEBODY = ("rc_takeover", "disarmed", "mode_changed", "outputs_cut", "outputs_still", "interlock_trip")


def test_every_pair_has_an_outcome():
    assert set(TABLE) == set(PAIRS) and len(PAIRS) == 9 * 39
    assert {mode for mode in MODES if THRUSTERS[mode] != "neutral"} == DRIVING


@pytest.mark.parametrize(("mode", "event"), PAIRS)
def test_every_pair_is_told_in_a_sentence_and_leaves_a_sound_helm(mode, event):
    before = ModeState(mode, "excitation", "because")
    after, told = apply_event(before, event, "why it is so", 5)
    outcome = TABLE[mode, event]
    assert after.mode == ("excitation" if outcome.next == "wanted" else outcome.next)
    assert after.driving == (THRUSTERS[after.mode] != "neutral") == (after.mode in DRIVING)
    assert outcome.thrusters == ("as wanted" if outcome.next == "wanted" else THRUSTERS[after.mode])
    assert all(isinstance(a, Alert) and a.t_ns == 5 for a in told)
    assert all(a.text.removeprefix("stopped: ").startswith("why it is so") for a in told)
    if after.mode != mode:
        assert "why it is so" in after.why
    else:
        assert after.why in (before.why, *(a.text for a in told)) or mode == "starting"
    if event in TROUBLE and after.mode != mode:
        (alert,) = told
        assert ("neutral" in alert.text) == (not after.driving)
        assert alert.level == ("error" if after.mode in ("safe", "hold") else "warning")


@pytest.mark.parametrize("event", TROUBLE)
@pytest.mark.parametrize("mode", MODES)
def test_trouble_never_sets_a_boat_in_motion(mode, event):
    after = TABLE[mode, event].next
    assert after != "wanted"
    if mode not in DRIVING:
        assert after not in DRIVING
    elif after in DRIVING:
        assert after == mode or (mode, event, after) == ("auto", "solver_failing", "hold")


@pytest.mark.parametrize("event", [e for e in EVENTS if e not in OPERATOR])
def test_only_an_operator_leads_out_of_safe_and_idle(event):
    assert TABLE["safe", event].next == "safe" and TABLE["idle", event].next == "idle"


@pytest.mark.parametrize("event", sorted(OPERATOR))
@pytest.mark.parametrize("mode", ["safe", "idle", "locked", "manual", "starting"])
def test_no_command_drives_without_the_checks_of_starting_or_of_locked(mode, event):
    after = TABLE[mode, event].next
    assert after in ("idle", "starting", "locked") or (mode, event, after) == ("manual", "manual", "manual")


def test_stop_is_neutral_everywhere_and_nothing_follows_of_it():
    assert {TABLE[mode, "stop"].next for mode in MODES} == {"idle"}


@pytest.mark.parametrize("event", SOMEBODY)
def test_what_somebody_else_took_is_not_taken_back(event):
    for mode in DRIVING | {"paused", "locked"}:
        assert TABLE[mode, event].next == "safe"


@pytest.mark.parametrize("mode", [m for m in MODES if m in DRIVING or m == "paused"])
def test_what_a_mode_needs_takes_it_to_neutral_when_it_goes(mode):
    for condition in NEEDS[mode]:
        assert TABLE[mode, condition].next in ("safe", "paused"), condition


def test_modes_that_follow_one_another_directly_need_no_more_than_the_one_before():
    for (mode, event), outcome in TABLE.items():
        if mode in DRIVING and outcome.next in DRIVING and outcome.next != mode:
            assert NEEDS[outcome.next] <= NEEDS[mode], (mode, event)
    assert NEEDS["excitation"] - {"degraded"} <= NEEDS["paused"], "healthy leads back at once"
    assert NEEDS["manual"] <= NEEDS["locked"], "ready leads there at once"


def test_by_hand_a_boat_can_be_fetched():
    """From beyond the fence, without an estimate, with an empty pack, without a solver."""
    for condition in ("unfit", "degraded", "battery_critical", "solver_failing"):
        assert TABLE["manual", condition].next == "manual"
    beyond = ModeState("safe", lasting=frozenset(["fence_breached"]))
    asked, _ = apply_event(beyond, "manual", "manual by the operator", 0)
    asked, _ = apply_conditions(asked, {"fence_breached": "outside the fence"}, 0)
    assert asked.mode == "locked" and waits_for(asked, {"fence_breached": "outside"}) is None
    driving, _ = apply_event(asked, "ready", "all is ready", 0)
    driving, told = apply_conditions(driving, {"fence_breached": "outside the fence"}, 0)
    assert driving.mode == "manual" and not told
    back, _ = apply_conditions(driving, {}, 0)
    again, told = apply_conditions(back, {"fence_breached": "outside the fence"}, 0)
    assert again.mode == "safe" and "fetch it by hand" in told[0].text


@pytest.mark.parametrize(
    ("mode", "event", "text"),
    [
        ("auto", "link_lost", "stopped: why; thrusters are neutral until the operator starts again"),
        (
            "manual",
            "fence_breached",
            "stopped: why (fetch it by hand (manual)); thrusters are neutral until the operator starts again",
        ),
        ("manual", "battery_low", "why (bring the boat home); manual goes on"),
        ("idle", "override_ignored", "why; thrusters stay neutral"),
        ("excitation", "degraded", "why; thrusters are neutral until the estimate is healthy"),
        ("manual", "sticks_lost", "why; thrusters are neutral until the sticks have been at rest"),
        ("starting", "ready", "why; the boat keeps station"),
        ("paused", "healthy", "why; excitation drives"),
        ("safe", "start", "why; thrusters are neutral until all is ready"),
        ("auto", "stop", "why"),
    ],
)
def test_sentences_as_people_read_them(mode, event, text):
    helm, told = apply_event(ModeState(mode, "hold"), event, "why", 0)
    assert (told[0].text if told else helm.why) == text
    assert not told or helm.mode == mode or helm.why == text


def test_levels_as_people_see_them():
    """Motion that ended against the operator's wish is an error, what goes on a warning, what got better an info."""

    def levels(mode, event):
        return [a.level for a in apply_event(ModeState(mode, "hold"), event, "why", 0)[1]]

    assert levels("auto", "disarmed") == levels("auto", "solver_failing") == ["error"]
    assert (
        levels("excitation", "degraded")
        == levels("manual", "sticks_lost")
        == levels("auto", "battery_low")
        == ["warning"]
    )
    assert levels("safe", "battery_critical") == levels("idle", "fence_breached") == ["warning"]
    assert levels("safe", "fence_clear") == levels("idle", "battery_ok") == levels("paused", "healthy") == ["info"]
    for mode, events in (
        ("auto", ("degraded", "healthy", "stop")),
        ("idle", ("link_lost",)),
        ("safe", ("disarmed", "start", "loop_lag")),
        ("excitation", ("finished",)),
        ("starting", ("ready",)),
    ):
        for event in events:
            assert levels(mode, event) == [], (mode, event)


# --- any history --------------------------------------------------------------------------------------

CONDITIONS = [e for e in TROUBLE if e not in (*SOMEBODY, "sticks_lost")]
looks = st.frozensets(st.sampled_from(CONDITIONS), max_size=3)
others = st.sampled_from([e for e in EVENTS if e not in CONDITIONS and e not in OVER.values()])
HISTORIES = st.lists(st.one_of(looks, others), max_size=30)


@settings(max_examples=400, deadline=None, derandomize=True)
@given(HISTORIES)
def test_in_any_history_no_mode_drives_against_its_needs_and_only_operators_end_neutral(history):
    """`ready` comes only where nothing is waited for, as the pilot sends it."""
    helm, present, asked = AT_REST, frozenset(), False
    for item in history:
        before = helm
        if isinstance(item, frozenset):
            present = item
            helm, told = apply_conditions(helm, dict.fromkeys(present, "why"), 0)
            assert helm.lasting == present
            assert not (helm.driving and NEEDS[helm.mode] & present)
            assert len(told) <= 2 * len(present) + len(before.lasting)
            assert apply_conditions(helm, dict.fromkeys(present, "why"), 0)[1] == [], "said once"
        elif item == "ready":
            if waits_for(helm, dict.fromkeys(present, "why")) is None:
                helm, _ = apply_event(helm, item, "why", 0)
        else:
            helm, _ = apply_event(helm, item, "why", 0)
        asked = item in OPERATOR or (asked and helm.mode not in ("safe", "idle"))
        if helm.driving and not before.driving:
            assert asked and item not in OPERATOR
            assert before.mode in ("starting", "locked", "paused")
        if before.mode == "safe" and helm.mode != "safe":
            assert item in OPERATOR


def test_starting_waits_for_what_may_pass_and_gives_up_where_it_may_not():
    waiting = ModeState("starting", "auto")
    for condition in ("link_lost", "unfit", "override_ignored", "loop_lag", "link_late", "untrusted", "crippled"):
        helm, _ = apply_conditions(waiting, {condition: "why"}, 0)
        assert helm.mode == "starting" and waits_for(helm, {condition: "why"}) == "why"
    for condition in ("fence_breached", "battery_critical"):
        helm, told = apply_conditions(replace(waiting, lasting=frozenset([condition])), {condition: "why"}, 0)
        assert helm.mode == "safe" and told, "also where it was there before"
    excitation = ModeState("starting", "excitation")
    assert waits_for(excitation, {"degraded": "no UWB"}) == "no UWB"
    assert waits_for(waiting, {"degraded": "no UWB"}) is None


def test_paused_goes_on_with_a_healthy_estimate_only():
    helm, told = apply_conditions(ModeState("excitation"), {"degraded": "no UWB"}, 0)
    assert helm.mode == "paused" and told[0].level == "warning"
    helm, _ = apply_conditions(helm, {"degraded": "no UWB", "unfit": "lost"}, 0)
    assert helm.mode == "safe"
    helm, _ = apply_conditions(helm, {}, 0)
    assert helm.mode == "safe"
    helm, _ = apply_conditions(ModeState("paused", lasting=frozenset(["degraded"])), {}, 0)
    assert helm.mode == "excitation"


def test_wanted_is_what_was_asked_for_last():
    for command, mode in WANTED.items():
        helm, _ = apply_event(AT_REST, command, "asked", 0)
        assert (helm.mode, helm.wanted) == ("starting", mode)
        assert apply_event(helm, "ready", "all is ready", 0)[0].mode == mode
        kept, _ = apply_event(helm, "start", "asked", 0)
        assert kept.wanted == "auto"


# --- the page ------------------------------------------------------------------------------------------


def test_the_page_shows_this_table():
    page = (Path(__file__).resolve().parents[4] / "docs/modes.md").read_text()
    rows = [[cell.strip(" `") for cell in line.strip("|").split("|")] for line in page.splitlines()
            if line.startswith("|")]  # fmt: skip
    shown = {row[0]: row[1:] for row in rows if row[0] in EVENTS and len(row) == len(MODES) + 1}
    header = next(row for row in rows if row[1:] == list(MODES))
    assert header and set(shown) == set(EVENTS)
    for event, cells in shown.items():
        for mode, cell in zip(MODES, cells, strict=True):
            after = TABLE[mode, event].next
            assert cell == ("" if after == mode else after), (mode, event)
    for mode, needs in NEEDS.items():
        if needs:
            (line,) = [row for row in rows if row[0] == mode and "link_lost" in row[-1]]
            assert set(re.findall(r"\w+_?\w*", line[2].replace("`", ""))) == set(needs), mode


TAKES_AWAY = {"rc_takeover", "disarmed", "mode_changed", "outputs_still", "interlock_trip"}


@pytest.mark.parametrize("event", EVENTS)
def test_at_rest_too_it_is_known_that_somebody_took_the_thrusters_away(event):
    """For the order that still waits at the interlock; an operator's own, and what only lasts, is no such thing."""
    helm, _ = apply_event(ModeState(), event, "why", 7)
    assert helm.taken == ((7, "why") if event in TAKES_AWAY else None)
