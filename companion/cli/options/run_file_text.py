"""A run file made from another: for another folder, and as text."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec
from msgspec.structs import replace

from companion.core.configuration.run_file import RunFile


def absolute(run: RunFile, folder: Path) -> RunFile:
    """The run file with absolute paths; `folder`: its own."""

    def whole(path: str | None) -> Any:
        return path and str((folder / path).resolve())

    made = replace(run, vessel=whole(run.vessel), site=whole(run.site), mission=whole(run.mission))
    made = replace(made, excitation=whole(run.excitation), log=replace(run.log, folder=whole(run.log.folder)))
    made = replace(made, mavlink=replace(run.mavlink, signing_key=whole(run.mavlink.signing_key)))
    if link := run.telemetry:
        made = replace(made, telemetry=replace(link, config=whole(link.config), command_key=whole(link.command_key)))
    return made


def toml_of(run: RunFile) -> str:
    """A run file's text. Scalars and lists in JSON are TOML, too."""
    return "\n".join(_lines(msgspec.to_builtins(run))) + "\n"


def _lines(values: Mapping[str, Any], within: str = "") -> Iterator[str]:
    """`within`: the table's own name and a dot."""
    tables = {key: value for key, value in values.items() if isinstance(value, dict)}
    for key, value in values.items():
        if value is not None and key not in tables:
            yield f"{key} = {json.dumps(value, ensure_ascii=False)}"
    for key, table in tables.items():
        yield from ("", f"[{within}{key}]", *_lines(table, f"{within}{key}."))
