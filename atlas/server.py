# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The application and the process that serves it."""

from __future__ import annotations

import asyncio
import logging
import sys
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import uvicorn
from starlette.applications import Starlette
from starlette.routing import Mount
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from curecon_blender.core.publish import folder as published

from . import api, static
from .configuration import Configuration
from .database import Database
from .operation import Figures, Watched
from .publisher import Publisher
from .requests import Parts
from .sites import Sites
from .store import PUBLIC, Store
from .uploads import Uploads

_SWEEP = 3600  # seconds
_MOST_CONNECTIONS = 1000
_TURN = 0.0005  # seconds that a thread may compute while the one that answers visitors waits for its turn
_log = logging.getLogger("atlas")


def assemble(configuration: Configuration) -> Parts:
    """What the server, and each command, works with. The database's schema is brought up to date."""
    database = Database(configuration.database)
    database.migrate()
    store = Store(configuration.store, configuration.store_options)
    return Parts(
        configuration=configuration, database=database, store=store,
        uploads=Uploads(database, store, configuration.limits, configuration.key),
        sites=Sites(database, store, configuration.key), publisher=Publisher(configuration, database, store),
        figures=Figures(database))


class _Headed:
    """Puts the headers of safety on every answer."""

    def __init__(self, app: ASGIApp, secure: bool) -> None:
        self._app, self._secure = app, secure

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def headed(message: Message) -> None:
            if message["type"] == "http.response.start":
                given = {name.lower() for name, _ in message["headers"]}
                message["headers"] = [
                    *message["headers"],
                    *(
                        (name.encode(), value.encode())
                        for name, value in static.headers(scope["path"], self._secure).items()
                        if name.lower().encode() not in given
                    ),
                ]
            await send(message)

        await self._app(scope, receive, headed if scope["type"] == "http" else send)


def application(parts: Parts) -> ASGIApp:
    @asynccontextmanager
    async def life(_: Starlette) -> AsyncIterator[None]:
        publishing = threading.Thread(target=parts.publisher.run, name="publisher")
        await asyncio.to_thread(parts.publisher.write_pages)
        publishing.start()
        sweeping = asyncio.create_task(_sweep(parts))
        yield
        sweeping.cancel()
        parts.publisher.stop()
        await asyncio.to_thread(publishing.join)
        await asyncio.to_thread(parts.publisher.release)
        parts.database.close()

    app = Starlette(routes=[
        *api.ROUTES, Mount("/desk", static.desk(), name="desk"),
        Mount("/held/pages", StaticFiles(directory=published.PAGES)), *static.ROUTES], lifespan=life)
    app.state.parts = parts
    if parts.store.is_folder:
        path = parts.store.path(PUBLIC)
        path.mkdir(parents=True, exist_ok=True)
        app.state.files = StaticFiles(directory=path, html=True)
    return Watched(_Headed(app, parts.configuration.secure), parts.figures)


async def _sweep(parts: Parts) -> None:
    while True:
        try:
            await asyncio.to_thread(parts.uploads.sweep)
        except Exception:
            _log.exception("sweeping failed; it is tried again")
        await asyncio.sleep(_SWEEP)


def serve(parts: Parts) -> None:
    """Until the process is told to end; then what is under way is finished first."""
    configuration = parts.configuration
    sys.setswitchinterval(_TURN)
    uvicorn.run(
        application(parts),
        host=configuration.host,
        port=configuration.port,
        log_config=None,
        access_log=False,
        server_header=False,
        proxy_headers=bool(configuration.proxies),
        forwarded_allow_ips=list(configuration.proxies),
        limit_concurrency=_MOST_CONNECTIONS,
        timeout_graceful_shutdown=configuration.stop_seconds,
        h11_max_incomplete_event_size=16384,
    )
