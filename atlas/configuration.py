# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The one configuration file, and the limits that hold for what strangers send."""

from __future__ import annotations

import base64
import os
import secrets
import tomllib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import urlsplit

from curecon_blender.core.base.reading import Within, build, read_bytes

_LOOPBACK = ("127.0.0.1", "localhost", "::1")
_MIB = 1 << 20


class ConfigurationError(Exception):
    """The file says what cannot be; the text says what to change."""


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Of an upload and an account. Bytes, but for `files` and `uploads`."""

    files: Annotated[int, Within(1, 100_000)] = 4000
    upload: Annotated[int, Within(1, 1 << 40)] = 600 * _MIB
    account: Annotated[int, Within(1, 1 << 44)] = 4096 * _MIB  # of uploads that are open or held
    uploads: Annotated[int, Within(1, 1000)] = 20  # open or held at a time
    chunk: Annotated[int, Within(1024, 64 * _MIB)] = 4 * _MIB
    days: Annotated[int, Within(1, 365)] = 7  # an upload that nobody goes on with is kept


@dataclass(frozen=True, kw_only=True)
class Configuration:
    """`address` is what visitors type, `listen` HOST:PORT. `places_key` is 32 bytes in base64, empty where exact places
    are not to be kept. `metrics_token` opens /metrics; empty, there is none. `proxies` may say whom they speak for."""

    address: str = "http://127.0.0.1:8017"
    listen: str = "127.0.0.1:8017"
    title: str = "Sites"
    database: str = "sqlite:///atlas.sqlite"
    store: str = "store"
    store_options: dict[str, Any] = field(default_factory=dict)
    places_key: str = ""
    metrics_token: str = ""
    proxies: tuple[str, ...] = ()
    stop_seconds: Annotated[int, Within(1, 600)] = 20
    limits: Limits = Limits()

    @property
    def secure(self) -> bool:
        return self.address.startswith("https://")

    @property
    def host(self) -> str:
        return self.listen.rpartition(":")[0].strip("[]")

    @property
    def port(self) -> int:
        return int(self.listen.rpartition(":")[2])

    @property
    def key(self) -> bytes | None:
        return base64.b64decode(self.places_key) if self.places_key else None


def read(path: Path) -> Configuration:
    """Raises ConfigurationError."""
    try:
        found: Configuration = build(Configuration, tomllib.loads(read_bytes(path, _MIB).decode()))
        _check(found)
    except (OSError, ValueError) as error:
        raise ConfigurationError(f"{path}: {error}") from error
    here = path.absolute().parent
    database = found.database
    if database.startswith("sqlite:///") and not database.startswith("sqlite:////"):
        database = f"sqlite:///{here / database.removeprefix('sqlite:///')}"
    return replace(found, address=found.address.rstrip("/"), database=database,
                   store=found.store if "://" in found.store else str(here / found.store))


def _check(found: Configuration) -> None:
    parts = urlsplit(found.address)
    if parts.scheme not in ("http", "https") or not parts.hostname or parts.path.strip("/") or parts.query:
        raise ValueError("address is to be http(s)://HOST[:PORT], without a path")
    if parts.scheme == "http" and parts.hostname not in _LOOPBACK:
        raise ValueError("address is http: passwords would travel in the clear. Use https")
    if not found.listen.rpartition(":")[2].isdigit() or not found.host:
        raise ValueError("listen is to be HOST:PORT")
    if found.places_key and len(base64.b64decode(found.places_key, validate=True)) != 32:
        raise ValueError("places_key is to be 32 bytes in base64")
    if found.metrics_token and len(found.metrics_token) < 16:
        raise ValueError("metrics_token is to have 16 letters or more")


def write_new(path: Path) -> None:
    """A configuration with a key of its own, that only its owner can read. Raises FileExistsError, OSError."""
    key = base64.b64encode(secrets.token_bytes(32)).decode()
    path.parent.mkdir(parents=True, exist_ok=True)
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8") as file:
        file.write(_NEW.format(key=key))


_NEW = """\
# The atlas's configuration. docs/atlas.md says what else may stand here. Paths count from this file.
address = "http://127.0.0.1:8017"    # what visitors type; https:// for all but this computer
listen = "127.0.0.1:8017"
database = "sqlite:///atlas.sqlite"  # or postgresql+psycopg://USER:PASSWORD@HOST/NAME
store = "store"                      # a folder, or s3://BUCKET/PREFIX

# Exact places that owners leave for officials are sealed with this key. Keep a copy elsewhere: it opens them alone.
places_key = "{key}"
"""
