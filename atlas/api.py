# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the server answers to beside static files. Everything is JSON; docs/atlas.md lists the addresses."""

from __future__ import annotations

import asyncio
import hmac
import os
from dataclasses import dataclass
from typing import Annotated, Any

from anyio import CapacityLimiter, to_thread
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from . import people, surveys, words
from .problems import Problem
from .records import Words
from .requests import (
    Meter,
    body,
    check_origin,
    client,
    cookie_name,
    handled,
    language,
    parts,
    person,
    rate,
    record,
    value,
)

_QUARTER = 900  # seconds
_searches = Meter(300, 300)
_answers = Meter(20, 3600)
# Threads of their own, so that uploads, which wait for disks, never keep a visitor waiting for one; and so few for
# checks that many uploads that end at once take no more memory than two, and leave visitors a processor.
_uploading, _checking = CapacityLimiter(8), CapacityLimiter(1 if (os.cpu_count() or 1) < 4 else 2)
_checks: dict[tuple[str, str], asyncio.Future[dict[str, Any]]] = {}  # under way, by account and upload


@dataclass(frozen=True, kw_only=True)
class _SignIn:
    name: str
    password: str


@dataclass(frozen=True, kw_only=True)
class _Join(_SignIn):
    token: str


@dataclass(frozen=True, kw_only=True)
class _Passwords:
    old: str
    new: str


@dataclass(frozen=True, kw_only=True)
class _Label:
    label: Annotated[str, Words(80)] = ""


@dataclass(frozen=True, kw_only=True)
class _Role:
    role: str


@dataclass(frozen=True, kw_only=True)
class _Why:
    why: Annotated[str, Words(2000)] = ""


# ---- people

async def join(request: Request) -> Response:
    check_origin(request)
    await rate(request, f"join {client(request)}", 20, _QUARTER)
    given: _Join = await record(request, _Join)
    await run_in_threadpool(people.join, parts(request).database, given.token, given.name, given.password)
    return await _signed_in(request, given)


async def sign_in(request: Request) -> Response:
    check_origin(request)
    await rate(request, f"sign_in {client(request)}", 40, _QUARTER)
    given: _SignIn = await record(request, _SignIn)
    await rate(request, f"sign_in {people.digest(given.name.casefold())[:16]}", 10, _QUARTER)
    return await _signed_in(request, given)


async def _signed_in(request: Request, given: _SignIn) -> Response:
    configuration = parts(request).configuration
    token = await run_in_threadpool(people.sign_in, parts(request).database, given.name, given.password)
    answer = JSONResponse({"guard": people.guard(token)})
    answer.set_cookie(cookie_name(configuration), token, httponly=True, secure=configuration.secure, samesite="strict",
                      path="/")
    return answer


async def sign_out(request: Request) -> Response:
    await person(request)
    name = cookie_name(parts(request).configuration)
    token = request.cookies[name]

    def work() -> None:
        with parts(request).database.write() as transaction:
            transaction.run("DELETE FROM token WHERE digest = :digest", digest=people.digest(token))

    await run_in_threadpool(work)
    answer = JSONResponse({})
    answer.delete_cookie(name, path="/", secure=parts(request).configuration.secure, httponly=True, samesite="strict")
    return answer


async def me(request: Request) -> Response:
    """Also the guard, which a page needs after it was loaded again: another site's page cannot read the answer."""
    found = await person(request)
    token = request.cookies[cookie_name(parts(request).configuration)]
    return JSONResponse({"id": found.id, "name": found.name, "role": found.role, "guard": people.guard(token),
                         "places": parts(request).configuration.key is not None})


async def password(request: Request) -> Response:
    found = await person(request)
    given: _Passwords = await record(request, _Passwords)
    await rate(request, f"password {found.id}", 10, _QUARTER)
    await run_in_threadpool(people.change_password, parts(request).database, found, given.old, given.new)
    return JSONResponse({})


async def invite(request: Request) -> Response:
    found = await person(request)
    found.require(people.MODERATOR)
    given: _Role = await record(request, _Role)

    def work() -> str:
        with parts(request).database.write() as transaction:
            return people.invite(transaction, given.role, found.id)

    token = await run_in_threadpool(work)
    return JSONResponse({"link": f"{parts(request).configuration.address}/desk/#join={token}"})


async def accounts(request: Request) -> Response:
    (await person(request)).require(people.MODERATOR)

    def work() -> list[dict[str, Any]]:
        with parts(request).database.read() as transaction:
            return people.accounts(transaction)

    return JSONResponse({"accounts": await run_in_threadpool(work)})


async def close(request: Request) -> Response:
    found = await person(request)

    def work() -> None:
        with parts(request).database.write() as transaction:
            people.close(transaction, found, request.path_params["id"])

    await run_in_threadpool(work)
    return JSONResponse({})


async def tokens(request: Request) -> Response:
    found = await person(request)
    label = "" if request.method == "GET" else (await record(request, _Label)).label

    def work() -> object:
        with parts(request).database.write() as transaction:
            if request.method == "GET":
                return {"tokens": people.tokens(transaction, found.id)}
            if len(people.tokens(transaction, found.id)) >= 20:
                raise Problem(409, "full", "You have 20 tokens. End one first.")
            people.note(transaction, found.id, "token", label)
            return {"token": people.give(transaction, found.id, people.UPLOAD, label)}

    return JSONResponse(await run_in_threadpool(work))


async def revoke(request: Request) -> Response:
    found = await person(request)

    def work() -> None:
        with parts(request).database.write() as transaction:
            people.revoke(transaction, found.id, request.path_params["id"])

    await run_in_threadpool(work)
    return JSONResponse({})


# ---- uploads

async def begin(request: Request) -> Response:
    found = await person(request, uploads=True)
    await rate(request, f"begin {found.id}", 240, 3600)
    return JSONResponse(await run_in_threadpool(parts(request).uploads.begin, found, await value(request)))


async def upload(request: Request) -> Response:
    found = await person(request, uploads=True)
    work = parts(request).uploads.drop if request.method == "DELETE" else parts(request).uploads.state
    return JSONResponse(await run_in_threadpool(work, found, request.path_params["id"]) or {})


async def chunk(request: Request) -> Response:
    found = await person(request, uploads=True)
    start = request.query_params.get("start", "")
    if not start.isdecimal() or len(start) > 15:
        raise Problem(400, "request", "start is the byte that the chunk begins at.")
    content = await body(request, parts(request).configuration.limits.chunk)
    received = await to_thread.run_sync(parts(request).uploads.add, found, request.path_params["id"],
                                        request.path_params["number"], int(start), content, limiter=_uploading)
    parts(request).figures.received.inc(len(content))
    return JSONResponse({"received": received})


async def finish(request: Request) -> Response:
    """Who asks again while an upload is checked waits for the same check, however often the connection was lost."""
    found = await person(request, uploads=True)
    asked = found.id, request.path_params["id"]
    if asked not in _checks:
        _checks[asked] = asyncio.ensure_future(to_thread.run_sync(parts(request).uploads.finish, found, asked[1],
                                                                  limiter=_checking))
        _checks[asked].add_done_callback(lambda done: (_checks.pop(asked), done.cancelled() or done.exception()))
    return JSONResponse(await asyncio.shield(_checks[asked]))


# ---- sites

async def mine(request: Request) -> Response:
    return JSONResponse(await run_in_threadpool(parts(request).sites.mine, await person(request)))


async def withdraw(request: Request) -> Response:
    found = await person(request)
    await run_in_threadpool(parts(request).sites.withdraw, found, request.path_params["id"])
    return JSONResponse({})


async def remove(request: Request) -> Response:
    found = await person(request)
    given: _Why = await record(request, _Why)
    await run_in_threadpool(parts(request).sites.remove, found, request.path_params["name"], given.why)
    parts(request).publisher.wake()
    return JSONResponse({})


async def held(request: Request) -> Response:
    (await person(request)).require(people.MODERATOR)
    return JSONResponse({"held": await run_in_threadpool(parts(request).sites.held, language(request))})


async def accept(request: Request) -> Response:
    found = await person(request)
    name = await run_in_threadpool(parts(request).sites.accept, found, request.path_params["id"])
    parts(request).publisher.wake()
    return JSONResponse({"site": name})


async def refuse(request: Request) -> Response:
    found = await person(request)
    given: _Why = await record(request, _Why)
    await run_in_threadpool(parts(request).sites.refuse, found, request.path_params["id"], given.why)
    return JSONResponse({})


async def audit(request: Request) -> Response:
    found = await person(request)
    before = request.query_params.get("before", "")
    lines = await run_in_threadpool(parts(request).sites.audit, found, int(before) if before.isdecimal() else None)
    return JSONResponse({"lines": lines})


async def place(request: Request) -> Response:
    found = await person(request)
    await rate(request, f"place {found.id}", 60, 3600)
    return JSONResponse(await run_in_threadpool(parts(request).sites.place, found, request.path_params["name"]))


async def search(request: Request) -> Response:
    _searches.count(client(request))
    asked = {name: request.query_params[name] for name in ("q", "tag", "register", "from", "to", "box", "page")
             if request.query_params.get(name)}
    found = await run_in_threadpool(words.search, parts(request).database, asked)
    return JSONResponse(found, headers={"Cache-Control": "public, max-age=300"})


# ---- surveys

async def answer(request: Request) -> Response:
    """From a page of whatever place, or of none; nobody's cookies are asked for."""
    _answers.count(client(request))
    content = await body(request, surveys.MOST_BYTES)
    await run_in_threadpool(surveys.add, parts(request).database, request.path_params["name"], content)
    return JSONResponse({}, headers={"Access-Control-Allow-Origin": "*"})


async def answers(request: Request) -> Response:
    (await person(request)).require(people.MODERATOR)
    table = await run_in_threadpool(surveys.answers, parts(request).database, request.path_params["name"])
    return Response(table, media_type="text/csv", headers={"Content-Disposition": "attachment"})


# ---- operation

async def health(request: Request) -> Response:
    def work() -> None:
        with parts(request).database.read() as transaction:
            transaction.value("SELECT count(*) FROM migration")
        parts(request).store.size("public/index.html")

    await run_in_threadpool(work)
    return JSONResponse({"status": "ok"})


async def metrics(request: Request) -> Response:
    wanted = parts(request).configuration.metrics_token
    given = request.headers.get("authorization", "").removeprefix("Bearer ")
    if not wanted or not hmac.compare_digest(given.encode(), wanted.encode()):
        raise Problem(404, "unknown", "There is nothing here.")
    return Response(await run_in_threadpool(parts(request).figures.text), media_type="text/plain; version=0.0.4")


ROUTES = [
    Route(path, handled(work), methods=[method])
    for method, path, work in (
        ("POST", "/api/join", join),
        ("POST", "/api/session", sign_in),
        ("DELETE", "/api/session", sign_out),
        ("GET", "/api/me", me),
        ("POST", "/api/password", password),
        ("POST", "/api/invitations", invite),
        ("GET", "/api/accounts", accounts),
        ("DELETE", "/api/accounts/{id}", close),
        ("GET", "/api/tokens", tokens),
        ("POST", "/api/tokens", tokens),
        ("DELETE", "/api/tokens/{id}", revoke),
        ("POST", "/api/uploads", begin),
        ("GET", "/api/uploads/{id}", upload),
        ("DELETE", "/api/uploads/{id}", upload),
        ("PUT", "/api/uploads/{id}/{number:int}", chunk),
        ("POST", "/api/uploads/{id}/finish", finish),
        ("GET", "/api/mine", mine),
        ("DELETE", "/api/versions/{id}", withdraw),
        ("POST", "/api/sites/{name}/remove", remove),
        ("GET", "/api/held", held),
        ("POST", "/api/versions/{id}/accept", accept),
        ("POST", "/api/versions/{id}/refuse", refuse),
        ("GET", "/api/audit", audit),
        ("GET", "/api/sites/{name}/place", place),
        ("GET", "/api/search", search),
        ("POST", "/api/surveys/{name}/answers", answer),
        ("GET", "/api/surveys/{name}/answers", answers),
        ("GET", "/health", health),
        ("GET", "/metrics", metrics),
    )
]
