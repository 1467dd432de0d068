"""Logs of a folder for the page: a list, downloads, and `aritra log page` made of one.

A name that is asked for is looked for in the list of what is there, and never put together to a path. A log's page
holds words of whoever wrote the log: it is served in a sandbox, as an origin of its own that may order nothing.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path

import msgspec
import psutil
from aiohttp import web

from companion.core.configuration.tables import ConfigError
from companion.python_child import aritra

DEPTH, MOST = 3, 500
"""Folders below each other that are looked into, and logs that are listed, the newest first (assumed)."""
PAGE_S = 300.0
"""How long a page may take to be made (assumed)."""
_CONTINUES = re.compile(r"\.part\d+$")
SANDBOX = (
    "sandbox allow-scripts allow-downloads; default-src 'none'; script-src 'unsafe-inline' data:; "
    "style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


class ListedLog(msgspec.Struct):
    """One file in the list. `name`: path below the folder; `page`: one can be made, for it continues no other."""

    name: str
    bytes: int
    unix_s: float
    page: bool


class ServedLogs:
    """The folder, and one page made at a time. Raises ConfigError where there is no such folder."""

    def __init__(self, folder: Path) -> None:
        if not folder.is_dir():
            raise ConfigError(f"--logs: {folder}: no such folder")
        self._folder = folder.resolve()
        self._made = tempfile.TemporaryDirectory(prefix="aritra-pages-")
        self._one = asyncio.Lock()

    def close(self) -> None:
        """Remove the pages that were made."""
        self._made.cleanup()

    def add_to(self, app: web.Application) -> None:
        """Add the routes /logs, /logs/file?name=, /logs/page?name=."""
        for path, handler in (("/logs", self._list), ("/logs/file", self._file), ("/logs/page", self._page)):
            app.router.add_get(path, handler)

    def listed(self) -> dict[str, Path]:
        """Name -> file of every log that is there, the newest first; nothing that leads out of the folder."""
        found = sorted(self._walk(self._folder, DEPTH), key=lambda each: -each[1])[:MOST]
        return {path.relative_to(self._folder).as_posix(): path for path, _ in found}

    def _walk(self, folder: Path, depth: int) -> Iterator[tuple[Path, float]]:
        """Logs and when they were changed; what cannot be looked at is left out."""
        with contextlib.suppress(OSError):
            for path in sorted(folder.iterdir()):
                with contextlib.suppress(OSError):
                    if path.is_symlink() or path.name.startswith("."):
                        continue
                    if path.is_dir() and depth > 1:
                        yield from self._walk(path, depth - 1)
                    elif path.suffix == ".mcap" and path.is_file():
                        yield path, path.stat().st_mtime

    async def _list(self, request: web.Request) -> web.StreamResponse:
        _same_site(request)
        rows = await asyncio.to_thread(self._rows)
        return web.Response(body=msgspec.json.encode(rows), content_type="application/json")

    def _rows(self) -> list[ListedLog]:
        rows = []
        for name, path in self.listed().items():
            with contextlib.suppress(OSError):
                stat = path.stat()
                rows.append(ListedLog(name, stat.st_size, stat.st_mtime, page=not _CONTINUES.search(path.stem)))
        return rows

    async def _file(self, request: web.Request) -> web.StreamResponse:
        path = await self._asked(request)
        name = path.name.encode("ascii", "replace").decode().replace('"', "'").replace("\\", "_")
        headers = {"Content-Type": "application/octet-stream", "Content-Disposition": f'attachment; filename="{name}"'}
        return web.FileResponse(path, headers=headers)

    async def _page(self, request: web.Request) -> web.StreamResponse:
        path = await self._asked(request)
        stat = path.stat()
        state = f"{path} {stat.st_size} {stat.st_mtime_ns}"
        out = Path(self._made.name) / f"{hashlib.sha256(state.encode()).hexdigest()}.html"
        async with self._one:
            if not out.exists() and (why := await make_page(path, out)):
                raise web.HTTPUnprocessableEntity(text=f"no page of {path.name}: {why}")
        return web.FileResponse(out, headers={"Content-Type": "text/html", "Content-Security-Policy": SANDBOX})

    async def _asked(self, request: web.Request) -> Path:
        """The file that is asked for. Raises the answer where there is none."""
        _same_site(request)
        listed = await asyncio.to_thread(self.listed)
        if (path := listed.get(request.query.get("name", ""))) is None:
            raise web.HTTPNotFound(text="no such log: look at the list again")
        return path


def _same_site(request: web.Request) -> None:
    """A link of another site must not make us work, though it would not be shown what for."""
    if request.headers.get("Sec-Fetch-Site", "same-origin") not in ("same-origin", "none"):
        raise web.HTTPForbidden(text="asked for by a page of another site")


async def make_page(path: Path, out: Path) -> str:
    """Make a log's page in a process of its own, that gives way to the console; why not, or nothing."""
    pipe = asyncio.subprocess.PIPE
    command = aritra("log", "page", "--no-ghosts", "--out", out, "--", path)
    child = await asyncio.create_subprocess_exec(*command, stdout=pipe, stderr=asyncio.subprocess.STDOUT)
    with contextlib.suppress(psutil.Error):
        psutil.Process(child.pid).nice(15)
    try:
        said, _ = await asyncio.wait_for(child.communicate(), PAGE_S)
    except TimeoutError:
        return f"it took longer than {PAGE_S:g} s; aritra log page makes it without a limit"
    finally:
        if child.returncode is None:
            child.kill()
            await child.wait()
    return "" if out.exists() else said.decode(errors="replace")[-500:].strip()
