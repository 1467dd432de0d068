"""Files of the page: our own modules, and beside them, as their makers publish them, Leaflet and uPlot."""

from __future__ import annotations

from importlib.resources import files
from typing import NamedTuple

TYPES = {
    "css": "text/css",
    "html": "text/html",
    "js": "text/javascript",
    "svg": "image/svg+xml",
}


class Asset(NamedTuple):
    """Content and content type."""

    data: bytes
    content_type: str


def assets() -> dict[str, Asset]:
    """Path on the server -> file."""
    found, folders = {}, [("/web", files("companion.shore.console").joinpath("web"))]
    for path, folder in folders:
        for file in folder.iterdir():
            kind = TYPES.get(file.name.rsplit(".", 1)[-1])
            if file.is_dir():
                folders.append((f"{path}/{file.name}", file))
            elif kind:
                found[f"{path}/{file.name}"] = Asset(file.read_bytes(), kind)
    return found
