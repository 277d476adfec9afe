# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Uploads in chunks that can be cut anywhere and gone on with, and what becomes of them: a version that is held.

A chunk counts when the database has its row; until then its object in the store is litter that `sweep` removes. A
file's chunks lie one behind the other, so that where to go on is one number.
"""

from __future__ import annotations

import hashlib
import json
import secrets
from dataclasses import asdict
from typing import Any

from sqlalchemy import Row

from curecon_blender.core.base.language import Text

from . import checks, records, sealing
from .checks import File
from .configuration import Limits
from .database import Database, Transaction, identity, now
from .people import Person, note
from .problems import Problem, refused
from .store import HELD, INCOMING, Store

_RECORD = "site.json"  # the database has what it says
_LONGEST_CHECK = 3600  # seconds


class Uploads:
    def __init__(self, database: Database, store: Store, limits: Limits, key: bytes | None) -> None:
        self._database, self._store, self._limits, self._key = database, store, limits, key

    def begin(self, person: Person, value: Any) -> dict[str, Any]:
        """An upload of the files that `value` lists: a new one, or the open one of the same files. What is added is as
        it was said last. Raises Problem."""
        if not isinstance(value, dict) or not set(value) <= {"files", "added"}:
            raise Problem(400, "request", "An upload begins with files and what is added.")
        files = checks.manifest(value.get("files"), self._limits)
        added = records.added(value.get("added", {}))
        if added.exact and self._key is None:
            raise Problem(409, "no_key", "This atlas keeps no exact places. Leave the place out, then upload again.")
        about = json.dumps(self._sealed(asdict(added)), ensure_ascii=False)
        digest = hashlib.sha256(json.dumps([asdict(file) for file in files]).encode()).hexdigest()
        size = sum(file.size for file in files)
        with self._database.write() as transaction:
            row = transaction.one("SELECT id FROM upload WHERE account = :account AND digest = :digest AND state = "
                                  "'open'",
                                  account=person.id, digest=digest)
            if row:
                transaction.run(
                    "UPDATE upload SET about = :about, touched = :now WHERE id = :id", about=about, now=now(), id=row.id
                )
                return self._told(transaction, row.id)
            self._check_room(transaction, person, size)
            upload = identity()
            transaction.run("INSERT INTO upload VALUES (:id, :account, :digest, 'open', :about, :bytes, :now, :now, "
                            "NULL)",
                            id=upload, account=person.id, digest=digest, about=about, bytes=size, now=now())
            transaction.many(
                "INSERT INTO upload_file VALUES (:upload, :number, :path, :size, :sha256, 0)",
                [{"upload": upload, "number": number, **asdict(file)} for number, file in enumerate(files)])
            note(transaction, person.id, "upload", upload, f"{len(files)} files, {size} bytes")
            return self._told(transaction, upload)

    def _sealed(self, added: dict[str, Any]) -> dict[str, Any]:
        place = added.pop("exact")
        return {**added, "sealed": None if place is None or self._key is None else sealing.seal(self._key, place)}

    def _check_room(self, transaction: Transaction, person: Person, size: int) -> None:
        open_, open_bytes = transaction.one(  # type: ignore[misc]
            "SELECT count(*), coalesce(sum(bytes), 0) FROM upload WHERE account = :id AND state = 'open'", id=person.id)
        held, held_bytes = transaction.one(  # type: ignore[misc]
            "SELECT count(*), coalesce(sum(bytes), 0) FROM version WHERE account = :id AND state = "
            "'held'", id=person.id)
        if open_ + held >= self._limits.uploads or open_bytes + held_bytes + size > self._limits.account:
            raise Problem(409, "full", "You have as many uploads open or held as there may be. Withdraw one, or wait "
                                       "until a moderator has decided.")

    def _own(self, transaction: Transaction, person: Person, upload: str) -> Row[Any]:
        """Another's upload is as one that never was."""
        row = transaction.one(
            "SELECT * FROM upload WHERE id = :id AND account = :account", id=upload, account=person.id
        )
        if row is None:
            raise Problem(404, "unknown", "There is no such upload of yours.")
        return row

    def _told(self, transaction: Transaction, upload: str) -> dict[str, Any]:
        rows = transaction.all("SELECT path, size, received FROM upload_file WHERE upload = :upload ORDER BY number",
                               upload=upload)
        return {"upload": upload, "chunk": self._limits.chunk,
                "files": [{"path": row.path, "size": row.size, "received": row.received} for row in rows]}

    def state(self, person: Person, upload: str) -> dict[str, Any]:
        with self._database.read() as transaction:
            row = self._own(transaction, person, upload)
            return {**self._told(transaction, upload), "state": row.state, "version": row.version}

    def add(self, person: Person, upload: str, number: int, start: int, content: bytes) -> int:
        """Take a chunk of the upload's file `number` that begins at byte `start`; where the next one begins. Raises
        Problem: 409 where another one is due, which it tells."""
        if not content or len(content) > self._limits.chunk:
            raise Problem(413, "too_large", Text("A chunk has 1 to {} bytes.", self._limits.chunk))
        with self._database.read() as transaction:
            self._due(transaction, person, upload, number, start, len(content), lock="")
        name = f"{INCOMING}/{upload}/{number}/{start}-{secrets.token_hex(6)}"
        self._store.put(name, content)
        try:
            with self._database.write() as transaction:
                lock = "" if self._database.is_sqlite else " FOR UPDATE"
                self._due(transaction, person, upload, number, start, len(content), lock=lock)
                transaction.run("INSERT INTO chunk VALUES (:upload, :number, :start, :size, :object)", upload=upload,
                                number=number, start=start, size=len(content), object=name)
                transaction.run("UPDATE upload_file SET received = :end WHERE upload = :upload AND number = :number",
                                end=start + len(content), upload=upload, number=number)
                transaction.run("UPDATE upload SET touched = :now WHERE id = :upload", now=now(), upload=upload)
        except BaseException:
            self._store.remove(name)
            raise
        return start + len(content)

    def _due(
        self, transaction: Transaction, person: Person, upload: str, number: int, start: int, size: int, *, lock: str
    ) -> None:
        row = self._own(transaction, person, upload)
        file = transaction.one("SELECT size, received FROM upload_file WHERE upload = :upload AND number = :number"
                               + lock, upload=upload, number=number)
        if file is None or row.state != "open":
            raise Problem(404, "unknown", "There is no such file in this upload.")
        if start != file.received:
            raise Problem(
                409, "offset", Text("The next chunk of this file begins at {}.", file.received), offset=file.received
            )
        if start + size > file.size:
            raise Problem(413, "too_large", "The file is larger than its entry in the list said.")

    def finish(self, person: Person, upload: str) -> dict[str, Any]:
        """Put the files together, check them, and hold them as a version of their site. An upload whose files are
        refused is gone. Raises Problem."""
        with self._database.read() as transaction:
            row = self._own(transaction, person, upload)
            if row.state == "done":
                return self._done(transaction, upload)
            missing = transaction.value("SELECT count(*) FROM upload_file WHERE upload = :id AND received < "
                                        "size", id=upload)
            if missing:
                raise Problem(409, "incomplete", Text("{} files are not whole yet.", missing))
            files = tuple(File(path=file.path, size=file.size, sha256=file.sha256) for file in transaction.all(
                "SELECT path, size, sha256 FROM upload_file WHERE upload = :id ORDER BY number", id=upload))
            chunks: dict[str, list[str]] = {}
            for chunk in transaction.all(
                    "SELECT path, object FROM chunk JOIN upload_file ON upload_file.upload = chunk.upload AND "
                    "upload_file.number = chunk.number WHERE chunk.upload = :id ORDER BY chunk.number, "
                    "start", id=upload):
                chunks.setdefault(chunk.path, []).append(chunk.object)
        version = identity()
        with self._database.write() as transaction:  # so that `sweep` leaves the version's files alone meanwhile
            transaction.run("INSERT INTO lease VALUES (:name, :id, :ends)", name=f"hold/{version}", id=upload,
                            ends=now() + _LONGEST_CHECK)
        try:
            site, doubts = checks.check(files, lambda file: self._together(file, chunks[file.path], version))
        except Problem as problem:
            self._store.remove_folder(f"{HELD}/{version}")
            if problem.code == "refused":
                self._drop(person.id, upload, problem.said)
            raise
        except FileNotFoundError:  # the same request, made twice at once: the other one was done with the chunks
            self._store.remove_folder(f"{HELD}/{version}")
            with self._database.read() as transaction:
                if self._own(transaction, person, upload).state == "done":
                    return self._done(transaction, upload)
            raise
        except BaseException:
            self._store.remove_folder(f"{HELD}/{version}")
            raise
        return self._hold(person, row, files, version, site, doubts)

    @staticmethod
    def _done(transaction: Transaction, upload: str) -> dict[str, Any]:
        row = transaction.one("SELECT version.id AS version, site, doubts FROM upload JOIN version ON version.id = "
                              "upload.version WHERE upload.id = :id", id=upload)
        assert row is not None
        return {"version": row.version, "site": row.site, "doubts": json.loads(row.doubts)}

    def _together(self, file: File, objects: list[str], version: str) -> bytes:
        content = b"".join(map(self._store.get, objects))
        if len(content) != file.size or hashlib.sha256(content).hexdigest() != file.sha256:
            raise refused(Text("{} is not what its SHA-256 says. Upload it again.", file.path))
        self._store.put(f"{HELD}/{version}/{file.path}", content)
        return content

    def _hold(
        self, person: Person, upload: Row[Any], files: tuple[File, ...], version: str, site: records.Site,
        doubts: list[str],
    ) -> dict[str, Any]:
        size = sum(file.size for file in files)
        with self._database.write() as transaction:
            if not transaction.run("UPDATE upload SET state = 'done', version = :version WHERE id = :id AND state = "
                                   "'open'",
                                   version=version, id=upload.id):
                self._store.remove_folder(f"{HELD}/{version}")  # the same request, made twice at once
                return self._done(transaction, upload.id)
            name = self._name(transaction, person, site.id)
            transaction.run(
                "INSERT INTO version VALUES (:id, :site, NULL, 'held', :account, :now, NULL, NULL, '', :record, "
                ":about, :doubts, "
                ":bytes)", id=version, site=name, account=person.id, now=now(), bytes=size, about=upload.about,
                record=json.dumps(site.as_json(), ensure_ascii=False), doubts=json.dumps(doubts))
            transaction.many("INSERT INTO version_file VALUES (:version, :path, :size, :sha256)",
                             [{"version": version, **asdict(file)} for file in files if file.path != _RECORD])
            transaction.run("DELETE FROM chunk WHERE upload = :id", id=upload.id)
            transaction.run("DELETE FROM upload_file WHERE upload = :id", id=upload.id)
            note(transaction, person.id, "hold", version, name)
        self._store.remove_folder(f"{INCOMING}/{upload.id}")
        return {"version": version, "site": name, "doubts": doubts}

    @staticmethod
    def _name(transaction: Transaction, person: Person, wanted: str) -> str:
        """The site's name, for good: the one that it asks for, unless that is another's."""
        name = wanted
        while True:
            row = transaction.one("SELECT owner, state FROM site WHERE name = :name", name=name)
            if row is None:
                transaction.run(
                    "INSERT INTO site (name, owner, state, newest, made, why, title, place, tags, register, feature, "
                    "changed) VALUES (:name, :owner, 'new', 0, :now, '', '', '', '[]', '', '{}', "
                    "0)", name=name, owner=person.id,
                    now=now())
                return name
            if row.owner == person.id and row.state != "removed":
                return name
            name = f"{wanted}-{secrets.token_hex(3)}"

    def _drop(self, account: str, upload: str, why: str) -> None:
        with self._database.write() as transaction:
            for table in ("chunk", "upload_file"):
                transaction.run(f"DELETE FROM {table} WHERE upload = :id", id=upload)
            transaction.run("DELETE FROM upload WHERE id = :id", id=upload)
            note(transaction, account, "drop", upload, why)
        self._store.remove_folder(f"{INCOMING}/{upload}")

    def drop(self, person: Person, upload: str) -> None:
        """Give up an open upload. Raises Problem."""
        with self._database.read() as transaction:
            if self._own(transaction, person, upload).state != "open":
                raise Problem(409, "done", "This upload is done: withdraw its version.")
        self._drop(person.id, upload, "")

    def sweep(self) -> None:
        """Remove what nobody goes on with, and what a killed server left in the store."""
        with self._database.read() as transaction:
            old = transaction.all("SELECT id, account FROM upload WHERE state = 'open' AND touched < :then",
                                  then=now() - 86400 * self._limits.days)
        for row in old:
            self._drop(row.account, row.id, "nobody went on with it")
        folders = {kind: self._store.folders(kind) for kind in (INCOMING, HELD)}
        with self._database.read() as transaction:  # after the listing: what came since is known
            uploads = {row.id for row in transaction.all("SELECT id FROM upload WHERE state = 'open'")}
            versions = {row.id for row in transaction.all("SELECT id FROM version WHERE state IN ('held', 'accepted')")}
            versions |= {row.name.removeprefix("hold/") for row in transaction.all(
                "SELECT name FROM lease WHERE name LIKE 'hold/%' AND ends > :now", now=now())}
        with self._database.write() as transaction:
            transaction.run("DELETE FROM lease WHERE name LIKE 'hold/%' AND ends <= :now", now=now())
            transaction.run("DELETE FROM token WHERE ends <= :now", now=now())
            transaction.run("DELETE FROM rate WHERE began < :then", then=now() - 86400)
        for name in set(folders[INCOMING]) - uploads:
            self._store.remove_folder(f"{INCOMING}/{name}")
        for name in set(folders[HELD]) - versions:
            self._store.remove_folder(f"{HELD}/{name}")
