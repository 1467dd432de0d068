"""How late the autopilot obeys: from an override to the pulse at its output, by the rate of its loop.

    plain output    2 / f - 3 ms                f: SCHED_LOOP_RATE
    by a script     7 / (3 f) + 3.3 ms          the Lua gate

Measured medians of ArduPilot Rover 4.6 at 50, 100, 200 and 400 Hz: 37, 17, 7, 2 ms; of the gate, by the pulses in
lockstep, 50, 27 and 15 ms at 50, 100 and 200 Hz (docs/run-file.md).
"""

from __future__ import annotations

LOOPS, LESS_S = 2.0, 0.003
SCRIPT_LOOPS, SCRIPT_S = 7 / 3, 0.01 / 3


def override_latency_s(loop_rate_hz: float, *, script: bool = False) -> float:
    """Median time [s] from override to output at a SCHED_LOOP_RATE [Hz]; `script`: through one."""
    if script:
        return SCRIPT_LOOPS / loop_rate_hz + SCRIPT_S
    return max(0.0, LOOPS / loop_rate_hz - LESS_S)
