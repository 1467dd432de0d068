"""One case as the worker needs it: its files with its values in them. Errors name file and key."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Annotated, Any, TypeVar

import msgspec
import tomli_w

from companion.boat.load_run import RunSetup, setup_of
from companion.core.configuration.site_file import Site
from companion.core.configuration.tables import ConfigError, Table, found_wrong
from companion.core.configuration.vessel_file import VesselFile
from companion.core.model.actuators.propulsion import only_fixed
from companion.core.model.load_vessel import load_vessel
from sim.campaign.dotted_keys import applied, of_head
from sim.campaign.runners.job import Work
from sim.world.environment import Weather
from sim.world.sensors import UwbFaults

HEADS = {
    "missions": ("run", "vessel", "truth", "weather", "faults", "world", "missions", "files"),
    "identify": ("vessel", "truth", "weather", "identify", "files"),
    "diagnose": ("vessel", "truth", "weather", "diagnose", "files"),
}
"""What a dotted key may begin with."""
FILES_OF_RUN = ("vessel", "site", "mission", "excitation")
"""Keys of a run file that name files: a campaign varies `files.ROLE` instead."""
OF_THE_VESSEL = ("waves",)
"""What the weather has by the vessel file's terms: `truth.terms.waves.KEY` instead."""
T = TypeVar("T")


class WorldKeys(Table, frozen=True, kw_only=True):
    """`mismatch`: plant parameters lie up to this share off the vessel file; start pose; battery; autopilot's clock."""

    mismatch: Annotated[float, msgspec.Meta(ge=0, le=0.9)] = 0.0
    voltage_v: Annotated[float, msgspec.Meta(gt=0, le=60)] = 15.6
    drift_ppm: Annotated[float, msgspec.Meta(ge=-500, le=500)] = 20.0
    north_m: float = 6.0
    east_m: float = 6.0
    psi_deg: Annotated[float, msgspec.Meta(ge=-360, le=360)] = 0.0


@dataclass(frozen=True)
class CaseSetup:
    """`setup`: of missions. `vessel`: believed; `truth`: what really floats. The same vessel unless they differ."""

    setup: RunSetup | None
    vessel: VesselFile
    truth: VesselFile
    weather: Weather
    faults: UwbFaults
    world: WorldKeys


def case_setup(work: Work) -> CaseSetup:
    """Everything that `work` says, checked. Raises ConfigError."""
    texts, setup = dict(work.texts), None
    texts["vessel"] = _text(work, "vessel", texts["vessel"])
    truth_text = _text(work, "truth", texts.get("truth", texts["vessel"]))
    vessel = load_vessel(texts["vessel"], name=work.names["vessel"])
    truth_name = work.names.get("truth", work.names["vessel"])
    truth = vessel if truth_text == texts["vessel"] else load_vessel(truth_text, name=truth_name)
    if [t.name for t in truth.thrusters] != [t.name for t in vessel.thrusters]:
        raise ConfigError(f"{truth_name}: thrusters: expected those of {work.names['vessel']}, in their order")
    if work.kind != "missions":
        only_fixed(vessel, work.names["vessel"], "campaigns of fits")
    else:
        setup = _setup(work, texts)
    return CaseSetup(
        setup,
        vessel,
        truth,
        _plain(work, "weather", Weather),
        _plain(work, "faults", UwbFaults),
        _converted(of_head(work.values, "world"), WorldKeys, "world"),
    )


def check_start(site: Site, world: WorldKeys) -> None:
    """Raise ConfigError for a start beyond the fence."""
    if not site.inside(world.north_m, world.east_m):
        where = f"a start at north {world.north_m:g}, east {world.east_m:g} m lies beyond the fence of site {site.name}"
        raise ConfigError(f"world.north_m, world.east_m: {where}")


def _setup(work: Work, texts: Mapping[str, str]) -> RunSetup:
    run = _text(work, "run", texts["run"])
    suffix = work.names["mission"].rpartition(".")[2]
    roles = {"run.toml": run, "vessel.toml": texts["vessel"], "site.toml": texts["site"],
             f"mission.{suffix}": texts["mission"]}  # fmt: skip
    names = {"run.toml": work.names["run"], "vessel.toml": work.names["vessel"], "site.toml": work.names["site"],
             f"mission.{suffix}": work.names["mission"]}  # fmt: skip
    return setup_of(roles, names)


def _text(work: Work, head: str, text: str) -> str:
    """A TOML file's text with the case's values in it; as it is where there are none."""
    values = of_head(work.values, head)
    if not values:
        return text
    for key in values:
        if head == "run" and key in FILES_OF_RUN:
            raise ConfigError(f"run.{key}: files are chosen by files.{key}")
    try:
        return tomli_w.dumps(applied(tomllib.loads(text), values))
    except KeyError as error:
        raise ConfigError(f"{work.names.get(head, work.names['vessel'])}: {error.args[0]}") from None


def _plain(work: Work, head: str, kind: type[T]) -> T:
    """A dataclass from the case's values below `head`."""
    values = of_head(work.values, head)
    known = [f.name for f in fields(kind) if f.name not in OF_THE_VESSEL]  # type: ignore[arg-type]
    for key in values:
        if key not in known:
            raise ConfigError(f"{head}.{key}: unknown key; there are {', '.join(known)}")
    return _converted(values, kind, head)


def _converted(values: Mapping[str, Any], kind: type[T], head: str) -> T:
    try:
        return msgspec.convert(values, kind)
    except msgspec.ValidationError as error:
        key, what = found_wrong(error)
        raise ConfigError(f"{head}.{key}: {what}") from None
