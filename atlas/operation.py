# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What tells an operator how the server is: a log of one JSON object a line, and figures for Prometheus."""

from __future__ import annotations

import json
import logging
import sys
import time
from typing import Any

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from .database import Database

_log = logging.getLogger("atlas.request")


class _Line(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        said: dict[str, Any] = {"at": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(record.created)),
                                "level": record.levelname.lower(), "logger": record.name, "said": record.getMessage(),
                                **getattr(record, "facts", {})}
        if record.exc_info:
            said["error"] = self.formatException(record.exc_info)
        return json.dumps(said, ensure_ascii=True)  # so that no name of a stranger can begin a line


def start_log() -> None:
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_Line())
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)
    logging.getLogger("uvicorn.access").disabled = True  # addresses of visitors are not kept


class Figures:
    def __init__(self, database: Database) -> None:
        self._database = database
        self._registry = CollectorRegistry()
        self._requests = Counter("atlas_requests", "Requests", ["method", "route", "status"], registry=self._registry)
        self._seconds = Histogram("atlas_request_seconds", "Seconds to the end of an answer", ["route"],
                                  registry=self._registry)
        self.received = Counter("atlas_received_bytes", "Bytes of chunks that were taken", registry=self._registry)
        self._counts = {name: Gauge(f"atlas_{name}", text, registry=self._registry) for name, text, _ in _COUNTS}

    def answered(self, method: str, route: str, status: int, seconds: float) -> None:
        self._requests.labels(method, route, str(status)).inc()
        self._seconds.labels(route).observe(seconds)

    def text(self) -> bytes:
        with self._database.read() as transaction:
            for name, _, statement in _COUNTS:
                self._counts[name].set(transaction.value(statement))
        return generate_latest(self._registry)


_COUNTS = (
    ("sites", "Public sites", "SELECT count(*) FROM site WHERE state = 'public'"),
    ("held", "Versions that wait for a moderator", "SELECT count(*) FROM version WHERE state = 'held'"),
    ("uploads", "Uploads that are open", "SELECT count(*) FROM upload WHERE state = 'open'"),
    ("changed", "Sites whose static files are not written yet", "SELECT count(*) FROM site WHERE changed > 0"),
)


class Watched:
    """Counts and logs each answer, by its route: no query, no token, no visitor's address."""

    def __init__(self, app: ASGIApp, figures: Figures) -> None:
        self._app, self._figures = app, figures

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        began, status = time.perf_counter(), 0

        async def noted(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
            await send(message)

        try:
            await self._app(scope, receive, noted)
        finally:
            seconds = time.perf_counter() - began
            endpoint = scope.get("endpoint")
            route = str(scope.get("route_name") or getattr(endpoint, "__name__", "none"))
            method = scope["method"] if scope["method"] in ("GET", "HEAD", "POST", "PUT", "DELETE") else "other"
            self._figures.answered(method, route, status, seconds)
            if route != "static" or status >= 500:
                _log.info("request", extra={"facts": {"method": method, "route": route, "status": status,
                                                      "seconds": round(seconds, 4),
                                                      "account": scope.get("atlas_account", "")}})
