# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Files as they are: what the public sees, the pages of people with an account, and what is held, for who may see it. A
web server or a CDN can serve the public ones in the atlas's place."""

from __future__ import annotations

import hashlib
import json
import mimetypes
import re
from pathlib import Path

from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.staticfiles import StaticFiles

from curecon_blender.core.publish import folder as published

from .problems import Problem
from .requests import handled, parts, person
from .store import HELD, PUBLIC

DESK = Path(__file__).parent / "desk"
_NAME = re.compile(r"(?:[A-Za-z0-9_-][A-Za-z0-9_.-]*/)*(?:[A-Za-z0-9_-][A-Za-z0-9_.-]*)?")
_TYPES = {".js": "text/javascript", ".glb": "model/gltf-binary", ".json": "application/json", ".xml": "application/xml"}
_POLICY = ("default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; media-src 'self'; "
           "connect-src 'self' blob:; worker-src 'self'; "
           "frame-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors {}")
_SECURITY = {"X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer",
             "Cross-Origin-Opener-Policy": "same-origin",
             "Permissions-Policy": "camera=(), microphone=(), geolocation=(), payment=()"}
_RANGE = re.compile(r"bytes=(\d{1,15})-(\d{0,15})")
_PIECE = 1 << 20  # bytes
_VERSION = re.compile(r"sites/[a-z0-9-]+\.\d+/.+\.(glb|jpg|mp4)")
for _end, _type in _TYPES.items():
    mimetypes.add_type(_type, _end)


def headers(path: str, secure: bool) -> dict[str, str]:
    """What goes with an answer at a path. Sites may be shown within others' pages, what is held within
    the atlas's own; nothing else may."""
    framed = "*" if path.startswith("/sites/") else "'self'" if path.startswith("/held/") else "'none'"
    found = {**_SECURITY, "Content-Security-Policy": _POLICY.format(framed)}
    if secure:
        found["Strict-Transport-Security"] = "max-age=31536000"
    if path.startswith(("/api/", "/held/", "/metrics", "/health")):
        found["Cache-Control"] = "no-store"
    elif path.startswith("/desk/"):
        found["Cache-Control"] = "no-cache"
    elif _VERSION.fullmatch(path[1:]):
        found["Cache-Control"] = "public, max-age=86400"
    else:
        found["Cache-Control"] = "public, max-age=60"
    return found


async def public(request: Request) -> Response:
    request.scope["route_name"] = "static"
    name = request.path_params["path"]
    if not _NAME.fullmatch(name) or len(name) > 300:
        raise HTTPException(404)
    store = parts(request).store
    if store.is_folder:
        files: StaticFiles = request.app.state.files
        return await files.get_response(name or ".", request.scope)
    return await _of_store(request, f"{PUBLIC}/{name}")


async def _of_store(request: Request, name: str) -> Response:
    if name.endswith("/"):
        name += "index.html"
    if name.endswith(".mp4"):
        return await _film(request, name)
    try:
        content = await run_in_threadpool(parts(request).store.get, name)
    except (FileNotFoundError, IsADirectoryError) as error:
        if "." not in name.rpartition("/")[2] and not request.url.path.endswith("/"):
            return RedirectResponse(request.url.path + "/", 307)
        raise HTTPException(404) from error
    etag = f'"{hashlib.sha256(content).hexdigest()[:32]}"'
    if request.headers.get("if-none-match") == etag:
        return Response(status_code=304, headers={"ETag": etag})
    return Response(
        content, media_type=mimetypes.guess_type(name)[0] or "application/octet-stream", headers={"ETag": etag}
    )


async def _film(request: Request, name: str) -> Response:
    """A film in pieces, from wherever a player wants it: it may be larger than memory should hold for each visitor."""
    store = parts(request).store
    try:
        size = await run_in_threadpool(store.size, name)
    except FileNotFoundError as error:
        raise HTTPException(404) from error
    wanted = _RANGE.fullmatch(request.headers.get("range", ""))
    start, end = (int(wanted[1]), int(wanted[2] or size - 1) + 1) if wanted else (0, size)
    end = min(end, size)
    if start >= end:
        return Response(status_code=416, headers={"Content-Range": f"bytes */{size}"})
    pieces = (store.part(name, at, min(at + _PIECE, end)) for at in range(start, end, _PIECE))
    return StreamingResponse(pieces, 206 if wanted else 200, media_type="video/mp4", headers={
        "Accept-Ranges": "bytes", "Content-Length": str(end - start),
        **({"Content-Range": f"bytes {start}-{end - 1}/{size}"} if wanted else {})})


async def held(request: Request) -> Response:
    """A version that waits for a moderator, in the viewer: its pages lie as a site's do."""
    version, name = request.path_params["version"], request.path_params["path"]
    if not _NAME.fullmatch(name) or not re.fullmatch(r"[0-9a-f]{20}", version):
        raise Problem(404, "unknown", "There is nothing here.")
    found = await person(request)
    if not await run_in_threadpool(parts(request).sites.may_see, found, version):
        raise Problem(404, "unknown", "There is no such version, or it is not for you to see.")
    if name in ("", "index.html"):
        return Response((published.PAGES / "site.html").read_bytes(), media_type="text/html")
    if name == "site.json":
        record = await run_in_threadpool(parts(request).sites.record, version)
        return Response(
            json.dumps(record, ensure_ascii=False).encode("utf-8", "replace"), media_type="application/json"
        )
    return await _of_store(request, f"{HELD}/{version}/{name}")


async def back(_: Request) -> Response:
    """Where a held version's page leads to the map."""
    return RedirectResponse("/desk/", 307)


def desk() -> StaticFiles:
    return StaticFiles(directory=DESK, html=True)


ROUTES = [
    Route("/held/index.html", back),
    Route("/held/sites/{version}/{path:path}", handled(held), methods=["GET"]),
    Route("/{path:path}", public, methods=["GET"]),
]
