"""Servo outputs of an ArduPilot log as commands of the vessel file's thrusters: which output drives which.

The autopilot's parameters say it where the log has them: SERVOn_FUNCTION = 50 + k passes RC channel k on (RCINk, the
thruster whose `channel` is k), 73 and 74 are Rover's left and right throttle, the thruster to port and to starboard of
a boat with two. Else outputs 1..n drive the thrusters in the vessel file's order.
Source: https://ardupilot.org/rover/docs/common-rcoutput-mapping.html
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from math import isfinite

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.core.constants import NEUTRAL_US
from companion.core.preflight.rows import ParameterSet
from companion.core.preflight.wiring import Companion, wiring
from companion.logs.readers.join import Stream
from companion.logs.runs.nearest import distance, nearest
from companion.logs.runs.run import LogProblem

TOGETHER_NS = 50_000_000
"""Half a step of records at 10 Hz, in which ArduPilot logs its outputs at the least; assumed."""
_FUNCTION = re.compile(r"SERVO(\d+)_FUNCTION")
_PASSED_ON = 50  # function of RC channel 0, of which there is none; to channel 16
_THROTTLE_LEFT, _THROTTLE_RIGHT = 73, 74


def outputs_of(vessel: VesselFile, parameters: Mapping[str, float]) -> tuple[dict[str, int], str]:
    """Output (from 1) by name of thruster, and how it is known, as text."""
    functions = {
        int(m[1]): round(value)
        for name, value in parameters.items()
        if (m := _FUNCTION.fullmatch(name)) and isfinite(value)
    }
    by_function = {function: n for n, function in sorted(functions.items(), reverse=True)}
    passed = {t.name: by_function.get(_PASSED_ON + t.channel) for t in vessel.thrusters}
    port_first = sorted(vessel.thrusters, key=lambda t: t.y_m)
    sides = {t.name: by_function.get(f) for t, f in zip(port_first, (_THROTTLE_LEFT, _THROTTLE_RIGHT), strict=False)}
    for found in (passed, sides):
        known = {name: n for name, n in found.items() if n is not None}
        if len(known) == len(vessel.thrusters):
            return known, "by SERVOn_FUNCTION"
    return {t.name: n for n, t in enumerate(vessel.thrusters, 1)}, "in the order of the vessel file"


def carriers(channels: Sequence[int], parameters: Mapping[str, float]) -> dict[int, int]:
    """Output (from 1) by place in `channels` (from 0), the RC channels of a boat's thrusters, then servos.

    What no SERVOn_FUNCTION gives an output is left out; where none of them was logged, outputs 1..n carry all, as our
    parameter files wire them.
    """
    if not any(_FUNCTION.fullmatch(name) for name in parameters):
        return {place: place + 1 for place in range(len(channels))}
    boat = Companion(tuple((str(n), n) for n in channels), still=(), system_id=0, lease_s=0.0, latency_s=0.0)
    outputs = wiring(ParameterSet(parameters), boat).outputs
    return {o.thruster: o.number for o in reversed(outputs) if o.thruster is not None}


def output_stream(
    groups: Mapping[int, Sequence[tuple[float, ...]]],
    vessel: VesselFile | None,
    parameters: Mapping[str, float],
    notes: list[LogProblem],
) -> tuple[Stream, str]:
    """Pulses as commands, and a text: which output drives which thruster. `groups`: number of a group's first output ->
    rows (t_ns, pulse width of each of its outputs [us]), as records hold them; one group at least has rows.

    Without a vessel file: out1.. of those that ever had a pulse. No pulse (0) becomes neutral, because the speed
    controller then stops its motor; a note is added to `notes`. An output that was not logged is unknown (NaN).
    """
    t_ns, pulses = _together(groups)
    if vessel:
        picked, how = outputs_of(vessel, parameters)
        text = ", ".join(f"{name} output {n}" for name, n in picked.items()) + f" ({how})"
    else:
        picked = {f"out{n}": n for n in range(1, pulses.shape[1] + 1) if (pulses[:, n - 1] > 0).any()}
        text = "by number of the output"
    columns = {}
    for name, n in picked.items():
        pwm_us = pulses[:, n - 1] if n <= pulses.shape[1] else np.full(len(pulses), np.nan)
        dead = pwm_us == 0
        if dead.any():
            lost = f"pwm_{name}: output {n} had no pulse in {int(dead.sum())} of {len(dead)} records: neutral"
            notes.append(LogProblem(kind="no pulse", text=lost))
        columns[f"pwm_{name}"] = np.where(dead, float(NEUTRAL_US), pwm_us)
    return Stream("outputs", t_ns, columns, held=True), text


def _together(groups: Mapping[int, Sequence[tuple[float, ...]]]) -> tuple[np.ndarray, np.ndarray]:
    """Stamps (n,) [ns] of the group with the most rows, and pulses (n, outputs) at them.

    Of other groups the nearest rows, which are logged at once with them; NaN where there is none within `TOGETHER_NS`.
    """
    known = {first: rows for first, rows in groups.items() if rows}
    most = max(known, key=lambda first: len(known[first]))
    t_ns = np.array([row[0] for row in known[most]], dtype=np.int64)
    pulses = np.full((len(t_ns), max(first + len(rows[0]) - 2 for first, rows in known.items())), np.nan)
    for first, rows in known.items():
        table = np.array([row[1:] for row in rows], dtype=float)
        if first != most:
            own_ns = np.array([row[0] for row in rows], dtype=np.int64)
            order = np.argsort(own_ns, kind="stable")
            table = table[order][nearest(own_ns[order], t_ns)]
            table[distance(own_ns[order], t_ns) > TOGETHER_NS] = np.nan
        pulses[:, first - 1 : first - 1 + table.shape[1]] = table
    return t_ns, pulses
