# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What holds for every request: who asks, how much they may send, how what goes wrong is told."""

from __future__ import annotations

import asyncio
import errno
import hmac
import logging
import time
from collections import Counter
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any

from sqlalchemy.exc import DBAPIError
from sqlalchemy.exc import TimeoutError as PoolTimeout
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response

from curecon_blender.core.base.language import Language, Text
from curecon_blender.core.base.reading import build, parse_json

from . import people
from .configuration import Configuration
from .database import Database
from .operation import Figures
from .people import Person
from .problems import Problem, language_of, why
from .publisher import Publisher
from .sites import Sites
from .store import Store
from .uploads import Uploads

MOST_JSON = 2 << 20
_PATIENCE = 60  # seconds for a body
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_log = logging.getLogger("atlas")


@dataclass(frozen=True)
class Parts:
    """What the server is made of."""

    configuration: Configuration
    database: Database
    store: Store
    uploads: Uploads
    sites: Sites
    publisher: Publisher
    figures: Figures


def parts(request: Request) -> Parts:
    found: Parts = request.app.state.parts
    return found


def cookie_name(configuration: Configuration) -> str:
    return "__Host-atlas" if configuration.secure else "atlas"


def language(request: Request) -> Language:
    return language_of(request.headers.get("accept-language", ""))


async def told(request: Request, problem: Problem) -> JSONResponse:
    wanted = language(request)
    said = await run_in_threadpool(wanted.translated, problem.said)
    headers = {"Content-Language": wanted.tag}
    if "wait" in problem.facts:
        headers["Retry-After"] = str(problem.facts["wait"])
    return JSONResponse({"code": problem.code, "said": said, **problem.facts}, problem.status, headers)


def handled(work: Callable[[Request], Awaitable[Response]]) -> Callable[[Request], Awaitable[Response]]:
    """Turn what went wrong into an answer that says it."""
    async def endpoint(request: Request) -> Response:
        try:
            return await work(request)
        except Problem as problem:
            return await told(request, problem)
        except ClientDisconnect:
            return Response(status_code=400)
        except (DBAPIError, PoolTimeout) as error:
            _log.error("the database does not answer", exc_info=error)
            return await told(request, Problem(
                503, "database", "The atlas cannot reach its records. Nothing is lost: try again.", wait=5))
        except OSError as error:
            _log.error("the store does not answer", exc_info=error)
            if error.errno in _FULL:
                return await told(request, Problem(
                    507, "disk", "The atlas has no room left. Nothing is lost: try again later.", wait=60))
            return await told(request, Problem(
                503, "store", "The atlas cannot reach its files. Nothing is lost: try again.", wait=5))

    endpoint.__name__ = work.__name__
    return endpoint


async def body(request: Request, most: int) -> bytes:
    """Raises Problem before more than `most` bytes are kept."""
    length = request.headers.get("content-length", "")
    if length.isdigit() and int(length) > most:
        raise Problem(413, "too_large", Text("{} bytes; {} are the most.", length, most))
    content = bytearray()
    try:
        async with asyncio.timeout(_PATIENCE):
            async for part in request.stream():
                content += part
                if len(content) > most:
                    raise Problem(413, "too_large", Text("{} bytes; {} are the most.", len(content), most))
    except TimeoutError as error:
        raise Problem(408, "slow", "The request took too long. Send it again.") from error
    if length.isdigit() and len(content) != int(length):
        raise Problem(400, "cut", "The request was cut short. Send it again.")
    return bytes(content)


async def value(request: Request) -> Any:
    """A request's JSON. Raises Problem."""
    if request.headers.get("content-type", "").partition(";")[0].strip() != "application/json":
        raise Problem(415, "json", "A request's body is application/json.")
    content = await body(request, MOST_JSON)
    try:
        return await run_in_threadpool(lambda: parse_json(content.decode()))
    except ValueError as error:
        raise Problem(400, "json", "That is no JSON.") from error


async def record(request: Request, kind: Any) -> Any:
    """A request's JSON as a dataclass. Raises Problem."""
    given = await value(request)
    try:
        return build(kind, given)
    except (ValueError, RecursionError) as error:
        raise Problem(400, "request", Text("That request is none: {}.", why(error))) from error


async def person(request: Request, *, uploads: bool = False) -> Person:
    """Who asks: by a session's cookie and, for what changes something, its guard; or by a token, where it is for
    uploads. Raises Problem."""
    parts_ = parts(request)
    scheme, _, token = request.headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer":
        found = await run_in_threadpool(people.who, parts_.database, token.strip(), people.UPLOAD)
        if found is None:
            raise Problem(401, "token", "This token is not valid, or no longer. Make a new one on your page.")
        if not uploads:
            raise Problem(403, "forbidden", "A token is for uploads alone. Sign in on the atlas's page.")
    else:
        token = request.cookies.get(cookie_name(parts_.configuration), "")
        found = await run_in_threadpool(people.who, parts_.database, token, people.SESSION) if token else None
        if found is None:
            raise Problem(401, "session", "Sign in first.")
        if request.method not in ("GET", "HEAD"):
            _check_guard(request, token)
    request.scope["atlas_account"] = found.id
    return found


def check_origin(request: Request) -> None:
    """Refuse what another site's page asks for. Raises Problem."""
    origin = request.headers.get("origin")
    if origin is not None and origin != parts(request).configuration.address:
        raise Problem(403, "origin", "That request came from another site's page.")


def _check_guard(request: Request, token: str) -> None:
    check_origin(request)
    if not hmac.compare_digest(request.headers.get("x-atlas-guard", "").encode(), people.guard(token).encode()):
        raise Problem(403, "guard", "That request did not come from the atlas's own page. Load the page again.")


class Meter:
    """Counts what costs little, in this process alone: a search is not to wait for the database's one writer."""

    def __init__(self, most: int, seconds: int) -> None:
        self._most, self._seconds = most, seconds
        self._began, self._counts = 0.0, Counter[str]()

    def count(self, who: str) -> None:
        """Raises Problem when there were more than `most` in this span of time."""
        if time.monotonic() - self._began > self._seconds:
            self._began, self._counts = time.monotonic(), Counter()
        self._counts[who] += 1
        if self._counts[who] > self._most:
            raise Problem(
                429, "too_many", "That was tried too often. Wait a while, then try again.", wait=self._seconds
            )


async def rate(request: Request, what: str, most: int, seconds: int) -> None:
    """Raises Problem."""
    await run_in_threadpool(people.rate, parts(request).database, what, most, seconds)


def client(request: Request) -> str:
    return request.client.host if request.client else ""
