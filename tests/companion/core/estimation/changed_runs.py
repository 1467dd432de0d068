"""Simulated runs with some of their messages changed."""

from dataclasses import replace as data_replace

from tests.companion.core.estimation.estimator_world import Run

S = 1_000_000_000


def between(m, start_s: float, end_s: float) -> bool:
    return start_s * S <= m.t_rx_ns < end_s * S


def changed(run: Run, change) -> Run:
    return data_replace(run, messages=[change(m) for m in run.messages])
