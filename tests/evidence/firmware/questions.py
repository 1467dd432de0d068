"""Evidence: the same questions by MAVLink to the simulated autopilot and to every firmware at hand.

Both stand in the basin without GPS, wiring `gate`, on a stepped clock. Differences are compared with the rows of the
table in docs/sitl.md: first column patterns of questions (`fnmatch`), last column the reason.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import Path

from sim.world.autopilot.parameter_table import BOARD_PARAMETERS
from sim.world.world import WorldSetup
from tests.evidence.firmware import asked_commands, asked_protocol
from tests.evidence.firmware.dialogue import Dialogue
from tests.evidence.line import Line, at_least, exactly, information
from tests.evidence.main_job.parts import reference_boat
from tests.evidence.processes import processes
from tests.support.autopilots.firmware_rig import binaries, world_with

FAMILIES = {
    family.__name__: family
    for family in (
        asked_commands.commands, asked_commands.modes, asked_commands.arming, asked_protocol.parameters,
        asked_protocol.messages, asked_protocol.streams, asked_protocol.addresses, asked_protocol.overrides,
        asked_protocol.files, asked_protocol.missions,
    )
}  # fmt: skip
SITL = Path(__file__).resolve().parents[3] / "docs" / "sitl.md"
HEADING = "## Where the simulated autopilot differs"
FEWEST = 315


def answers(case: tuple[str, str, str]) -> dict[str, str]:
    """All answers of one family: its name, the firmware's path ("": the simulated autopilot), and which version."""
    family, binary, version = case
    setup, _, _ = reference_boat()
    boat = WorldSetup(setup.vessel, setup.site, firmware=version)
    with world_with(binary, boat, 1, gps=False, parameters=BOARD_PARAMETERS) as world:
        return dict(FAMILIES[family](Dialogue(world)))


def version_of(binary: Path) -> str:
    """ "4.6" or "4.7", as the firmware says."""
    said = answers(("addresses", str(binary), ""))["command to (1, 1)"]
    number = int(re.search(r"AUTOPILOT_VERSION (0x[0-9a-f]+)", said)[1], 16)
    return f"{number >> 8}.{number & 255}"


def differences(ours: dict[str, str], theirs: dict[str, str]) -> dict[str, tuple[str, str]]:
    """Question -> (real, simulated), where they differ; a question that one of them does not get has no answer."""
    names = [*theirs, *(name for name in ours if name not in theirs)]
    pairs = {name: (theirs.get(name, "not asked"), ours.get(name, "not asked")) for name in names}
    return {name: pair for name, pair in pairs.items() if pair[0] != pair[1]}


def documented() -> list[str]:
    """Patterns of questions whose difference docs/sitl.md explains."""
    section = SITL.read_text(encoding="utf-8").split(HEADING)[1].split("\nNo question shows")[0]
    cells = [line.split("|")[1] for line in section.splitlines() if line.startswith("|")]
    return [pattern for cell in cells for pattern in re.findall(r"`([^`]+)`", cell)]


def questions(full: bool) -> Iterator[Line]:
    """Questions: the same protocol questions to the simulated autopilot and to every firmware at hand"""
    named = [(path, version_of(path)) for path in binaries()]
    versions = [version for _, version in named] or ["4.6", "4.7"]
    cases = [(family, "", version) for version in versions for family in FAMILIES]
    cases += [(family, str(path), version) for path, version in named for family in FAMILIES]
    with processes() as pool:
        got = list(pool.map(answers, cases))
    merged: dict[tuple[str, str], dict[str, str]] = {}
    for (_, binary, version), found in zip(cases, got, strict=True):
        merged.setdefault((binary, version), {}).update(found)
    for version in versions:
        yield at_least(f"{version}: questions to the simulated autopilot", len(merged["", version]), FEWEST)
    if not named:
        print("  (ARDUROVER names no firmware: its answers are not compared)")
    patterns, used = documented(), set()
    for path, version in named:
        differ = differences(merged["", version], merged[str(path), version])
        new = [name for name in differ if not any(fnmatchcase(name, pattern) for pattern in patterns)]
        used |= {pattern for pattern in patterns if any(fnmatchcase(name, pattern) for name in differ)}
        for name in new:
            print(f"  {version}: {name}\n      real       {differ[name][0]}\n      simulated  {differ[name][1]}")
        yield information(f"{version}: questions with another answer", len(differ))
        yield exactly(f"{version}: of these not explained in docs/sitl.md", len(new), 0)
    if len(set(versions)) > 1:  # some rows are for one version alone
        unused = [pattern for pattern in patterns if pattern not in used]
        yield exactly("rows of docs/sitl.md that no question shows", len(unused), 0, note=", ".join(unused))
