"""From the run file to everything a run needs: read, checked, named by its hash. Errors name file and key."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from msgspec.structs import replace

import deploy
from companion.core.configuration.run_file import BatteryLimits, RunFile, load_run
from companion.core.configuration.site_file import Site, load_site
from companion.core.configuration.tables import TEXT, ConfigError, digest
from companion.core.configuration.vessel_file import RotorMap, Thruster, VesselFile
from companion.core.constants import NEUTRAL_US, pack_range
from companion.core.control.nmpc.settings import nmpc_for
from companion.core.excitation.file import load_excitation
from companion.core.geometry.anchors import hdop, in_a_line
from companion.core.geometry.frames import Origin
from companion.core.guidance.missions.fitness import unfit_waypoints
from companion.core.guidance.missions.mission import Mission, MissionErrors, kind_of, parse
from companion.core.guidance.steerage import guidance_for
from companion.core.model.actuators.propulsion import is_steered, only_fixed
from companion.core.model.load_vessel import load_vessel
from companion.core.model.thrusters import force_from_pwm
from companion.core.pilot.pilot import PilotSettings
from companion.core.preflight.boat import GOOD_HDOP, START_ANCHORS
from companion.core.preflight.wiring import BAND_US
from drivers.devices import DEVICES, devices_of

EXAMPLES = Path(deploy.__file__).parent
"""The boats, sites, missions and the run file that come with the package."""
FILES = ("vessel", "site", "mission", "excitation")
"""Keys of a run file that name other files."""
WITHOUT_UWB = "--config deploy/lake.toml, a run file for GNSS"
"""What helps somebody who has not written the run file that a boat with GNSS does not fit."""

MOST_REACH = 2.0
"""Force limits over what a thruster reaches at the nominal voltage, beyond which they are taken for a slip; assumed."""
UNFIT_CHANNELS = {
    1: "can arm the autopilot (rudder arming)",
    3: "is the autopilot's radio failsafe",
    8: "is the autopilot's mode channel",
}
"""RC channels that mean something to ArduPilot Rover by default."""


@dataclass(frozen=True)
class RunSetup:
    """One run. `files`: the texts it was made from: run.toml, vessel.toml, site.toml, mission.*, excitation.toml."""

    run: RunFile
    pilot: PilotSettings
    files: Mapping[str, str]

    @property
    def digest(self) -> str:
        """Name of this configuration."""
        return digest("".join(self.files[name] for name in sorted(self.files)))


def load_setup(path: Path, *, mission: Path | None = None, excitation: Path | None = None) -> RunSetup:
    """Read a run file and what it names (relative to itself); `mission`, `excitation` instead. Raises ConfigError."""
    texts, names = read_texts(path, mission=mission, excitation=excitation)
    setup = setup_of(texts, names)
    refuse_unfit(setup, names)
    return setup


def read_texts(
    path: Path, *, mission: Path | None = None, excitation: Path | None = None
) -> tuple[dict[str, str], dict[str, str]]:
    """Texts of a run file and of what it names, by role, and the paths of these files. Raises ConfigError."""
    run = load_run(_read(path), name=str(path))
    paths = {"vessel.toml": path.parent / run.vessel, "site.toml": path.parent / run.site}
    plan = mission or path.parent / run.mission
    paths[f"mission{plan.suffix}"] = plan
    if excitation or run.excitation:
        paths["excitation.toml"] = excitation or path.parent / (run.excitation or "")
    named = {path.parent / file: f"{path}: {key}: " for key in FILES if (file := getattr(run, key)) is not None}
    texts = {"run.toml": _read(path), **{role: _read(p, named.get(p, "")) for role, p in paths.items()}}
    return texts, {"run.toml": str(path), **{role: str(p) for role, p in paths.items()}}


def setup_of(texts: Mapping[str, str], names: Mapping[str, str]) -> RunSetup:
    """Setup from the texts of its files; `names`: what to call each in errors. Raises ConfigError."""
    run = load_run(texts["run.toml"], name=names["run.toml"])
    vessel = load_vessel(texts["vessel.toml"], name=names["vessel.toml"])
    site = load_site(texts["site.toml"], name=names["site.toml"])
    role = _role_of_mission(texts)
    mission = _mission(texts[role], names[role], site)
    for problem in _problems(run, vessel, names):
        raise ConfigError(problem)
    text, name = texts.get("excitation.toml"), names.get("excitation.toml", "")
    pilot = PilotSettings(
        vessel,
        site,
        mission,
        run.control,
        guidance_for(vessel),
        nmpc_for(vessel),
        excitation=None if text is None else load_excitation(text, name=name),
        battery=run.battery,
        system_id=run.mavlink.system_id,
    )
    if text is not None:
        only_fixed(vessel, names["vessel.toml"], "excitations")
    pilot.flight(name)  # says what does not fit
    return RunSetup(run, pilot, texts)


def _problems(run: RunFile, vessel: VesselFile, names: Mapping[str, str]) -> Iterator[str]:
    """What no single file can know to be wrong."""
    of_run, of_vessel, control = names["run.toml"], names["vessel.toml"], run.control
    still = control.neutral_channels
    for one in vessel.controls:
        if one.channel in still:
            what = "thruster" if isinstance(one, Thruster) else "servo"
            both = f"channel {one.channel} drives {what} {one.name} of {of_vessel}"
            yield f"{of_run}: control.neutral_channels: {both}"
    if run.log.quota_MB and run.log.folder is None:
        yield f"{of_run}: log.quota_MB: needs log.folder: nothing is deleted from the current folder"
    nominal_V = vessel.propulsion.nominal_voltage_V
    for key in ("low_V", "critical_V"):
        limit_V = getattr(run.battery, key)
        least_V, most_V = pack_range(nominal_V)
        if limit_V is not None and not least_V <= limit_V <= most_V:
            why = f"readings beyond that are ignored with propulsion.nominal_voltage_V = {nominal_V:g} in {of_vessel}"
            yield f"{of_run}: battery.{key}: expected {least_V:g} to {most_V:g}, found {limit_V:g}: {why}"
    if len(set(still)) < len(still):
        yield f"{of_run}: control.neutral_channels: a channel is there twice"
    if control.plan_deadline_s >= control.period_s:
        yield f"{of_run}: control.plan_deadline_s: expected less than control.period_s = {control.period_s}"
    if control.lease_s <= control.period_s:
        yield f"{of_run}: control.lease_s: expected more than control.period_s = {control.period_s}"
    if 8 in still:
        yield f"{of_run}: control.neutral_channels: channel 8 is the autopilot's mode channel: leave it alone"
    for i, thruster in enumerate(vessel.thrusters):
        for one, where in ((thruster, ""), (thruster.steering, ".steering"), (thruster.rudder, ".rudder")):
            if one and (why := UNFIT_CHANNELS.get(one.channel)):
                yield f"{of_vessel}: thrusters[{i}]{where}.channel: {one.channel} {why}; 9 to 16 are free"
    yield from _device_problems(run, vessel, of_run, of_vessel)


def _device_problems(run: RunFile, vessel: VesselFile, of_run: str, of_vessel: str) -> Iterator[str]:
    """Sensors without a wire, wires without a sensor, wires that cannot be read."""
    keys = devices_of(vessel.sensors)
    for key in keys:
        if run.wire(key) is None:
            why = f"sensors.{key} of {of_vessel} has a wire of its own: state its url"
            yield f"{of_run}: {run.wire_table(key)}: missing table: {why}"
            continue
        try:
            DEVICES[key].codec(vessel.sensors, run.device_name(key))
        except ValueError as error:
            yield f"{of_vessel}: sensors.{key} (wire_format, rate_Hz): {error}"
    for key in ("uwb",) * (run.uwb is not None) + tuple(run.devices):
        if key not in keys:
            there = f"{of_vessel} has no table sensors.{key}" + ("" if key in DEVICES else ", and no wire is read so")
            other = f", or {WITHOUT_UWB}" if key == "uwb" and vessel.sensors.gnss else ""
            yield f"{of_run}: {run.wire_table(key)}: {there}: leave it out{other}"
    if run.vision and vessel.sensors.gnss:
        yield f"{of_run}: vision: with sensors.gnss the autopilot has a position of its own: leave the table out"


def warnings(setup: RunSetup) -> list[str]:
    """What is allowed, but a person should know before the boat moves."""
    fence, margin_m = setup.pilot.fence, setup.pilot.nmpc.fence_margin_m
    texts = list(_geometry(setup.pilot.site)) if setup.pilot.vessel.sensors.uwb else []
    for i, w in enumerate(setup.pilot.mission.path.waypoints):
        room_m = fence.clearance(w.north_m, w.east_m)
        if room_m < margin_m:
            where = f"waypoint {i + 1} at north {w.north_m:g}, east {w.east_m:g} m"
            texts.append(
                f"{where} lies {room_m:.1f} m from the fence: the boat keeps {margin_m:g} m off it where it can"
            )
    path = setup.pilot.mission.path
    texts += [
        f"the leg from waypoint {i} to {i + 1} leaves the fence: the boat may stand before it and not go round; put "
        "waypoints on the way round"
        for i, (start, end) in enumerate(pairwise(path.points), 1)
        if fence.is_crossed(start, end)
    ]
    texts += [
        f"waypoint {i}: its acceptance radius of {w.acceptance_m:g} m reaches back to the waypoint before it, "
        f"{leg_m:.1f} m away: it counts as passed there"
        for i, (w, leg_m) in enumerate(zip(path.waypoints[1:], path.lengths_m, strict=True), 2)
        if w.acceptance_m and w.acceptance_m >= leg_m
    ]
    if setup.pilot.guidance.end == "drift":
        end = (
            " and the heading at the end of the mission is not kept"
            if setup.pilot.mission.end_heading_rad is not None
            else ""
        )
        texts.append(
            f"{setup.pilot.vessel.name} is steered only while it makes way: it cannot keep station; "
            f"hold and the end of a mission leave it drifting with its thrust off{end}"
        )
    texts += _thrusters(setup.pilot.vessel)
    if is_steered(setup.pilot.vessel):
        texts.append("whether thrusters and servos do as they are told is not judged: so far only of fixed thrusters")
    if setup.run.battery == BatteryLimits():
        texts.append("no [battery] limits in the run file: an empty battery will not stop the boat")
    elif setup.run.battery.critical_V is None and setup.run.battery.critical_percent is None:
        texts.append("no critical_V or critical_percent in [battery]: an empty battery will not stop the boat")
    return texts


def _thrusters(vessel: VesselFile) -> Iterator[str]:
    """Thrusters that push at the pulse of every stop, and forces that their pulses do not reach by far."""
    voltage_V = vessel.propulsion.nominal_voltage_V
    for i, t in enumerate(vessel.thrusters):
        where, fmap = f"thrusters[{i}] ({t.name})", vessel.force_maps[t.force_map]
        if not isinstance(fmap, RotorMap) and abs(t.trim_us) > BAND_US and t.gain:
            at_rest_N = force_from_pwm(t, fmap, NEUTRAL_US, voltage_V)
            yield f"{where}: trim_us = {t.trim_us}: 1500 us, which every stop puts out, pushes {at_rest_N:.3g} N"
        sound = replace(t, gain=1.0)
        ends = [force_from_pwm(sound, fmap, us, voltage_V) for us in (t.pwm_min_us, t.pwm_max_us)]
        for key, wanted_N, reached_N in (
            ("force_min_N", -t.force_min_N, max(0.0, -min(ends))),
            ("force_max_N", t.force_max_N, max(0.0, *ends)),
        ):
            if wanted_N > MOST_REACH * reached_N:
                there = f"its pulses reach {reached_N:.3g} N at {voltage_V:g} V"
                yield f"{where}: {key} = {getattr(t, key):g}, but {there}: control counts on what is not there"


def refuse_unfit(setup: RunSetup, names: Mapping[str, str]) -> None:
    """Raise ConfigError for a waypoint beyond the fence of site and mission, or a corner that the boat cannot round.

    `names`: what to call each file. Not asked of a log, whose mission may hold such: they were only warned of once.
    """
    pilot = setup.pilot
    for i, what in unfit_waypoints(pilot.mission, pilot.fence, pilot.guidance):
        w = pilot.mission.path.waypoints[i]
        fence = ": move it, or the fence of the site or the mission" if what.endswith("the fence") else ""
        where = f"waypoint {i + 1} at north {w.north_m:g}, east {w.east_m:g} m"
        raise ConfigError(f"{names[_role_of_mission(names)]}: {where} {what}{fence}")


def _role_of_mission(roles: Iterable[str]) -> str:
    (role,) = (role for role in roles if role.startswith("mission"))
    return role


def _geometry(site: Site) -> Iterator[str]:
    """What the anchors' places are not good for, by the limits of `aritra check`, in the middle of the fence."""
    places_m = site.anchors_m
    if sunk := [anchor.id for anchor in site.anchors if anchor.down_m > 0]:
        yield f"anchors below the water ({', '.join(sunk)}): no tag hears them there; above it down_m is negative"
    if 0 < len(places_m) < START_ANCHORS:
        yield f"{len(places_m)} anchors in the site file: a start from ranges needs {START_ANCHORS}"
    elif len(places_m) and in_a_line(places_m):
        yield "the anchors stand in a line: two places, mirror images, explain all ranges; set one of them apart"
    elif len(places_m):
        north_m, east_m = np.mean(site.fence, axis=0)
        if (dop := hdop(places_m, north_m, east_m, 0.0)) > GOOD_HDOP:
            by = f"a range's error grows {dop:.1f} times in the position (HDOP; at most {GOOD_HDOP:g} is good)"
            yield f"in the middle of the fence {by}: spread the anchors around the water"


def _mission(text: str, name: str, site: Site) -> Mission:
    origin = Origin(site.lat_deg, site.lon_deg, float(np.deg2rad(site.rotation_deg)))
    try:
        return parse(text, kind_of(name), origin=origin, name=Path(name).stem)
    except MissionErrors as errors:
        raise ConfigError("\n".join(f"{name}: {error}" for error in errors.errors)) from None


def _read(path: Path, named: str = "") -> str:
    """The file's text; `named`: where its name was found. Raises ConfigError."""
    try:
        return path.read_text(encoding=TEXT)
    except OSError as error:
        reason = error.strerror
    except UnicodeDecodeError:
        reason = "is not UTF-8 text"
    except ValueError as error:  # a null byte in the name
        reason = str(error)
    raise ConfigError(f"{named}{path}: {reason}")
