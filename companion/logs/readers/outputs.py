"""Servo outputs of an ArduPilot log as commands of the vessel file's thrusters: which output drives which.

The autopilot's parameters say it where the log has them. SERVOn_FUNCTION, the first that has every thruster:

    50 + k          passes RC channel k on (RCINk): the thruster whose `channel` is k; 140 on, 1 and scripts: `carriers`
    73, 74          Rover's left and right throttle: all thrusters to port, all to starboard; 70, throttle: the only one
    33 to 40, 82 on Motor1 and so on: the vessel file's thrusters in their order, if they are as many

Functions that have no place for a thruster contradict every guess: the log is refused. Where no function was logged,
outputs 1..n drive the thrusters in the vessel file's order.
Source: https://ardupilot.org/rover/docs/common-rcoutput-mapping.html
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from math import isfinite
from pathlib import Path

import numpy as np

from companion.core.configuration.vessel_file import VesselFile
from companion.core.constants import NEUTRAL_US
from companion.core.preflight.rows import ParameterSet
from companion.core.preflight.wiring import Companion, wiring
from companion.logs.readers.join import Stream
from companion.logs.runs.columns import LIMITS
from companion.logs.runs.nearest import distance, nearest
from companion.logs.runs.outliers import FEW
from companion.logs.runs.run import LogProblem, RunError

TOGETHER_NS = 50_000_000
"""Half a step of records at 10 Hz, in which ArduPilot logs its outputs at the least; assumed."""
GUESSED = "outputs by order"
"""Kind of a note: the log does not say which thruster an output drives, an order was taken."""
_FUNCTION = re.compile(r"SERVO(\d+)_FUNCTION")
_PASSED_ON = 50  # function of RC channel 0, of which there is none; to channel 16
_THROTTLE, _SIDES = 70, (73, 74)
_MOTORS = (*range(33, 41), *range(82, 86))
_BY_FUNCTION, _BY_ORDER = "by SERVOn_FUNCTION", "in the order of the vessel file"


def outputs_of(
    vessel: VesselFile, parameters: Mapping[str, float], pulses: np.ndarray, notes: list[LogProblem]
) -> tuple[dict[str, int], str]:
    """Output (from 1) by name of thruster, and how it is known, as text; what was taken for granted goes to `notes`.

    `pulses` (n, outputs) [us]. Raises RunError where functions of the outputs are known and give no thruster an output.
    """
    functions = {
        int(m[1]): round(value)
        for name, value in parameters.items()
        if (m := _FUNCTION.fullmatch(name)) and isfinite(value)
    }
    names = [t.name for t in vessel.thrusters]
    for found in (_passed(vessel, functions, parameters), _throttles(vessel, functions, pulses)) if functions else ():
        if len(found) == len(names):
            return {name: found[name] for name in names}, _BY_FUNCTION
    motors = [_outputs(functions, motor)[0] for motor in _MOTORS if _outputs(functions, motor)]
    if len(motors) == len(names):
        pairs = ", ".join(f"output {n} (function {functions[n]}) {name}" for name, n in zip(names, motors, strict=True))
        text = f"the outputs are motors by SERVOn_FUNCTION: taken for the thrusters in the vessel file's order: {pairs}"
        notes.append(LogProblem(kind=GUESSED, text=text))
        return dict(zip(names, motors, strict=True)), f"{_BY_FUNCTION}, motors {_BY_ORDER}"
    in_order = dict(zip(names, range(1, len(names) + 1), strict=True))
    carrying = [n for n in range(1, pulses.shape[1] + 1) if (pulses[:, n - 1] > 0).any()]
    if not functions.keys() & {*carrying, *in_order.values()}:
        return in_order, _BY_ORDER
    seen = ", ".join(f"output {n} (function {functions.get(n, 'not logged')})" for n in carrying) or "no output"
    raise RunError(
        f"SERVOn_FUNCTION does not say which outputs drive {', '.join(names)}; pulses are on {seen}. Give each "
        "thruster of the vessel file the `channel` that its output passes (function 50 + channel; as good are motors, "
        "33 on, as many as thrusters, and left and right throttle, 73 and 74, with equal pulses on all outputs of a "
        "side), or run `aritra log export LOG --out run.csv` without --vessel and give the columns pwm_outN its "
        "thrusters' names"
    )


def _outputs(functions: Mapping[int, int], function: int) -> list[int]:
    """Numbers of the outputs with that function, ascending."""
    return sorted(n for n, its in functions.items() if its == function)


def _passed(vessel: VesselFile, functions: Mapping[int, int], parameters: Mapping[str, float]) -> dict[str, int]:
    """Output by thruster, of those whose RC channel an output passes: as it is, else scaled or by a script."""
    found = {t.name: ns[0] for t in vessel.thrusters if (ns := _outputs(functions, _PASSED_ON + t.channel))}
    if len(found) == len(vessel.thrusters):
        return found
    known = {name: value for name, value in parameters.items() if isfinite(value)}
    carried = carriers([t.channel for t in vessel.thrusters], known)
    return {vessel.thrusters[place].name: n for place, n in carried.items()}


def _throttles(vessel: VesselFile, functions: Mapping[int, int], pulses: np.ndarray) -> dict[str, int]:
    """Output by thruster, of those that follow a throttle: the only one, or all to port and all to starboard.

    A side is left out where the outputs of its throttle say different things, for then one of them is no copy.
    """
    by_side = sorted(vessel.thrusters, key=lambda t: t.y_m)
    if len(by_side) == 1:
        numbers = _outputs(functions, _THROTTLE)
        return {by_side[0].name: numbers[0]} if numbers else {}
    port = [t for t in by_side if t.y_m < 0] if len(by_side) > 2 else by_side[:1]
    starboard = [t for t in by_side if t.y_m > 0] if len(by_side) > 2 else by_side[1:]
    found: dict[str, int] = {}
    for thrusters, function in zip((port, starboard), _SIDES, strict=True):
        numbers = _outputs(functions, function)
        carrying = [n for n in numbers if n <= pulses.shape[1] and (pulses[:, n - 1] > 0).any()]
        if all(np.array_equal(pulses[:, carrying[0] - 1], pulses[:, n - 1], equal_nan=True) for n in carrying):
            found |= {t.name: n for t in thrusters for n in (carrying or numbers)[:1]}
    return found


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
    path: Path,
) -> tuple[Stream, str]:
    """Pulses as commands, and a text: which output drives which thruster. `groups`: number of a group's first output ->
    rows (t_ns, pulse width of each of its outputs [us]), as records hold them; one group at least has rows.

    Without a vessel file: out1.. of those that ever had a pulse, and pulses that a thruster can have. No pulse (0)
    becomes neutral, because the speed controller then stops its motor; a note is added to `notes`. An output that was
    not logged is unknown (NaN). Raises RunError naming the file `path`: `outputs_of`.
    """
    t_ns, pulses = _together(groups)
    if vessel:
        try:
            picked, how = outputs_of(vessel, parameters, pulses, notes)
        except RunError as error:
            raise RunError(f"{path}: {error}") from None
        text = ", ".join(f"{name} output {n}" for name, n in picked.items()) + f" ({how})"
    else:
        picked = {f"out{n}": n for n in _thrusting(pulses, notes)}
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


def _thrusting(pulses: np.ndarray, notes: list[LogProblem]) -> list[int]:
    """Numbers of the outputs with pulses (n, outputs) [us] of a thruster; a relay or a lamp is left out, and noted."""
    low_us, high_us, _ = next(limits for pattern, limits in LIMITS if pattern.fullmatch("pwm_out1"))
    found = []
    for n, pwm_us in enumerate(pulses.T, 1):
        given = pwm_us[pwm_us > 0]
        odd = given[(given < low_us) | (given > high_us)]
        if len(odd) > FEW * len(given):
            text = (
                f"output {n}: {len(odd)} of {len(given)} pulses are none of a thruster, {odd[0]:g} us (expected "
                f"{low_us:g} to {high_us:g}): left out"
            )
            notes.append(LogProblem(kind="left out", text=text))
        elif len(given):
            found.append(n)
    return found


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
