# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Sites and their versions: what is held, what moderators decide, what contributors take out again."""

from __future__ import annotations

import json
from datetime import date
from typing import Any

from sqlalchemy import Row

from curecon_blender.core.base.language import Language, Text
from curecon_blender.core.base.reading import build
from curecon_blender.core.publish import folder as published
from curecon_blender.core.publish.privacy import Shown

from . import quadkeys, sealing, words
from .database import Database, Transaction, now
from .people import MODERATOR, OFFICIAL, Person, note
from .problems import Problem
from .records import Site
from .store import HELD, Store

_LISTED = 200


class Sites:
    def __init__(self, database: Database, store: Store, key: bytes | None) -> None:
        self._database, self._store, self._key = database, store, key

    # ---- moderators

    def held(self, language: Language) -> list[dict[str, Any]]:
        with self._database.read() as transaction:
            found = [_told(row) for row in transaction.all(
                "SELECT version.*, account.name AS by_name FROM version JOIN account ON account.id = version.account "
                f"WHERE version.state = 'held' ORDER BY version.made LIMIT {_LISTED}")]
        return [{**one, "doubts": [*map(language.translated, one["doubts"])]} for one in found]

    def accept(self, person: Person, version: str) -> str:
        """Make a held version its site's newest; the site's name. Raises Problem."""
        person.require(MODERATOR)
        with self._database.write() as transaction:
            transaction.alone()
            row = self._decide(transaction, person, version, "accepted", "")
            site = transaction.one("SELECT * FROM site WHERE name = :name", name=row.site)
            assert site is not None
            if site.state == "removed":
                raise Problem(409, "removed", "This site was taken down meanwhile.")
            number = site.newest + 1
            transaction.run("UPDATE version SET number = :number WHERE id = :id", number=number, id=version)
            sequence = site.number
            if sequence is None:
                sequence = transaction.value("SELECT coalesce(max(number), -1) + 1 FROM site")
            enter(transaction, row.site, json.loads(row.record), json.loads(row.about), sequence, number)
        return str(row.site)

    def refuse(self, person: Person, version: str, why: str) -> None:
        """Raises Problem."""
        person.require(MODERATOR)
        if not why.strip():
            raise Problem(400, "why", "Say why: the contributor reads it.")
        with self._database.write() as transaction:
            transaction.alone()
            self._decide(transaction, person, version, "refused", why)
        self._store.remove_folder(f"{HELD}/{version}")

    def _decide(self, transaction: Transaction, person: Person, version: str, state: str, why: str) -> Row[Any]:
        """Of two who decide at once, the second is told of the first."""
        changed = transaction.run(
            "UPDATE version SET state = :state, decided = :now, decided_by = :by, why = :why WHERE id = :id AND state "
            "= 'held'", state=state, now=now(), by=person.id, why=why, id=version)
        row = transaction.one(
            "SELECT version.*, account.name AS by_name FROM version LEFT JOIN account ON account.id = "
            "version.decided_by WHERE version.id = :id", id=version)
        if row is None:
            raise Problem(404, "unknown", "There is no such version.")
        if not changed:
            raise Problem(409, "decided", Text("This version was {} already, by {}.", Text(row.state),
                                               row.by_name or Text("its contributor")))
        note(transaction, person.id, state, version, f"{row.site} {why}".strip())
        return row

    def audit(self, person: Person, before: int | None) -> list[dict[str, Any]]:
        """The newest lines of the audit log, or those before one."""
        person.require(MODERATOR)
        with self._database.read() as transaction:
            rows = transaction.all(
                "SELECT audit.*, name FROM audit LEFT JOIN account ON account.id = audit.account WHERE audit.id < "
                ":before "
                f"ORDER BY audit.id DESC LIMIT {_LISTED}", before=before or 1 << 60)
            return [{"id": row.id, "at": row.at, "by": row.name or row.account, "action": row.action,
                     "subject": row.subject, "detail": row.detail} for row in rows]

    # ---- contributors

    def mine(self, person: Person) -> dict[str, Any]:
        with self._database.read() as transaction:
            versions = transaction.all(
                "SELECT version.*, account.name AS by_name FROM version JOIN account ON account.id = version.account "
                "WHERE "
                f"version.account = :id ORDER BY version.made DESC LIMIT {_LISTED}", id=person.id)
            sites = transaction.all("SELECT name, state, title, newest, why, removed FROM site WHERE owner = :id AND "
                                    "state "
                                    f"<> 'new' ORDER BY made DESC LIMIT {_LISTED}", id=person.id)
            uploads = transaction.all("SELECT id, bytes, made FROM upload WHERE account = :id AND state = 'open' ORDER "
                                      "BY made DESC", id=person.id)
        return {"versions": [_told(row) for row in versions], "sites": [dict(row._mapping) for row in sites],
                "uploads": [dict(row._mapping) for row in uploads]}

    def withdraw(self, person: Person, version: str) -> None:
        """Take back a version that is held. Raises Problem."""
        with self._database.write() as transaction:
            if not transaction.run("UPDATE version SET state = 'withdrawn', decided = :now, record = '{}', about = "
                                   "'{}' WHERE id = :id AND account = :account AND state = "
                                   "'held'", now=now(), id=version,
                                   account=person.id):
                raise Problem(404, "unknown", "There is no such version of yours that is held.")
            note(transaction, person.id, "withdrawn", version)
        self._store.remove_folder(f"{HELD}/{version}")

    def remove(self, person: Person, name: str, why: str) -> None:
        """Take a site out, with all its versions and what it says of its place: its owner, or a moderator. Raises
        Problem."""
        person.require()
        with self._database.write() as transaction:
            transaction.alone()
            row = transaction.one("SELECT owner, state FROM site WHERE name = :name", name=name)
            if row is None or (row.owner != person.id and person.role != MODERATOR):
                raise Problem(404, "unknown", "There is no such site of yours.")
            if row.state == "removed":
                raise Problem(409, "removed", "This site was taken down already.")
            held = transaction.all("SELECT id FROM version WHERE site = :name AND state = 'held'", name=name)
            transaction.run("UPDATE version SET state = CASE state WHEN 'accepted' THEN 'removed' ELSE 'withdrawn' "
                            "END, record = '{}', about = '{}' WHERE site = :name AND state IN ('held', "
                            "'accepted')", name=name)
            transaction.run(
                "UPDATE site SET state = 'removed', removed = :now, why = :why, title = '', place = '', tags = '[]', "
                "register = '', period_from = NULL, period_to = NULL, longitude = NULL, latitude = NULL, quadkey = "
                "NULL, feature = '{}', changed = changed + 1 WHERE name = :name", now=now(), why=why, name=name)
            transaction.run("DELETE FROM place WHERE site = :name", name=name)
            words.forget(transaction, name)
            note(transaction, person.id, "remove", name, why)
        for version in held:
            self._store.remove_folder(f"{HELD}/{version.id}")

    # ---- officials

    def place(self, person: Person, name: str) -> dict[str, Any]:
        """The exact place that a site's owner left for officials. Raises Problem."""
        person.require(OFFICIAL)
        with self._database.write() as transaction:
            sealed = transaction.value("SELECT sealed FROM place WHERE site = :name", name=name)
            note(transaction, person.id, "place", name, "read" if sealed else "none is kept")
        if sealed is None:
            raise Problem(404, "unknown", "No exact place is kept of this site.")
        return sealing.opened(self._key, sealed)

    def may_see(self, person: Person, version: str) -> bool:
        """Whether somebody may look at a version that is held."""
        with self._database.read() as transaction:
            row = transaction.one("SELECT account FROM version WHERE id = :id AND state = 'held'", id=version)
        return row is not None and person.kind == "session" and (person.role == MODERATOR or row.account == person.id)

    def record(self, version: str) -> dict[str, Any]:
        """What a held version's page shows."""
        with self._database.read() as transaction:
            row = transaction.one("SELECT record, about FROM version WHERE id = :id", id=version)
        assert row is not None
        return {**json.loads(row.record), **added(json.loads(row.about))}


def enter(
    transaction: Transaction, name: str, record: dict[str, Any], about: dict[str, Any], sequence: int, number: int
) -> None:
    """Set what a site is found by to what its newest version says."""
    site: Site = build(Site, record)
    shown = Shown(site.location, site.geometry, ())
    middle = None if shown.box is None else ((shown.box[0] + shown.box[2]) / 2, (shown.box[1] + shown.box[3]) / 2)
    taken = None if site.taken is None else date.fromisoformat(site.taken)
    found = published.item(site.said, shown, taken, assets(record))
    feature = published.listed({**found, "id": name}, name)
    values = {
        "name": name, "number": sequence, "newest": number, "now": now(), "title": site.title, "place": site.place,
        "tags": json.dumps(about["tags"], ensure_ascii=False), "register": about["register"],
        "period_from": about["period_from"], "period_to": about["period_to"],
        "longitude": middle and middle[0], "latitude": middle and middle[1],
        "quadkey": middle and quadkeys.of(*middle), "feature": json.dumps(feature, ensure_ascii=False),
    }
    transaction.run(
        "UPDATE site SET state = 'public', number = :number, newest = :newest, published = :now, title = :title, place "
        "= :place, tags = :tags, register = :register, period_from = :period_from, period_to = :period_to, longitude = "
        ":longitude, latitude = :latitude, quadkey = :quadkey, feature = :feature, changed = changed + 1 WHERE name = "
        ":name",
        **values)
    transaction.run("DELETE FROM place WHERE site = :name", name=name)
    if about["sealed"]:
        transaction.run("INSERT INTO place VALUES (:name, :sealed, :now)", name=name, sealed=about["sealed"], now=now())
    words.learn_site(transaction, name, record, about)


def assets(record: dict[str, Any]) -> dict[str, tuple[str, str, list[str]]]:
    """A site's files as its STAC item lists them."""
    found = {"page": ("./index.html", "text/html", ["overview"]),
             "thumbnail": ("./thumbnail.jpg", "image/jpeg", ["thumbnail"])}
    for kind in ("surface", "cloud"):
        if record[kind]:
            found[kind] = (f"./{record[kind]['tileset']}", "application/json", ["data"])
    return found


def added(about: dict[str, Any]) -> dict[str, Any]:
    """What a contributor added, as the site's page tells it."""
    period = None if about["period_from"] is None else [about["period_from"], about["period_to"]]
    return {"tags": about["tags"], "register": about["register"], "period": period}


def _told(row: Row[Any]) -> dict[str, Any]:
    record = json.loads(row.record)
    return {
        "id": row.id,
        "site": row.site,
        "number": row.number,
        "state": row.state,
        "made": row.made,
        "by": row.by_name,
        "why": row.why,
        "doubts": json.loads(row.doubts),
        "bytes": row.bytes,
        "title": record.get("title", row.site),
        "location": record.get("location", ""),
    }
