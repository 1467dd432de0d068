"""The history of a boat as one page, nothing to load from a network."""

from __future__ import annotations

from pathlib import PurePath

from sim.commission.watch.course import BoatCourse, threshold_nats
from sim.commission.watch.figures import courses, gains
from sim.commission.watch.history import History
from sim.commission.watch.sentences import change_sentence, counted, proposal_sentences, when
from sim.fitting.validate.report import Section, page
from sim.fitting.validate.table import ScoreTable

HEAD = ("mission", "begin", "log", "current [m/s]", "unexplained [%]", "s²", "gain [nats]", "best change [nats]", "")


def history_page(history: History, course: BoatCourse) -> str:
    """The page as text."""
    told = tuple(change_sentence(change, history.entries) for change in course.changes)
    doubts = tuple(doubt for entry in history.entries for doubt in entry.doubts)
    then = "It is the proposed one." if history.is_accepted else "`--accept` puts the proposed one in its place."
    nothing = (f"Nothing has changed that {counted(len(course.missions), 'mission')} can show.",)
    sections = [
        Section("Changes", told or nothing, look=bool(told)),
        Section(
            "Proposed vessel file",
            (
                *proposal_sentences(course, history.since),
                f"In force: {history.in_force}. {then}",
            ),
        ),
        Section(
            "Course of the parameters",
            figures=((courses(course, history.vessel), "What is believed after each mission, with its 95 % band."),),
            note="One scale, common to thrust, drag and inertia, is as well known as at the beginning: motion shows "
            "forces only in proportion to inertia. A dashed line: a change that was told began here.",
        ),
        Section(
            "Missions",
            doubts,
            tables=(_missions(history, course),),
            figures=((gains(course), "Each mission is predicted before it is learned."),),
            note="Unexplained: share of the forces in this log that the model cannot explain (waves, gusts), by which "
            "its word is discounted. s²: so many of its samples count as one. Best change: evidence of the likeliest "
            f"change by then; from {threshold_nats(len(course.watched.causes)):.1f} nats on it is told, if its size is "
            "worth a name.",
        ),
    ]
    return page(f"History of {history.vessel.name}", sections)


def _missions(history: History, course: BoatCourse) -> ScoreTable:
    rows = []
    for i, (entry, mission) in enumerate(zip(history.entries, course.missions, strict=True), 1):
        north, east = (entry.day.get(f"current.{axis}_m_s", 0.0) for axis in ("north", "east"))
        nats, name = mission.best
        rows.append(
            (str(i), when(entry), str(PurePath(*PurePath(entry.log).parts[-2:])), f"{(north**2 + east**2) ** 0.5:.2f}",
             f"{100 * mission.unexplained:.0f}", f"{mission.scale:.1f}", f"{mission.gain_nats:+.1f}", f"{nats:.1f}",
             name if nats > 0 else ""),
        )  # fmt: skip
    return ScoreTable(HEAD, tuple(rows))
