"""An innovation gate that re-opens when what it rejects is consistent.

    s = clip(sqrt(S), floor, ceiling);   accept if |nu| <= limit s

The ceiling keeps an uncertain filter from accepting an outlier of 15 m. Rejected innovations are kept: `reopen_count`
or more in a row over `reopen_span_s`, four fifths of them within `agreement` of each other, are a real offset, and the
gate re-opens. Outliers do not agree; repeats of a stale value do not last so long.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, NamedTuple

from companion.core.sensors.sensor import GateRule

Verdict = Literal["accepted", "rejected", "reopened"]


class Rejection(NamedTuple):
    """One innovation [unit of the measurement] that did not pass."""

    t_ns: int
    innovation: float


@dataclass(frozen=True, slots=True)
class Gate:
    """State of one gate: when it last accepted, and the rejections since. `is_open`: the next one passes anyhow."""

    accepted_ns: int | None = None
    rejections: tuple[Rejection, ...] = ()
    is_open: bool = False

    def starved_s(self, t_ns: int) -> float:
        """Seconds since the last acceptance; infinite before the first."""
        return float("inf") if self.accepted_ns is None else (t_ns - self.accepted_ns) * 1e-9


OPEN = Gate(is_open=True)
"""Of what is known so badly that any measurement is better."""


def all_accepted_ns(gates: Iterable[Gate], since_ns: int) -> int:
    """When the gate that has waited longest accepted last, or `since_ns` if that is later."""
    return max(since_ns, min(since_ns if gate.accepted_ns is None else gate.accepted_ns for gate in gates))


def judge(gate: Gate, rule: GateRule, t_ns: int, innovation: float, sigma: float) -> tuple[Verdict, Gate]:
    """Verdict on one innovation with sigma = sqrt(S), and the gate afterwards."""
    if gate.is_open or abs(innovation) <= rule.limit * min(max(sigma, rule.floor), rule.ceiling):
        return "accepted", Gate(t_ns)
    log = (*gate.rejections, Rejection(t_ns, innovation))
    due_ns = t_ns - round(rule.reopen_span_s * 1e9)
    while len(log) > rule.reopen_count and log[1].t_ns <= due_ns:
        log = log[1:]
    if len(log) >= rule.reopen_count and log[0].t_ns <= due_ns and _agree(log, rule.agreement):
        return "reopened", Gate(t_ns)
    return "rejected", Gate(gate.accepted_ns, log)


def _agree(log: tuple[Rejection, ...], agreement: float) -> bool:
    """Whether four fifths of the innovations lie within `agreement` of each other, around the median."""
    values = sorted(r.innovation for r in log)
    middle = values[len(values) // 2]
    return sum(abs(v - middle) <= agreement / 2 for v in values) >= 0.8 * len(values)
