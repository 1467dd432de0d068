"""Site files for the page: a fence drawn anew is put into the file's own text; the boat's loader reads the whole.

A boat takes no other fence while its program runs: its controller was built with the one that it has. So a drawn fence
is a file, for the next run.
"""

from __future__ import annotations

import asyncio
import re
import tomllib
from typing import Annotated

import msgspec
from aiohttp import web

from companion.core.configuration.site_file import Site, load_site
from companion.core.configuration.tables import ConfigError
from companion.core.geometry.fence import MOST_CORNERS
from companion.shore.console.web_server import MAX_BODY_BYTES, read_body

KEY = re.compile(r"^[ \t]*fence[ \t]*=[ \t]*", re.MULTILINE)
Corner = tuple[float, float]


class SiteToRead(msgspec.Struct, forbid_unknown_fields=True):
    """Body of POST /site: a site file; `fence`: to be put in the place of its own, None: it is only read."""

    name: Annotated[str, msgspec.Meta(min_length=1, max_length=100)]
    text: Annotated[str, msgspec.Meta(max_length=MAX_BODY_BYTES)]
    fence: Annotated[list[Corner], msgspec.Meta(max_length=10 * MOST_CORNERS)] | None = None


async def read_site(request: web.Request) -> web.Response:
    """The name of the site, its fence, and the text with that fence; or what is wrong, as `errors`."""
    body = await read_body(request, SiteToRead)
    told = await asyncio.to_thread(_read, body)
    return web.Response(body=msgspec.json.encode(told), content_type="application/json")


def _read(body: SiteToRead) -> dict:
    try:
        site = load_site(body.text, name=body.name)
        text = body.text
        if body.fence is not None:
            text = with_fence(body.text, body.fence, name=body.name)
            site = _same_but_fence(site, text, body.name)
    except ConfigError as error:
        return {"errors": [str(error)]}
    return {"site": site.name, "fence": site.fence, "text": text}


def _same_but_fence(before: Site, text: str, name: str) -> Site:
    after = load_site(text, name=name)
    if msgspec.structs.replace(after, fence=before.fence) != before:
        raise ConfigError(f"{name}: fence: cannot be put in without changing more of the file: edit it by hand")
    return after


def with_fence(text: str, fence: list[Corner], *, name: str) -> str:
    """A site file's text with another fence [m], everything else as it was, comments too. Raises ConfigError.

    The value ends where the text up to there is TOML again.
    """
    found = KEY.search(text)
    if found is None or "[" not in text[found.end() : found.end() + 2]:
        raise ConfigError(f"{name}: fence: not found as a line of its own, `fence = [...]`: edit it by hand")
    for end in (m.end() for m in re.finditer(r"\]", text[found.end() :])):
        value = text[found.end() : found.end() + end]
        try:
            tomllib.loads(f"fence = {value}")
        except tomllib.TOMLDecodeError:
            continue
        corners = ", ".join(f"[{round(north, 2)}, {round(east, 2)}]" for north, east in fence)  # to the centimetre
        return f"{text[: found.end()]}[{corners}]{text[found.end() + end :]}"
    raise ConfigError(f"{name}: fence: its end is not found: edit it by hand")
