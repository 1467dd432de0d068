"""One HTML file with everything in it: the console's modules, the libraries, the data. It opens without a network.

Modules cannot import each other by path in a file without a server, so each becomes a `data:` URL in an import map and
is imported by name: `from "./map.js"` is written `from "aritra/map.js"`. The data is gzip in base64; browsers since
2023 unpack it (DecompressionStream). The page's own policy lets it load nothing.
"""

from __future__ import annotations

import base64
import gzip
import html
import json
import re
from importlib.resources import files

from companion.shore.console.assets import assets

STYLES = ("/web/vendor/leaflet.css", "/web/vendor/uPlot.css", "/web/theme.css", "/web/map.css", "/web/panels.css")
LIBRARIES = ("/web/vendor/leaflet.js", "/web/vendor/uPlot.js")
_IMPORT = re.compile(r"""(\bfrom\s*|\bimport\s*)(["'])(?:\./|/web/)([\w.-]+\.js)\2""")
_MAP_COMMENT = re.compile(r"^\s*//# sourceMappingURL=.*$", re.MULTILINE)


def page(title: str, data: bytes) -> bytes:
    """The file. `data`: JSON for `log.js`."""
    own = {
        file.name: file.read_text(encoding="utf-8")
        for file in files("companion.logs.page").joinpath("web").iterdir()
        if file.is_file()
    }
    known = {path: asset.data.decode() for path, asset in assets().items()}
    modules = {
        path.removeprefix("/web/"): text for path, text in known.items() if re.fullmatch(r"/web/[\w.-]+\.js", path)
    }
    modules |= {name: text for name, text in own.items() if name.endswith(".js")}
    styles = [known[path] for path in STYLES] + [own["log.css"]]
    scripts = [f"<script>{_closed(_MAP_COMMENT.sub('', known[path]))}</script>" for path in LIBRARIES]
    scripts.insert(0, f'<script type="importmap">{_import_map(_reached("log.js", modules))}</script>')
    packed = base64.b64encode(gzip.compress(data, 9, mtime=0)).decode()
    parts = {
        "title": html.escape(title),
        "styles": f"<style>{_closed(chr(10).join(styles))}</style>",
        "scripts": "\n".join(scripts),
        "data": packed,
    }
    return re.sub("@(title|styles|scripts|data)@", lambda found: parts[found[1]], own["log.html"]).encode()


def _reached(first: str, modules: dict[str, str]) -> dict[str, str]:
    """The module `first` and its imports, recursively."""
    found, left = {}, [first]
    while left:
        name = left.pop()
        if name not in found:
            found[name] = modules[name]
            left += [other for _, _, other in _IMPORT.findall(modules[name])]
    return found


def _import_map(modules: dict[str, str]) -> str:
    urls = {}
    for name, text in modules.items():
        by_name = _IMPORT.sub(lambda found: f'{found[1]}"aritra/{found[3]}"', text)
        urls[f"aritra/{name}"] = "data:text/javascript;base64," + base64.b64encode(by_name.encode()).decode()
    return json.dumps({"imports": urls})


def _closed(text: str) -> str:
    """Text escaped so that it cannot end its element."""
    return re.sub(r"</(script|style)", r"<\\/\1", text, flags=re.IGNORECASE)
