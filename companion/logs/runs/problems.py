"""Problems in a run's data that a fit should know of. They are reported, not repaired.

Thresholds are assumed unless they name a source; each is far from what good logs show (docs/run-format.md).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

import numpy as np

from companion.core.constants import NEUTRAL_US
from companion.logs.runs.columns import INERTIAL
from companion.logs.runs.disagreements import disagreeing
from companion.logs.runs.resets import jumps, resets
from companion.logs.runs.run import LogProblem, Run

GAP_PERIODS, GAP_S, END_S = 3.5, 0.2, 1.0
IDLE_US, IDLE_S = 25.0, 5.0
"""Dead band of the ESCs (T200 table: 24 us), and how long all thrusters rest in it."""
SATURATED_US, SATURATED_S = 1.0, 0.3
PWM_LIMITS_US = (1100.0, 1900.0)
STUCK = ((20, 1.0), (8, 5.0))
"""Number of equal samples, and time [s] they last; a heading in steps of 0.01 deg rests for ten at 10 Hz (observed)."""
EVEN = 0.95
"""Least share of the readings of one column that are held for the median number of rows, or one more or less; assumed.
Where a reading repeats the one before by chance, it is 0.87 at most (with a median of 2 rows or more)."""
VOLTAGE_GAP_S = 10.0
SLOW_UWB_HZ = 0.9
"""The paper's UWB gives 1 Hz; slower says little about surge and sway."""
LOST_SHARE = 0.1
SLOWEST_S, FASTEST_M_S, FAST_SHARE = 5.0, 20.0, 0.2
"""Headings that come more slowly than that, and positions that are faster for such a share of the time, are in other
units: yaw has a time constant of 2 s, and a boat at 0.02 m/s makes the latter in millimetres; assumed."""
BIASING = ("damaged", "edited", "disagree", "not obeyed", "clock jump", "heading jump", "position jump", "tilt")
"""Kinds of problems that can bias a fit unnoticed."""
TIMES = ((1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds"))
"""How many of a unit are a second: headings come every 5 ms to `SLOWEST_S`, whatever counts them."""
LEAST_DEG, MOST_DEG, PUSHED_S = 1e-5, 5e-3, 10.0
"""Positions whose whole span is between these, taken as metres 10 um to 5 mm, though thrusters push for so long: a fix
alone is off by more than that, and as degrees it is 1 m to half a kilometre; assumed."""
NOISY = ("r_rad_s", "ax_m_s2", "ay_m_s2", "psi_rad", "north_m")
"""Sampled channels that a fit needs, and whose noise changes their last digit with every sample."""
SPEED_S = 2.0
"""Over so long a speed is looked at."""


def problems(run: Run) -> list[LogProblem]:
    """The reader's notes first, then problems seen in the data, by time within each kind."""
    found = list(run.meta.notes)
    for look in (_missing, _gaps, _positions, resets, _saturated, _idle, _stuck, disagreeing):
        found += look(run)
    return found


def grouped(found: Iterable[LogProblem]) -> dict[str, list[LogProblem]]:
    """Problems by kind, in the order of their first appearance."""
    kinds: dict[str, list[LogProblem]] = {}
    for problem in found:
        kinds.setdefault(problem.kind, []).append(problem)
    return kinds


def problem_sentences(found: Mapping[str, Sequence[LogProblem]], kinds: Collection[str] = BIASING) -> list[str]:
    """A sentence for each log and each of `kinds` of its problems. `found`: by name of the log."""
    lines = []
    for log, ones in found.items():
        for kind in kinds:
            if mine := [p for p in ones if p.kind == kind]:
                more = f" (and {len(mine) - 1} more)" if len(mine) > 1 else ""
                lines.append(f"{log}: {kind}: {mine[0].text.removeprefix(f'{log}: ')}{more}.")
    return lines


def _stretches(marked: np.ndarray, t_s: np.ndarray, least_s: float) -> Iterator[tuple[float, float, int]]:
    """Begin, length [s] and first index of each run of marked rows; a row lasts until the next one."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], marked.astype(np.int8), [0]))))
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        length_s = float(t_s[min(last, len(t_s) - 1)] - t_s[first])
        if length_s >= least_s:
            yield float(t_s[first]), length_s, int(first)


def _missing(run: Run) -> Iterator[LogProblem]:
    """Columns without values, thrusters without commands, a battery voltage that may be stale."""
    for column, what in (
        ("battery_v", "no battery voltage: thrust at a pulse width is then known at one voltage only"),
        ("psi_rad", "no heading"),
        ("r_rad_s", "no yaw rate"),
        ("ax_m_s2", "no accelerations"),
        ("north_m", "no positions: surge and sway rest on accelerations alone"),
    ):
        if not run.known(column):
            yield LogProblem(kind="missing", text=f"{column}: {what}")
    t_s = run.table["t_s"].to_numpy()
    for column in (f"pwm_{name}" for name in run.thrusters):
        blank = run.table[column].is_null().to_numpy()
        if blank.all():
            yield LogProblem(kind="missing", text=f"{column}: no commands")
        else:
            for at_s, length_s, _ in _stretches(blank, t_s, 1.0):
                yield LogProblem(kind="missing", text=f"{column}: commands not known", t_s=at_s, length_s=length_s)
    if run.known("battery_v"):
        changes = np.append(True, np.diff(run.table["battery_v"].fill_null(-1.0).to_numpy()) != 0)
        for a, b in zip(t_s[changes], np.append(t_s[changes][1:], t_s[-1]), strict=True):
            if b - a > VOLTAGE_GAP_S:
                text = "battery_v: blank, or the same for so long that it may be stale"
                yield LogProblem(kind="voltage", text=text, t_s=float(a), length_s=float(b - a))


def _gaps(run: Run) -> Iterator[LogProblem]:
    """Gaps of a channel; a gap of all channels is reported once, for the whole log."""
    t_s = run.table["t_s"].to_numpy()
    whole = _holes(t_s, t_s)
    for at_s, length_s in whole:
        text = "nothing at all: the recording paused, or the clock jumped"
        yield LogProblem(kind="gap", text=text, t_s=at_s, length_s=length_s)
    for column in NOISY:
        if run.known(column):
            for at_s, length_s in _holes(run.samples(column)[0], t_s):
                if not any(a <= at_s + length_s and at_s <= a + n for a, n in whole):
                    yield LogProblem(kind="gap", text=f"{column}: silent", t_s=at_s, length_s=length_s)


def _holes(t_s: np.ndarray, run_t_s: np.ndarray) -> list[tuple[float, float]]:
    """Begin and length [s] of gaps in the stamps `t_s`, those at both ends of the run included."""
    if len(t_s) < 3:
        return []
    steps = np.diff(t_s)
    limit_s = max(GAP_PERIODS * float(np.median(steps)), GAP_S)
    ends = [(run_t_s[0], t_s[0] - run_t_s[0]), (t_s[-1], run_t_s[-1] - t_s[-1])]
    inner = zip(t_s[:-1][steps > limit_s], steps[steps > limit_s], strict=True)
    return sorted((float(a), float(n)) for a, n in (*inner, *(e for e in ends if e[1] > max(limit_s, END_S))))


def _positions(run: Run) -> Iterator[LogProblem]:
    """Few or slow positions, lost ones, and jumps."""
    if not run.known("north_m"):
        return
    t_s = run.samples("north_m", "east_m")[0]
    if len(t_s) < 3:
        yield LogProblem(kind="positions", text=f"only {len(t_s)} positions")
        return
    nominal, mean = 1.0 / float(np.median(np.diff(t_s))), (len(t_s) - 1) / float(t_s[-1] - t_s[0])
    if nominal < SLOW_UWB_HZ:
        yield LogProblem(kind="positions", text=f"positions at {nominal:.2f} Hz only")
    if mean < (1 - LOST_SHARE) * nominal:
        share = 100 * (1 - mean / nominal)
        yield LogProblem(kind="positions", text=f"{share:.0f} % of the positions at {nominal:.1f} Hz did not come")
    yield from jumps(run)


def _saturated(run: Run) -> Iterator[LogProblem]:
    """Intervals with a thruster at its limit."""
    t_s = run.table["t_s"].to_numpy()
    for name in run.thrusters:
        low, high = run.meta.pwm_limits_us.get(name, PWM_LIMITS_US)
        pwm_us = run.table[f"pwm_{name}"].to_numpy()
        with np.errstate(invalid="ignore"):
            full = (pwm_us <= low + SATURATED_US) | (pwm_us >= high - SATURATED_US)
        for at_s, length_s, first in _stretches(full, t_s, SATURATED_S):
            text = f"pwm_{name}: at its limit, {pwm_us[first]:.0f} us"
            yield LogProblem(kind="saturated", text=text, t_s=at_s, length_s=length_s)


def _idle(run: Run) -> Iterator[LogProblem]:
    """Intervals with all thrusters at rest, and thrusters whose command never changes."""
    t_s = run.table["t_s"].to_numpy()
    pwm_us = run.table.select(f"pwm_{name}" for name in run.thrusters).to_numpy()
    with np.errstate(invalid="ignore"):
        rest = np.all(np.abs(pwm_us - NEUTRAL_US) <= IDLE_US, axis=1)
    for at_s, length_s, _ in _stretches(rest, t_s, IDLE_S):
        yield LogProblem(kind="idle", text="all thrusters rest", t_s=at_s, length_s=length_s)
    for i, name in enumerate(run.thrusters):
        known = pwm_us[~np.isnan(pwm_us[:, i]), i]
        if len(known) and (known == known[0]).all():
            text = f"pwm_{name}: never changes ({known[0]:.0f} us): nothing can be said of this thruster"
            yield LogProblem(kind="constant", text=text)


def _stuck(run: Run) -> Iterator[LogProblem]:
    """Samples that repeat one value exactly."""
    for column in (*NOISY, *(name for name in run.table.columns if name.startswith("range_"))):
        if not run.known(column):
            continue
        t_s, values = run.samples(column)
        same = np.append(np.diff(values) == 0, False)
        edges = np.flatnonzero(np.diff(np.concatenate(([0], same.astype(np.int8), [0]))))
        for first, last in zip(edges[::2], edges[1::2], strict=True):
            length_s = float(t_s[last] - t_s[first])
            if any(last - first + 1 >= count and length_s >= least_s for count, least_s in STUCK):
                text = f"{column}: {last - first + 1} samples are {values[first]:.6g} exactly"
                yield LogProblem(kind="stuck", text=text, t_s=float(t_s[first]), length_s=length_s)


def dead_columns(run: Run) -> list[str]:
    """Columns of heading, inertial sensors and positions that hold one value throughout: no sensor wrote them.

    A position is dead where both its coordinates are: a boat may drive due north.
    """

    def dead(*columns: str) -> bool:
        if not all(run.known(column) for column in columns):
            return False
        values = run.samples(*columns)[1]
        return len(values) >= STUCK[1][0] and bool((values == values[0]).all())

    place = ("north_m", "east_m")
    return [*(column for column in INERTIAL if dead(column)), *(place if dead(*place) else ())]


def unit_fault(run: Run) -> str:
    """What shows that stamps are no seconds, or positions no metres, in words; empty where nothing does."""
    steps_s = np.diff(run.samples("psi_rad")[0])
    if len(steps_s) and (usual_s := float(np.median(steps_s))) > SLOWEST_S:
        unit = next((name for most_s, name in TIMES if usual_s <= most_s * SLOWEST_S), TIMES[-1][1])
        return f"t_s: a heading comes every {usual_s:.3g} s only: is the time in {unit}? Write seconds"
    t_s, places = run.samples("north_m", "east_m")
    if len(places) and (fault := _degrees(run, places)):
        return fault
    later = np.searchsorted(t_s, t_s + SPEED_S)
    first, later = np.flatnonzero(later < len(t_s)), later[later < len(t_s)]
    if not len(first):
        return ""
    speeds_m_s = np.linalg.norm(places[later] - places[first], axis=1) / (t_s[later] - t_s[first])
    if (fast_m_s := float(np.quantile(speeds_m_s, 1 - FAST_SHARE))) <= FASTEST_M_S:
        return ""
    return f"north_m, east_m: they move at {fast_m_s:.0f} m/s: are they in millimetres? Write metres"


def _degrees(run: Run, places: np.ndarray) -> str:
    """What shows that positions (n, 2) are latitudes and longitudes, in either order; empty where nothing does."""
    span = float(np.ptp(places, axis=0).max())
    lies_on_earth = bool((np.abs(places) <= 180.0).all() and (np.abs(places) <= 90.0).all(axis=0).any())
    if not (lies_on_earth and LEAST_DEG < span < MOST_DEG):
        return ""
    t_s, pwm_us = run.samples(*(f"pwm_{name}" for name in run.thrusters))
    if not len(t_s):
        return ""
    pushes = np.abs(pwm_us.reshape(len(t_s), -1) - NEUTRAL_US).max(axis=1) > IDLE_US
    if float(np.diff(t_s)[pushes[:-1]].sum()) < PUSHED_S:
        return ""
    return (
        f"north_m, east_m: all within {1000 * span:.2g} mm of one another while the boat drives: are they latitude and "
        "longitude in degrees? Write metres north and east of an origin"
    )


def held_rows(run: Run, *columns: str) -> np.ndarray:
    """Rows (rows,) whose reading in `columns` is only that of the row before, written again; none where that is no
    habit of a log. `columns`: both of a position, or one of another sensor.

    A reading that is held until the next one comes stands in most rows, and a boat that rests repeats its position,
    too: what tells them apart is that of readings which differ, more than half are repeated. One is held for the median
    of these lengths; where the boat rests for longer, one for each such length counts. Of a single column with few
    digits the lengths are those of chance: there nearly all have to be alike.
    """
    values = run.table.select(columns).to_numpy()
    known = np.flatnonzero(~np.isnan(values).any(axis=1))
    again = np.zeros(len(values), dtype=bool)
    if len(known) < 2:
        return again
    same = (np.diff(values[known], axis=0) == 0).all(axis=1)
    first = np.flatnonzero(np.append(True, ~same))
    lengths = np.diff(np.append(first, len(known)))
    held = round(float(np.median(lengths)))
    is_habit = len(columns) > 1 or (len(lengths) >= STUCK[1][0] and np.mean(np.abs(lengths - held) <= 1) >= EVEN)
    if held >= 2 and is_habit:
        since = np.arange(len(known)) - np.repeat(first, lengths)
        readings = np.repeat(np.maximum(np.rint(lengths / held), 1), lengths)
        again[known] = (since % held != 0) | (since // held >= readings)
    return again
