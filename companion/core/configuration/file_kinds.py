"""What a file is, from its first bytes: for messages where another kind is needed. Guesses nothing that is not sure."""

from __future__ import annotations

import codecs
import re
import tomllib
from collections.abc import Mapping

RUN, VESSEL, SITE = "a run file", "a vessel file", "a site file"
MISSION, EXCITATION, CAMPAIGN = "a mission", "an excitation file", "a campaign file"
MCAP, BINARY = "an MCAP log", "binary data"
UTF16 = "text in UTF-16, not in UTF-8 (as PowerShell's `>` writes it)"
UTF16_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
EXAMPLES = {
    RUN: "deploy/aritra.toml",
    VESSEL: "deploy/boats/aritra.toml",
    SITE: "deploy/sites/basin.toml",
    MISSION: "deploy/missions/square.toml",
    EXCITATION: "deploy/excitations/library.toml",
    CAMPAIGN: "deploy/campaigns/weather.toml",
}
"""Our own kinds, each with a file that comes with the source."""
HEAD_BYTES = 1 << 18
"""How much of a file is enough: our own are smaller."""
_KEYS = {
    CAMPAIGN: {"kind", "seeds", "files"},
    RUN: {"vessel", "site", "mission"},
    VESSEL: {"hull", "inertia", "damping"},
    SITE: {"lat_deg", "lon_deg"},
    EXCITATION: {"segments"},
    MISSION: {"waypoints"},
}
"""Keys at the top of a TOML file that no other kind has together."""
_BEGINS = {
    b"\x89MCAP": MCAP,
    b"\xa3\x95": "an ArduPilot log (.bin)",
    b"PAR1": "a Parquet table",
    b"\x89PNG": "a picture",
    b"%PDF": "a PDF file",
    b"\x1f\x8b": "a compressed file",
    b"PK\x03\x04": "a ZIP archive",
    b"\x7fELF": "a program",
    b"QGC WPL": MISSION,
    b"<!doctype html": "an HTML page",
    b"<html": "an HTML page",
    **dict.fromkeys(UTF16_MARKS, UTF16),
}
_JSON = {rb'"fileType"\s*:\s*"Plan"': MISSION, rb'"type"\s*:\s*"Feature': "a GeoJSON file"}


def kind_of_file(head: bytes) -> str | None:
    """Kind of a file, with its article, from its first `HEAD_BYTES`; None: it could be anything."""
    for begin, kind in _BEGINS.items():
        if head[: len(begin)].lower() == begin.lower():
            return kind
    if head[8:9] in (b"\xfd", b"\xfe") and b"\0" in head[:8]:
        return "a telemetry log (.tlog)"
    if b"\0" in head:
        return BINARY
    if head.lstrip().startswith((b"{", b"[")):
        found = (kind for pattern, kind in _JSON.items() if re.search(pattern, head))
        return next(found, "a JSON file" if head.lstrip().startswith(b"{") else None) or _toml(head)
    return _toml(head)


def kind_of_tables(document: Mapping[str, object]) -> str | None:
    """Kind of a TOML file from the keys at its top; None: none of ours."""
    return next((kind for kind, keys in _KEYS.items() if keys <= document.keys()), None)


def _toml(head: bytes) -> str | None:
    try:
        return kind_of_tables(tomllib.loads(head.decode()))
    except (ValueError, RecursionError):  # no UTF-8, no TOML, more digits or deeper than Python reads
        return None
