"""Files of the page: our own modules, and the libraries' from the packages that carry them. Nothing from elsewhere."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, distribution
from importlib.resources import files
from typing import NamedTuple

from companion.core.configuration.tables import ConfigError

VENDOR = {
    "leaflet.js": ("XStatic-Leaflet", "xstatic/pkg/leaflet/data/leaflet.js"),
    "leaflet.css": ("XStatic-Leaflet", "xstatic/pkg/leaflet/data/leaflet.css"),
    "uPlot.js": ("uplot-python", "uplot/static/uPlot.iife.js"),
    "uPlot.css": ("uplot-python", "uplot/static/uPlot.min.css"),
}
"""Name under /vendor/ -> (distribution, path in it). Read as files: neither package is imported."""
TYPES = {
    "css": "text/css",
    "html": "text/html",
    "js": "text/javascript",
    "svg": "image/svg+xml",
}
MISSING = "the console needs libraries that are not installed: pip install 'aritra[shore]'"


class Asset(NamedTuple):
    """Content and content type."""

    data: bytes
    content_type: str


def assets() -> dict[str, Asset]:
    """Path on the server -> file. Raises ConfigError where a library is not installed."""
    return {path: Asset(data, TYPES[path.rsplit(".", 1)[1]]) for path, data in (*_own(), *_vendor())}


def _own() -> Iterator[tuple[str, bytes]]:
    folders = [("/web", files("companion.shore.console").joinpath("web"))]
    for path, folder in folders:
        for file in folder.iterdir():
            if file.is_dir():
                folders.append((f"{path}/{file.name}", file))
            elif file.name.rsplit(".", 1)[-1] in TYPES:
                yield f"{path}/{file.name}", file.read_bytes()


def _vendor() -> Iterator[tuple[str, bytes]]:
    for name, (package, path) in VENDOR.items():
        try:
            with open(str(distribution(package).locate_file(path)), "rb") as file:
                yield f"/vendor/{name}", file.read()
        except (PackageNotFoundError, OSError) as error:
            raise ConfigError(f"{MISSING} ({package}: {error})") from None
