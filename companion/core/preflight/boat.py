"""Rows of the rest of the boat: estimate, UWB, battery, disk, configuration. Pure.

Thresholds without a source are assumed.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from companion.core.configuration.run_file import BatteryLimits
from companion.core.configuration.site_file import Site
from companion.core.configuration.vessel_file import VesselFile
from companion.core.constants import pack_range
from companion.core.estimation.health import SETTLES
from companion.core.estimation.ranging.multilateration import multilaterate
from companion.core.geometry.anchors import hdop
from companion.core.geometry.fence import ANYWHERE, Fence
from companion.core.messages import Innovation, StateEstimate
from companion.core.preflight.observations import Observations
from companion.core.preflight.rows import Level, Row
from companion.core.sensors.table import sensors_of
from companion.core.sensors.uwb import RangingSensor

START_ANCHORS = 3
"""The filter starts with three."""
ENOUGH = 0.65
"""Share of the tag's rate that is good enough."""
GOOD_HDOP, POOR_HDOP = 2.0, 5.0
SPREAD_M = 0.6
"""A range's residual beyond which it plays no part in a fix (as in the filter's tuning)."""
ACCEPTED, SURPRISE = 0.9, 4.0
"""Share of measurements that a filter in order accepts, and their mean squared Mahalanobis distance a dimension."""
LOW_SHARE, EMPTY_SHARE = 0.93, 0.85
"""Shares of the nominal voltage. 4S lithium polymer, 14.8 V nominal: about 3.45 and 3.15 V a cell."""
NO_ROOM_BYTES, LITTLE_ROOM_BYTES = 50e6, 1e9
"""A log takes some 0.26 GB an hour (measured, docs/logs.md)."""


def estimator_rows(observed: Observations, fence: Fence = ANYWHERE) -> Iterator[Row]:
    """Did the boat's own filter start, does it lie where it may drive, and do its sensors agree with it?"""
    e = observed.estimate
    health = e.health if e else "initialising"
    levels: dict[str, Level] = {"healthy": "ok", "degraded": "warning"}
    found = "nothing to estimate from"
    settles = e is not None and e.reason == SETTLES  # as after every start: it takes longer than this look
    if e and health in ("healthy", "degraded"):
        word = "it has started, speed settles" if settles else health
        found = f"{word}: north {e.north_m:.2f} m, east {e.east_m:.2f} m, heading {math.degrees(e.psi_rad):.0f} deg"
    elif e:
        found = f"{health}: {e.reason}"
    level = "ok" if settles else levels.get(health, "refuse")
    yield Row(
        area="estimator", name="state", level=level, found=found, needed=f"healthy after {observed.listened_s:.0f} s",
        why="without it the boat does not know where it is",
        fix="" if level == "ok" else "see the rows on sensors and streams; listen longer (--listen-s 30)",
    )  # fmt: skip
    if e and health in ("healthy", "degraded"):
        yield from _place(e, fence)
    groups: dict[str, list[Innovation]] = {}
    for i in observed.innovations:
        groups.setdefault(i.sensor.partition(" ")[0], []).append(i)
    for name, group in groups.items():
        accepted = sum(i.accepted for i in group) / len(group)
        surprise = statistics.fmean(i.d2 / len(i.innovation) for i in group)
        fine = accepted >= ACCEPTED and surprise <= SURPRISE
        yield Row(
            area="estimator", name=f"innovations: {name}", level="ok" if fine else "warning",
            found=f"{100 * accepted:.0f} % accepted, d2 {surprise:.1f} a dimension",
            needed=f"{100 * ACCEPTED:.0f} %, at most {SURPRISE:g}",
            why="what the sensor says fits what the filter expects",
            fix="" if fine else "noise, lever arms, offsets of the vessel file; anchors of the site file",
        )  # fmt: skip


def _place(e: StateEstimate, fence: Fence) -> Iterator[Row]:
    """Where the boat lies, if it may not drive there."""
    beyond_m = -fence.clearance(e.north_m, e.east_m)
    if beyond_m > 0:
        yield Row(
            area="estimator", name="place", level="warning",
            found=f"north {e.north_m:.1f} m, east {e.east_m:.1f} m, {beyond_m:.1f} m beyond the fence",
            needed="within the fences of site and mission",
            why="beyond them a run cannot be started, but by hand (docs/modes.md)",
            fix="put it into its water; or correct origin, rotation, anchors or fence of the site file",
        )  # fmt: skip


# --- sensors of position and speed ------------------------------------------------------------------


def sensor_rows(observed: Observations, site: Site, vessel: VesselFile) -> Iterator[Row]:
    """UWB, and what the other sensors' own objects have to say."""
    for sensor in sensors_of(vessel.sensors, site):
        if vessel.sensors.uwb and sensor.key == RangingSensor.key:
            yield from uwb_rows(observed, site, vessel)
        heard, rate_Hz = observed.heard.get(sensor.key, ()), observed.sensor_hz.get(sensor.key, 0.0)
        for check in sensor.checks(heard, rate_Hz):
            yield Row(area=sensor.key, **check._asdict())


# --- UWB -------------------------------------------------------------------------------------------


def uwb_rows(observed: Observations, site: Site, vessel: VesselFile) -> Iterator[Row]:
    """Anchors in range, their geometry as seen from the boat, and the residuals of their ranges."""
    if not observed.ranges and not observed.positions:
        yield Row(
            area="uwb", name="tag", level="refuse", found=observed.uwb.reason if observed.uwb else "nothing was opened",
            needed="ranges or positions", why="there is no other position",
            fix="uwb.url of the run file, or --uwb; sensors.uwb.wire_format; a DWM1001 needs up to 20 s: --listen-s 30",
        )  # fmt: skip
        return
    if not observed.ranges:
        yield _positions(observed, site)
        yield _cycles(observed, vessel.sensors.tag.rate_Hz)
        return
    medians = _medians(observed)
    yield _anchors(observed, site, medians)
    yield _cycles(observed, vessel.sensors.tag.rate_Hz)
    known = [a for a in site.anchors if a.id in medians]
    if len(known) >= START_ANCHORS:
        anchors_m = np.array([(a.north_m, a.east_m, a.down_m) for a in known])
        ranges_m = np.array([medians[a.id] for a in known])
        yield from _geometry(anchors_m, ranges_m, [a.id for a in known], vessel)


def _medians(observed: Observations) -> dict[str, float]:
    ranges_m: dict[str, list[float]] = {}
    for cycle in observed.ranges:
        for r in cycle.ranges:
            ranges_m.setdefault(r.anchor, []).append(r.range_m)
    return {anchor: statistics.median(values) for anchor, values in ranges_m.items()}


def _anchors(observed: Observations, site: Site, medians: Mapping[str, float]) -> Row:
    mine = [a.id for a in site.anchors]
    silent, strangers = [a for a in mine if a not in medians], sorted(set(medians) - set(mine))
    known = len(mine) - len(silent)
    level: Level = "refuse" if known < START_ANCHORS else "warning" if silent or strangers else "ok"
    found = f"{known} of {len(mine)}" + (f", not {', '.join(silent)}" if silent else "")
    found += f"; unknown: {', '.join(strangers)}" if strangers else ""
    return Row(
        area="uwb", name="anchors", level=level, found=found, needed="all of the site file, at least 3",
        why="three are needed to start; ranges to unknown ones are not used",
        fix="" if level == "ok" else "power, line of sight, ids in the site file as the tag prints them",
    )  # fmt: skip


def _cycles(observed: Observations, rate_hz: float) -> Row:
    """How often the tag speaks, of the `rate_hz` [Hz] of the vessel file; with its ranges, where it tells them."""
    level: Level = "ok" if observed.uwb_hz >= ENOUGH * rate_hz else "warning"
    seen = [len(cycle.ranges) for cycle in observed.ranges]
    each = f", {statistics.fmean(seen):.1f} ranges each" if seen else ""
    return Row(
        area="uwb", name="cycles", level=level, found=f"{observed.uwb_hz:.1f} Hz{each}",
        needed=f"{rate_hz:g} Hz", why="how often the position is renewed",
        fix="" if level == "ok" else "the tag's own settings; sensors.uwb.rate_Hz of the vessel file; range and sight",
    )  # fmt: skip


def _geometry(anchors_m: np.ndarray, ranges_m: np.ndarray, ids: list[str], vessel: VesselFile) -> Iterator[Row]:
    uwb = vessel.sensors.tag
    fixes = multilaterate(anchors_m, ranges_m, uwb.z_m, SPREAD_M)
    if not fixes:
        yield Row(
            area="uwb", name="geometry", level="refuse", found="no place explains the ranges", needed="one",
            why="the anchors of the site file lie on one another", fix="correct the site file",
        )  # fmt: skip
        return
    best = fixes[0]
    dop = hdop(anchors_m, best.north_m, best.east_m, uwb.z_m)
    level: Level = "ok" if dop <= GOOD_HDOP else "warning" if dop <= POOR_HDOP else "refuse"
    yield Row(
        area="uwb", name="geometry", level=level,
        found=f"HDOP {dop:.2f} at north {best.north_m:.2f} m, east {best.east_m:.2f} m",
        needed=f"at most {GOOD_HDOP:g}",
        why="by so much a range's error grows in the position",
        fix="" if level == "ok" else "spread the anchors around the water",
    )  # fmt: skip
    away = np.linalg.norm(np.array([best.north_m, best.east_m, uwb.z_m]) - anchors_m, axis=1)
    residuals = {anchor: float(r) for anchor, r in zip(ids, ranges_m - away, strict=True)}
    limit_m = 3.0 * math.hypot(uwb.range_sigma_m, uwb.range_bias_sigma_m)
    bad = [anchor for anchor, r in residuals.items() if abs(r) > limit_m]
    yield Row(
        area="uwb", name="residuals", level="warning" if bad else "ok",
        found=", ".join(f"{anchor} {100 * r:+.0f} cm" for anchor, r in residuals.items()),
        needed=f"within {100 * limit_m:.0f} cm (3 sigma of the vessel file)",
        why="ranges and the site file's anchors agree on one place",
        fix=f"measure again where {', '.join(bad)} stands; look for what blocks its sight" if bad else "",
    )  # fmt: skip


def _positions(observed: Observations, site: Site) -> Row:
    """A tag that computes positions itself (site ENU)."""
    norths, easts = [m.y_m for m in observed.positions], [m.x_m for m in observed.positions]
    north, east = statistics.median(norths), statistics.median(easts)
    spread = math.hypot(statistics.pstdev(norths), statistics.pstdev(easts))
    inside = site.inside(north, east)
    return Row(
        area="uwb", name="positions", level="ok" if inside else "warning",
        found=f"north {north:.2f} m, east {east:.2f} m, scatter {100 * spread:.0f} cm", needed="inside the fence",
        why="the tag computes its place in the frame that its anchors were set up in (site: x east, y north)",
        fix="" if inside else "set up the tag's anchors in the site's frame",
    )  # fmt: skip


# --- battery, disk, configuration ------------------------------------------------------------------


def battery_rows(observed: Observations, nominal_v: float, limits: BatteryLimits) -> Iterator[Row]:
    """Voltage at rest, and whether what the run file's limits are held against is told at all."""
    b = observed.battery
    empty_v, low_v = limits.critical_V or EMPTY_SHARE * nominal_v, limits.low_V or LOW_SHARE * nominal_v
    needed = f"{low_v:.1f} V or more"
    least_v, most_v = pack_range(nominal_v)
    if b is None or not least_v <= b.voltage_v <= most_v:
        counts = limits.low_V is not None or limits.critical_V is not None
        why = "low_V and critical_V of the run file count for nothing" if counts else "thrust depends on it"
        yield Row(
            area="battery", name="voltage", level="refuse" if counts else "warning",
            found=f"{b.voltage_v:.1f} V" if b else "not told", needed=f"{needed}, at most {most_v:.1f} V",
            why=f"{why}, and nobody would see the pack run empty",
            fix="set BATT_MONITOR and its pins; until then " + ("take them out, and " if counts else "")
            + "measure by hand",
        )  # fmt: skip
        return
    level: Level = "refuse" if b.voltage_v < empty_v else "warning" if b.voltage_v < low_v else "ok"
    left = "" if b.remaining_percent is None else f", {b.remaining_percent} % left"
    yield Row(
        area="battery", name="voltage", level=level, found=f"{b.voltage_v:.2f} V{left}", needed=needed,
        why=f"at rest; below {empty_v:.1f} V it counts as empty", fix="" if level == "ok" else "charge it",
    )  # fmt: skip
    if b.remaining_percent is None and (limits.low_percent is not None or limits.critical_percent is not None):
        yield Row(
            area="battery", name="charge", level="refuse", found="not told", needed="per cent that remain",
            why="low_percent and critical_percent of the run file count for nothing",
            fix="a current sensor, BATT_CAPACITY; or take these limits out",
        )  # fmt: skip


def disk_rows(observed: Observations) -> Iterator[Row]:
    """Can a log be written, and for how long?"""
    d = observed.disk
    if d.problem:
        yield Row(
            area="disk", name="log folder", level="refuse", found=f"{d.folder}: {d.problem}",
            needed="a folder to write to",
            why="a wrong path ends a run, and where the disk is full or broken it leaves no log",
            fix="log.folder of the run file; its owner and rights",
        )  # fmt: skip
        return
    short = d.quota_bytes is not None and d.quota_bytes - d.used_bytes > d.free_bytes
    level: Level = "refuse" if d.free_bytes < NO_ROOM_BYTES else "warning" if d.free_bytes < LITTLE_ROOM_BYTES else "ok"
    found = f"{d.folder}: {d.free_bytes / 1e9:.1f} GB free"
    if d.quota_bytes is not None:
        found += f", logs take {d.used_bytes / 1e9:.1f} of {d.quota_bytes / 1e9:.1f} GB"
    yield Row(
        area="disk", name="log folder", level="warning" if short and level == "ok" else level, found=found,
        needed="1 GB free" + (", and room for log.quota_MB" if d.quota_bytes is not None else ""),
        why="a log takes some 0.26 GB an hour; on a full disk nothing is recorded, though the boat drives",
        fix="" if level == "ok" and not short else "delete or move old logs; a smaller log.quota_MB",
    )  # fmt: skip


def configuration_rows(notes: Iterable[str], what: str) -> Iterator[Row]:
    """The configuration that was read, `what`, and what it warns of."""
    yield Row(
        area="configuration", name="files", level="ok", found=what, needed="readable, and fitting together",
        why="run, vessel, site and mission file were read and checked",
    )  # fmt: skip
    for note in notes:
        yield Row(
            area="configuration", name="warning", level="warning", found=note, needed="none",
            why="a person should know",
            fix="correct it if it is not meant so",
        )  # fmt: skip
