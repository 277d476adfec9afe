# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Everything out of an atlas and into another: a backup that either database reads, and the public files as they are.

A backup is a folder: a file of JSON lines for each table, of one state of the database, and every version's files with
their SHA-256. Uploads that are not finished are left out. What is static is made anew when it is restored.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from curecon_blender.core.base.files import atomic_write, partial_path, write_json
from curecon_blender.core.base.reading import build, read_bytes, read_json

from . import words
from .database import MIGRATIONS, Transaction
from .problems import Problem
from .requests import Parts
from .store import HELD, PUBLIC

_TABLES = ("account", "invitation", "token", "site", "version", "version_file", "place", "audit", "survey",
           "answer")  # as they refer
_FORMAT = 1
_MOST_LINE = 8 << 20
_LATEST = max(path.name.partition(".")[0] for path in MIGRATIONS.glob("*.sql"))


def backup(parts: Parts, folder: Path) -> int:
    """Write a backup into a new folder; its number of files. It stands there only when it is whole: a backup that was
    killed is gone on with. Raises Problem, OSError."""
    _check_new(folder)
    partial = partial_path(folder)
    (partial / "tables").mkdir(parents=True, exist_ok=True)
    with parts.database.read() as transaction:
        for table in _TABLES:
            with atomic_write(partial / "tables" / f"{table}.jsonl") as file:
                for row in transaction.all(f"SELECT * FROM {table}"):
                    file.write(json.dumps(dict(row._mapping), ensure_ascii=True).encode() + b"\n")
        files = _files(transaction)
    for version, site, number, path, size, sha256 in files:
        target = partial / "files" / version / path
        if target.is_file() and target.stat().st_size == size:
            continue
        content = _content(parts, version, site, number, path)
        if hashlib.sha256(content).hexdigest() != sha256:
            raise Problem(500, "damaged", f"{path} of version {version} is damaged in the store.")
        target.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(target) as file:
            file.write(content)
    write_json(partial / "backup.json", {"format": _FORMAT, "migration": _LATEST, "files": len(files)})
    partial.rename(folder)
    return len(files)


def _files(transaction: Transaction) -> list[Any]:
    return transaction.all(
        "SELECT version.id, site, number, path, size, sha256 FROM version JOIN version_file ON version_file.version = "
        "version.id WHERE state IN ('held', 'accepted') ORDER BY version.id, path")


def _content(parts: Parts, version: str, site: str, number: int | None, path: str) -> bytes:
    """A version's file, which is held or public."""
    try:
        return parts.store.get(f"{HELD}/{version}/{path}")
    except FileNotFoundError:
        return parts.store.get(f"{PUBLIC}/sites/{site}.{number}/{path}")


def restore(parts: Parts, folder: Path) -> int:
    """Bring a backup into an atlas that is empty; its number of files. Raises Problem, OSError, ValueError."""
    said = read_json(folder / "backup.json")
    if not isinstance(said, dict) or said.get("format") != _FORMAT or said.get("migration") != _LATEST:
        raise Problem(409, "version", f"{folder} is no backup, or one of another version of the atlas.")
    with parts.database.read() as transaction:
        if transaction.value("SELECT count(*) FROM account") or transaction.value("SELECT count(*) FROM site"):
            raise Problem(409, "full", "This atlas is not empty. Restore into a new database and store.")
    rows = {table: _rows(folder / "tables" / f"{table}.jsonl") for table in _TABLES}
    there = {row["id"] for row in rows["version"] if row["state"] in ("held", "accepted")}
    files = [row for row in rows["version_file"] if row["version"] in there]
    for row in files:
        content = read_bytes(folder / "files" / row["version"] / row["path"], row["size"])
        if hashlib.sha256(content).hexdigest() != row["sha256"]:
            raise Problem(500, "damaged", f"{row['path']} of version {row['version']} is damaged in the backup.")
        parts.store.put(f"{HELD}/{row['version']}/{row['path']}", content)
    with parts.database.write() as transaction:
        for table in _TABLES:
            if rows[table]:
                columns = list(rows[table][0])
                names = ", ".join(f":{name}" for name in columns)
                transaction.many(f"INSERT INTO {table} ({', '.join(columns)}) VALUES ({names})", rows[table])
        if not parts.database.is_sqlite:
            transaction.run("SELECT setval('audit_id_seq', (SELECT coalesce(max(id), 1) FROM audit))")
        transaction.run("UPDATE site SET changed = 1 WHERE number IS NOT NULL")
        newest = {(row["site"], row["number"]): row for row in rows["version"]}
        for site in rows["site"]:
            if site["state"] == "public":
                version = newest[site["name"], site["newest"]]
                words.learn_site(transaction, site["name"], json.loads(version["record"]), json.loads(version["about"]))
    return len(files)


def _rows(path: Path) -> list[dict[str, Any]]:
    with path.open("rb") as file:
        return [build(dict, json.loads(line)) for line in iter(lambda: file.readline(_MOST_LINE), b"")]


def export(parts: Parts, folder: Path) -> int:
    """Copy all that is public into a new folder that any web server serves; its number of files. Search then finds what
    the list has loaded. An export that was killed is gone on with. Raises Problem, OSError."""
    _check_new(folder)
    partial = partial_path(folder)
    count = 0
    for name, size in parts.store.names(PUBLIC):
        target = partial / name.removeprefix(f"{PUBLIC}/")
        count += 1
        moving = target.name in ("items.json", "catalog.json", "site.json", "index.html")  # small, and may have changed
        if target.is_file() and target.stat().st_size == size and not moving:
            continue
        content = parts.store.get(name)
        if target == partial / "items.json":
            items = json.loads(content)
            items["links"] = [link for link in items["links"] if link["rel"] != "search"]
            content = json.dumps(items, ensure_ascii=False, separators=(",", ":")).encode()
        target.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(target) as file:
            file.write(content)
    partial.rename(folder)
    return count


def _check_new(folder: Path) -> None:
    if folder.exists():
        raise Problem(409, "exists", f"{folder} is there already. Choose a new folder.")
