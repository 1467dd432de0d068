"""What a person is told: thing, size, since when, evidence; and what a proposed file is worth."""

from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

from sim.commission.watch.causes import watched
from sim.commission.watch.course import BoatCourse, MissionCourse, ToldChange
from sim.commission.watch.figures import gains
from sim.commission.watch.filter import Belief
from sim.commission.watch.history import MissionEntry
from sim.commission.watch.mission_fit import boat_effects
from sim.commission.watch.sentences import change_sentence, proposal_sentences, when
from tests.support.vessel_fixtures import boat

VESSEL = boat("aritra")
WATCHED = watched(VESSEL, boat_effects(VESSEL))
ENTRIES = [
    MissionEntry(
        log="x", file_sha256=f"{i}", data_sha256=f"{i}", begin_unix_s=1_795_000_000.0 + 86400 * i, duration_s=1.0,
        names=(), precision=[], eta=[], day={}, latent=(0, 0, 0), thrust=(0, 0, 0),
    )
    for i in range(12)
]  # fmt: skip


def change(name: str, size: float, se: float, **more) -> ToldChange:
    cause = next(c for c in WATCHED.causes if c.name == name)
    interval = (size - 1.96 * se, size + 1.96 * se)
    return replace(ToldChange(cause, 9, False, 10, 23.4, size, interval, ()), **more)


@pytest.mark.parametrize(
    ("one", "says"),
    [
        (change("thruster_gain:rear_port", -0.14, 0.01), "Thruster rear_port 14 % weaker since mission 10"),
        (change("hull_fouling", 0.2, 0.02), "Drag of the hull up 20 % in every direction since"),
        (change("surge_drag", 0.31, 0.02), "Drag of the hull ahead (X) up 31 % since"),
        (change("payload", 4.2, 0.3), "Boat 4.2 kg heavier since"),
        (change("dead_time", 0.08, 0.01), "Thrust 0.08 s later after a command since"),
        (change("hull_fouling", 0.2, 0.02, during=True), "in every direction during mission 10, 2026-11-27"),
    ],
)
def test_a_change_in_a_sentence(one, says):
    assert says in change_sentence(one, ENTRIES)


def test_evidence_interval_and_rivals_are_said():
    text = change_sentence(change("thruster_gain:rear_port", -0.14, 0.01, rivals=("payload",)), ENTRIES)
    assert "(95 %: 12 to 16; 23 nats)" in text and text.endswith("do not tell it from: payload.")


def test_a_begin_by_the_time_of_a_file_is_told_from_one_of_the_log():
    """A copy of a file has the time of the copying."""
    assert when(ENTRIES[0]) == "2026-11-18 11:06 UTC"
    assert when(structs.replace(ENTRIES[0], begin_by_file=True)) == "2026-11-18 11:06 UTC, by its file"


def after(gains: list[float], changes: tuple[ToldChange, ...] = ()) -> BoatCourse:
    belief = Belief(np.zeros(1), np.eye(1))
    missions = tuple(MissionCourse(belief, g, 1.0, 0.01, 1.0, (0.0, "")) for g in gains)
    return BoatCourse(WATCHED, missions, changes)


def worth(found: BoatCourse) -> str:
    """The sentence of a history in which no file was accepted."""
    return proposal_sentences(found, range(len(found.missions)))[0]


def test_missions_of_an_earlier_file_do_not_judge_the_proposed_one():
    found = after([0.0, -50.0, 4.0, 6.0])
    assert "+10.0 nats in 2 missions, better in 2 of them, +6.0 in the newest" in proposal_sentences(found, (2, 3))[0]
    assert "+4.0 nats in 1 mission, better" in proposal_sentences(found, (0, 2))[0], "the first has nothing before it"


def test_a_proposed_file_is_judged_by_missions_that_it_had_not_seen():
    assert "better than" in worth(after([0.0, 4.0, 5.0]))
    assert "worse than" in worth(after([0.0, -4.0, -5.0]))
    assert "as good as" in worth(after([99.0, 1.0, -1.0]))
    assert "No mission has judged" in worth(after([0.0]))


@pytest.mark.parametrize("missions", [1, 2, 5])
def test_missions_are_whole_numbers_on_the_axis_of_the_history(missions):
    ticks = gains(after([1.0] * missions)).axes[0].get_xticks()
    assert ticks.tolist() == np.round(ticks).tolist()


def test_missions_before_a_change_was_told_do_not_judge_a_file_with_the_change():
    told = change("hull_fouling", 0.3, 0.02, told=2)
    assert "No mission has judged" in worth(after([0.0, 4.0, -50.0], (told,)))
    assert "+6.0 nats in 1 mission, better" in worth(after([0.0, 4.0, -50.0, 6.0], (told,)))
