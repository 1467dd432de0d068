"""The console's web server: files of the page, by `request_auth`. `base_app` is shared by every page."""

from __future__ import annotations

import asyncio
import gzip
import hashlib
from collections.abc import Awaitable, Callable
from typing import TypeVar

import msgspec
from aiohttp import web

from companion.shore.console.assets import Asset, assets
from companion.shore.console.request_auth import RequestAuth

HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
    "connect-src 'self'; manifest-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-cache",
}
MAX_BODY_BYTES = 200_000
"""A mission file, quoted as JSON."""
BODY_S = 5.0
"""How long a body may take to arrive (assumed)."""
TOKEN = "open the address with the token that `aritra shore` printed"
Body = TypeVar("Body")
Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


def base_app(
    guard: RequestAuth, home: str, passed: Callable[[asyncio.Transport | None], object] = lambda transport: None
) -> web.Application:
    """Serves the page `home` (its path) and all files, to requests that pass `request_auth`. Raises ConfigError.

    `passed` is told the connection of each of these.
    """
    app = web.Application(middlewares=[_guarded(guard, passed)], client_max_size=MAX_BODY_BYTES)
    for path, asset in assets().items():
        app.router.add_get(path, _file(asset))
        if path == home:
            app.router.add_get("/", _entrance(guard, _file(asset)))
    return app


async def read_body(request: web.Request, kind: type[Body]) -> Body:
    """The body of a request, JSON. Raises the answer to one that is not what it should be."""
    if request.content_type != "application/json":
        raise web.HTTPUnsupportedMediaType(text="expected application/json")
    try:
        async with asyncio.timeout(BODY_S):
            return msgspec.json.decode(await request.read(), type=kind)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise web.HTTPBadRequest(text=str(error)) from None
    except TimeoutError:
        raise web.HTTPRequestTimeout(text=f"the request took longer than {BODY_S:g} s to arrive") from None


def _guarded(guard: RequestAuth, passed: Callable[[asyncio.Transport | None], object]):
    @web.middleware
    async def guarded(request: web.Request, handler: Handler) -> web.StreamResponse:
        host, origin = request.headers.get("Host"), request.headers.get("Origin")
        changes = request.method not in ("GET", "HEAD") or "Upgrade" in request.headers
        if not guard.host(host):
            raise _stranger("this name is not one of this machine's: use its address")
        if not guard.origin(origin, host, needed=changes):
            raise _stranger("asked for by a page of another site")
        known = guard.knows(request.cookies.get(guard.cookie(request.url.port)))
        if not known and request.path != "/":
            raise _stranger(TOKEN)
        if known:
            passed(request.transport)
        try:
            response = await handler(request)
        except web.HTTPException as answer:
            answer.headers.update(HEADERS)
            raise
        if not response.prepared:
            for name, value in HEADERS.items():
                response.headers.setdefault(name, value)
        return response

    return guarded


def _stranger(why: str) -> web.HTTPForbidden:
    """Refused, and its connection closed."""
    no = web.HTTPForbidden(text=f"{why}\n")
    no.force_close()
    return no


def _entrance(guard: RequestAuth, page: Handler) -> Handler:
    """The page; with the token in the address: a cookie for it, and the address without it."""

    async def enter(request: web.Request) -> web.StreamResponse:
        if (token := request.query.get("token")) is not None and guard.knows(token):
            answer = web.HTTPSeeOther("/")
            answer.set_cookie(guard.cookie(request.url.port), token, httponly=True, samesite="Strict", path="/")
            raise answer
        if not guard.knows(request.cookies.get(guard.cookie(request.url.port))):
            raise _stranger(TOKEN)
        return await page(request)

    return enter


def _file(asset: Asset) -> Handler:
    packed = gzip.compress(asset.data, mtime=0)
    tag = f'"{hashlib.sha256(asset.data).hexdigest()[:16]}"'

    async def serve(request: web.Request) -> web.StreamResponse:
        if request.headers.get("If-None-Match") == tag:
            return web.Response(status=304, headers={"ETag": tag})
        small = "gzip" in request.headers.get("Accept-Encoding", "")
        headers = {"ETag": tag, "Vary": "Accept-Encoding"} | ({"Content-Encoding": "gzip"} if small else {})
        return web.Response(
            body=packed if small else asset.data, content_type=asset.content_type, charset="utf-8", headers=headers
        )

    return serve
