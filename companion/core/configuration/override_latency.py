"""How late the autopilot obeys: from an override to the pulse at its output, by the rate of its loop.

    plain output    2 / f - 3 ms                        f: SCHED_LOOP_RATE
    by a script     2 / f - 3 ms + 1 / f + 2 ms         the Lua gate: a loop and 2 ms later

Measured medians of ArduPilot Rover 4.6 at 50, 100, 200 and 400 Hz: 37, 17, 7, 2 ms. The gate is 21 to 23 ms later at
50 Hz; by the pulses in lockstep 20, 11 and 8 ms at 50, 100 and 200 Hz (docs/run-file.md).
"""

from __future__ import annotations

LOOPS, LESS_S = 2.0, 0.003
SCRIPT_LOOPS, SCRIPT_S = 1.0, 0.002


def override_latency_s(loop_rate_hz: float, *, script: bool = False) -> float:
    """Median time [s] from override to output at a SCHED_LOOP_RATE [Hz]; `script`: through one."""
    plain_s = max(0.0, LOOPS / loop_rate_hz - LESS_S)
    return plain_s + (SCRIPT_LOOPS / loop_rate_hz + SCRIPT_S if script else 0.0)
