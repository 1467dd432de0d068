"""What a campaign reads before it begins: its files, and that every value it will put in can be."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec

from companion.core.configuration.run_file import load_run
from companion.core.configuration.site_file import load_site
from companion.core.configuration.tables import TEXT, ConfigError
from sim.campaign.case_files import HEADS, WorldKeys, case_setup, check_start
from sim.campaign.cases import Case, expand, settings_of
from sim.campaign.file import LOGS, ROLES, Campaign, load_campaign
from sim.campaign.runners.job import Work


@dataclass(frozen=True)
class Inputs:
    """A campaign with its files. `texts`, `digests`: by path as the campaign has it; `folder`: where paths begin."""

    campaign: Campaign
    name: str
    text: str
    folder: Path
    texts: dict[str, str]
    digests: dict[str, str]

    def work(self, case: Case) -> Work:
        """The case with all that it needs."""
        plain = {role: paths[0] for role, paths in case.files.items() if role not in LOGS}
        logs = {role: paths for role, paths in case.files.items() if role in LOGS}
        return Work(
            kind=self.campaign.kind,
            id=case.id,
            seed=case.seed,
            values=case.values,
            settings=case.settings,
            texts={role: self.texts[path] for role, path in plain.items()},
            names=plain,
            logs={r: tuple((str((self.folder / p).resolve()), self.digests[p]) for p in ps) for r, ps in logs.items()},
        )


def read_campaign(path: Path) -> tuple[Inputs, list[Case]]:
    """The file, what it names, and its cases. Raises ConfigError naming file and key."""
    text, folder = _utf8(_bytes(path, str(path)), str(path)), path.parent
    campaign = load_campaign(text, name=str(path))
    campaign = _with_files_of_run(campaign, folder, str(path))
    texts, digests = {}, {}
    for role, name in sorted(_named(campaign)):
        data = _bytes(folder / name, f"{path}: files.{role}: {name}")
        digests[name] = hashlib.sha256(data).hexdigest()
        if role not in LOGS:
            texts[name] = _utf8(data, name)
    inputs = Inputs(campaign, str(path), text, folder, texts, digests)
    try:
        _check(inputs)
        cases = expand(campaign, digests)
        _check_starts(inputs, cases)
    except ConfigError:
        raise
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from None
    same = {a.id for a, b in pairwise(cases) if a.id == b.id}
    if same:
        raise ConfigError(f"{path}: grid: {len(same)} cases are there twice; do two files hold the same?")
    return inputs, cases


def _with_files_of_run(campaign: Campaign, folder: Path, name: str) -> Campaign:
    """Of missions: the vessel, site and mission that the run file names, where the campaign names none."""
    if campaign.kind != "missions" or "run" not in campaign.files:
        return campaign
    run_path = campaign.files["run"][0]
    run = load_run(_utf8(_bytes(folder / run_path, f"{name}: files.run: {run_path}"), run_path), name=run_path)
    beside = {role: (str(Path(run_path).parent / getattr(run, role)),) for role in ("vessel", "site", "mission")}
    return msgspec.structs.replace(campaign, files=beside | campaign.files)


def _named(campaign: Campaign) -> Iterator[tuple[str, str]]:
    """Role and path of every file."""
    for role, paths in campaign.files.items():
        yield from ((role, path) for path in paths)
    for key, values in campaign.grid.items():
        for value in values if key.startswith("files.") else ():
            yield from ((key[6:], path) for path in ((value,) if isinstance(value, str) else value))


def _check(inputs: Inputs) -> None:
    """Every key leads somewhere, and every value of it can be: alone, or beside what is set and first in the grid."""
    campaign, name = inputs.campaign, inputs.name
    kind, keys = campaign.kind, [*campaign.set, *campaign.grid, *campaign.draw]
    given = {*campaign.files, *(k[6:] for k in campaign.grid if k.startswith("files."))}
    for key in keys:
        if (head := key.split(".")[0]) not in HEADS[kind] or "." not in key:
            raise ConfigError(f"{name}: {key}: keys of {kind} begin with {', '.join(HEADS[kind])}")
        if head == "files" and key[6:] not in (r for r in ROLES[kind] if r != "run"):
            raise ConfigError(f"{name}: {key}: no file of {kind} that can differ between cases")
        if key in campaign.draw and head in ("files", kind):
            raise ConfigError(f"{name}: draw.{key}: files and settings of {kind} can stand in grid alone")
    for role in ("run", "site", "mission") if kind == "missions" else ("vessel",):
        if role not in given:
            raise ConfigError(f"{name}: files.{role}: missing key")
    _check_logs(campaign, name, given, keys)
    ways = [("set", key, value) for key, value in campaign.set.items()]
    ways += [("grid", key, value) for key, values in campaign.grid.items() for value in values]
    ways += [("draw", key, value) for key, draw in campaign.draw.items() for value in draw.examples]
    first = {key: values[0] for key, values in campaign.grid.items()}
    files = {key: value for key, value in first.items() if key.startswith("files.")}
    _possible(inputs, files, name)
    for table, key, value in ways:
        alone, among = {**files, key: value}, {**first, **campaign.set, key: value}
        try:
            _possible(inputs, alone, f"{name}: {table}.{key} = {value!r}")
        except ConfigError as error:
            try:
                _possible(inputs, among, name)
            except ConfigError:
                raise error from None


def _check_starts(inputs: Inputs, cases: Sequence[Case]) -> None:
    """Missions begin within the fence, at every point of the grid; a start that is drawn may fail as a case."""
    campaign, keys = inputs.campaign, ("world.north_m", "world.east_m")
    if campaign.kind != "missions" or campaign.draw.keys() & set(keys):
        return
    starts = {
        (case.files["site"][0], msgspec.convert({k[6:]: case.values[k] for k in keys if k in case.values}, WorldKeys))
        for case in cases
        if case.seed == campaign.seeds[0]
    }
    for site, world in starts:
        try:
            check_start(load_site(inputs.texts[site], name=site), world)
        except ConfigError as error:
            raise ConfigError(f"{inputs.name}: {error}") from None


def _check_logs(campaign: Campaign, name: str, given: set[str], keys: list[str]) -> None:
    if campaign.kind == "missions":
        return
    drives = campaign.kind + ".drive_s" in keys or getattr(campaign.settings, "drive_s", None) is not None
    if drives == ("log" in given):
        raise ConfigError(f"{name}: {campaign.kind}: expected either files.log or {campaign.kind}.drive_s")
    if not drives:
        for key in keys:
            if key.split(".")[0] in ("truth", "weather"):
                raise ConfigError(f"{name}: {key}: needs {campaign.kind}.drive_s: a log that is there does not change")


def _possible(inputs: Inputs, values: dict[str, Any], where: str) -> None:
    """Raises ConfigError where a case with these values could not begin."""
    campaign = inputs.campaign
    alone = msgspec.structs.replace(campaign, set={}, draw={}, grid={}, seeds=campaign.seeds[:1])
    files = {k[6:]: (v,) if isinstance(v, str) else tuple(v) for k, v in values.items() if k.startswith("files.")}
    try:
        settings_of(campaign, values)
        (case,) = expand(msgspec.structs.replace(alone, files={**campaign.files, **files}), inputs.digests)
        plain = {k: v for k, v in values.items() if k.split(".")[0] not in ("files", campaign.kind)}
        case_setup(msgspec.structs.replace(inputs.work(case), values=plain))
    except ValueError as error:
        raise ConfigError(f"{where}: {error}") from None


def _bytes(path: Path, where: str) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{where}: {error.strerror}") from None


def _utf8(data: bytes, where: str) -> str:
    try:
        return data.decode(TEXT)
    except UnicodeDecodeError:
        raise ConfigError(f"{where}: is not UTF-8 text") from None
