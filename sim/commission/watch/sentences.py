"""What a watch tells a person: a change in a sentence, and what a proposed file is worth."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime

from sim.commission.watch.course import BoatCourse, ToldChange
from sim.commission.watch.history import MissionEntry

WORTH_NATS = 3.0
"""Gain on unseen missions from which a proposed file is called better: odds of 20 to one; assumed."""


def when(entry: MissionEntry) -> str:
    """Date and time of a log's begin, UTC; whether only the time of its file says so."""
    by_file = ", by its file" if entry.begin_by_file else ""
    return datetime.fromtimestamp(entry.begin_unix_s, UTC).strftime("%Y-%m-%d %H:%M UTC") + by_file


def counted(number: int, thing: str) -> str:
    """So many of a thing, in words."""
    return f"{number} {thing}{'s' * (number != 1)}"


def change_sentence(change: ToldChange, entries: Sequence[MissionEntry]) -> str:
    """What has changed, by how much, since when, and the evidence."""
    began = f"{'during' if change.during else 'since'} mission {change.onset + 1}, {when(entries[change.onset])}"
    low, high = sorted(abs(v) for v in change.ci95)
    factor, unit = (100.0, " %") if change.cause.unit == "1" else (1.0, f" {change.cause.unit}")
    interval = f"95 %: {_digits(factor * low)} to {_digits(factor * high)}"
    size = f"{_digits(factor * abs(change.size))}{unit}"
    text = f"{_what(change, size)} {began} ({interval}; {change.nats:.0f} nats)"
    if change.rivals:
        names = ", ".join(name.replace("_", " ").replace(":", " ") for name in change.rivals)
        text += f"; these logs do not tell it from: {names}"
    return text[0].upper() + text[1:] + "."


def _what(change: ToldChange, size: str) -> str:
    up = change.size > 0
    kind, name = change.cause.kind, change.cause.name.partition(":")[2]
    return {
        "thruster": f"thruster {name} {size} {'stronger' if up else 'weaker'}",
        "drag": f"drag of the hull {'up' if up else 'down'} {size} in every direction",
        "surge drag": f"drag of the hull ahead (X) {'up' if up else 'down'} {size}",
        "mass": f"boat {size} {'heavier' if up else 'lighter'}",
        "dead time": f"thrust {size} {'later' if up else 'sooner'} after a command",
    }[kind]


def proposal_sentences(course: BoatCourse, since: Sequence[int]) -> list[str]:
    """What the proposed file is worth on missions that it had not seen; `since`: those of the file in force (indices).

    Missions before a change was told say nothing of a file with the change in it.
    """
    begin = max([1, *(change.told + 1 for change in course.changes)])
    judged = [course.missions[i].gain_nats for i in since if i >= begin]
    if not judged:
        return ["No mission has judged the proposed file yet that it had not seen: the next one will."]
    total = sum(judged)
    verdict = "better than" if total > WORTH_NATS else "worse than" if total < -WORTH_NATS else "as good as"
    return [
        f"The proposed file is {verdict} the one in force. Each mission was predicted before it was learned: "
        f"{total:+.1f} nats in {counted(len(judged), 'mission')}, better in {sum(g > 0 for g in judged)} of them, "
        f"{judged[-1]:+.1f} in the newest."
    ]


def _digits(value: float) -> str:
    return f"{value:.0f}" if value >= 10 else f"{value:.2g}"
