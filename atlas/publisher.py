# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What visitors see, made from the database: a site's folder, its versions, what tells that it was taken down, and the
catalogue. A site stays marked as changed until its files stand, so a publisher that was killed begins again."""

from __future__ import annotations

import html
import json
import logging
import socket
import threading
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import Row

from curecon_blender.core.publish import folder as published
from curecon_blender.core.publish.privacy import Shown

from . import sites
from .catalogue import Catalogue
from .configuration import Configuration
from .database import Database, now
from .records import Site, build
from .store import HELD, PUBLIC, Store

_BATCH = 100  # sites at a time
_LEASE, _WAIT = 60, 5  # seconds
_log = logging.getLogger("atlas")


class Publisher:
    def __init__(self, configuration: Configuration, database: Database, store: Store) -> None:
        self._configuration, self._database, self._store = configuration, database, store
        self._catalogue = Catalogue(configuration, database, store)
        # One process listens there at a time: after a crash it is the holder of its own lease.
        self._me = f"{socket.gethostname()} {configuration.listen}"
        self._wake, self._ended = threading.Event(), False

    def wake(self) -> None:
        self._wake.set()

    def stop(self) -> None:
        self._ended = True
        self._wake.set()

    def run(self) -> None:
        """Publish until it is stopped. What fails is tried again."""
        while not self._ended:
            try:
                while not self._ended and self.publish():
                    pass
            except Exception:
                _log.exception("publishing failed; it is tried again")
            self._wake.wait(_WAIT)
            self._wake.clear()

    def _mine(self) -> bool:
        """Whether this machine is the one that publishes; it is for a while."""
        with self._database.write() as transaction:
            return bool(transaction.run(
                "INSERT INTO lease VALUES ('publisher', :me, :ends) ON CONFLICT (name) DO UPDATE SET holder = :me, "
                "ends = :ends WHERE lease.holder = :me OR lease.ends < "
                ":now", me=self._me, ends=now() + _LEASE, now=now()))

    def release(self) -> None:
        with self._database.write() as transaction:
            transaction.run("DELETE FROM lease WHERE name = 'publisher' AND holder = :me", me=self._me)

    def publish(self) -> int:
        """Publish some of the sites that changed; how many. Another machine may be doing it."""
        with self._database.read() as transaction:
            changed = transaction.all(f"SELECT * FROM site WHERE changed > 0 ORDER BY changed, name LIMIT {_BATCH}")
        changed = [site for site in changed if self._mine() and self._stands(site)]
        if not changed:
            return 0
        keys = [key for site in changed for key in (site.quadkey, site.shown_quadkey) if key]
        numbers = [site.number for site in changed if site.number is not None]
        if numbers:  # a site that was never public is in no catalogue
            self._catalogue.write(numbers, keys, len(changed))
        with self._database.write() as transaction:
            for site in changed:
                transaction.run(
                    "UPDATE site SET shown_quadkey = :key WHERE name = :name", key=site.quadkey, name=site.name
                )
                transaction.run("UPDATE site SET changed = 0 WHERE name = :name AND changed = :changed", name=site.name,
                                changed=site.changed)
        for site in changed:
            self._forget_held(site.name)
        return len(changed)

    def _stands(self, site: Row[Any]) -> bool:
        """Publish a site. One that fails is tried again later, and keeps no other waiting."""
        try:
            self._publish_site(site)
        except Exception:
            _log.exception("%s could not be published; it is tried again", site.name)
            return False
        return True

    def rebuild(self) -> None:
        """Write all that is static anew, as after an update of the pages."""
        self.write_pages()
        with self._database.read() as transaction:
            found = transaction.all("SELECT * FROM site WHERE number IS NOT NULL")
        for site in found:
            self._publish_site(site)
        self._catalogue.write_all()

    def write_pages(self) -> None:
        """The pages' own files, as *Publish* writes them, and a map page that leads to the atlas's own."""
        for source in sorted(published.PAGES.rglob("*")):
            name = source.relative_to(published.PAGES).as_posix()
            if source.is_dir() or name == "site.html":
                continue
            content = source.read_bytes()
            target = f"{PUBLIC}/pages/{name}"
            if name == "index.html":
                target, content = f"{PUBLIC}/index.html", self._map_page(content.decode()).encode()
            if not self._store.has(target, len(content)) or self._store.get(target) != content:
                self._store.put(target, content)
        if not self._store_has("items.json"):
            self._catalogue.write([], [], 0)
            self._store.put(f"{PUBLIC}/catalogue/map/0/world.json", b'{"sites":[]}')
        self._store.put(f"{PUBLIC}/robots.txt", f"User-agent: *\nDisallow: /api/\nDisallow: /desk/\nSitemap: "
                                                f"{self._configuration.address}/sitemap.xml\n".encode())

    def _store_has(self, name: str) -> bool:
        try:
            return self._store.size(f"{PUBLIC}/{name}") > 0
        except FileNotFoundError:
            return False

    def _map_page(self, page: str) -> str:
        title, address = html.escape(self._configuration.title), html.escape(self._configuration.address)
        page = _replaced(page, "<title>Sites</title>",
                         f'<title>{title}</title>\n<meta property="og:title" content="{title}">\n<meta '
                         f'property="og:url" '
                         f'content="{address}/">\n<link rel="alternate" type="application/atom+xml" href="feed.xml">')
        return _replaced(page, '<footer data-word="outline"></footer>',
                         '<footer><span data-word="outline"></span> · <a href="feed.xml" data-word="feed"></a> · '
                         f'<a href="{address}/desk/" data-word="contribute"></a></footer>')

    # ---- a site

    def _publish_site(self, site: Row[Any]) -> None:
        if site.state == "removed":
            self._take_down(site)
            return
        with self._database.read() as transaction:
            versions = transaction.all("SELECT * FROM version WHERE site = :name AND state = 'accepted' ORDER BY "
                                       "number",
                                       name=site.name)
            files = {version.id: transaction.all("SELECT path, size FROM version_file WHERE version = "
                                                 ":id", id=version.id)
                     for version in versions}
        days = [{"number": version.number, "day": _day(version.decided), "taken": json.loads(version.record)["taken"],
                 "href": f"../{site.name}.{version.number}/index.html"} for version in reversed(versions)]
        for version in versions:
            folder = f"{PUBLIC}/sites/{site.name}.{version.number}"
            for file in files[version.id]:
                if not self._store.has(f"{folder}/{file.path}", file.size):
                    self._store.copy(f"{HELD}/{version.id}/{file.path}", f"{folder}/{file.path}")
            more = {} if version.number == site.newest else {"newest": f"../{site.name}/index.html"}
            self._write_page(site, version, f"sites/{site.name}.{version.number}", "", more)
        newest = versions[-1]
        below = f"../{site.name}.{newest.number}/"
        self._store.copy(f"{PUBLIC}/sites/{site.name}.{newest.number}/thumbnail.jpg",
                         f"{PUBLIC}/sites/{site.name}/thumbnail.jpg")
        self._write_page(site, newest, f"sites/{site.name}", below, {"versions": days})

    def _write_page(self, site: Row[Any], version: Row[Any], folder: str, below: str, more: dict[str, Any]) -> None:
        """A version's page, record and STAC item in `folder`, which find its tiles and pictures `below`."""
        record = json.loads(version.record)
        about = sites.added(json.loads(version.about))
        for kind in ("surface", "cloud"):
            if record[kind]:
                record[kind]["tileset"] = below + record[kind]["tileset"]
        if record.get("film"):
            record["film"] = below + record["film"]
        record["pictures"] = [below + name for name in record["pictures"]]
        address = f"{self._configuration.address}/sites/{site.name}/"
        record |= {"id": site.name, "address": address, **about, **more}
        put = lambda name, content: self._store.put(f"{PUBLIC}/{folder}/{name}", content)  # noqa: E731
        put("site.json", _json(record))
        known: Site = build(Site, json.loads(version.record))
        shown = Shown(known.location, known.geometry, ())
        taken = None if known.taken is None else datetime.fromisoformat(known.taken).date()
        item = published.item(known.said, shown, taken, sites.assets(record))
        item |= {"id": folder.removeprefix("sites/")}
        item["properties"] |= {"curecon:tags": about["tags"], "curecon:register": about["register"],
                               "version": str(version.number)}
        put("item.json", _json(item))
        put("index.html", self._page(known, address).encode("utf-8", "replace"))

    def _page(self, site: Site, address: str) -> str:
        page = (published.PAGES / "site.html").read_text(encoding="utf-8")
        title, text = html.escape(site.title), html.escape(" ".join(site.text.split())[:300])
        return _replaced(
            page, "<title>Site</title>",
            f'<title>{title}</title>\n<meta property="og:type" content="website">\n<meta property="og:title" '
            f'content="{title}">\n<meta property="og:description" content="{text}">\n<meta property="og:url" '
            f'content="{html.escape(address)}">\n<meta property="og:image" '
            f'content="{html.escape(address)}thumbnail.jpg">\n'
            f'<link rel="canonical" href="{html.escape(address)}">')

    def _take_down(self, site: Row[Any]) -> None:
        for number in range(1, site.newest + 1):
            self._store.remove_folder(f"{PUBLIC}/sites/{site.name}.{number}")
        self._store.remove_folder(f"{PUBLIC}/sites/{site.name}")
        if site.number is not None:
            said = _GONE.format(day=_day(site.removed))
            self._store.put(f"{PUBLIC}/sites/{site.name}/index.html", said.encode())

    def _forget_held(self, name: str) -> None:
        """Remove the copies that moderators looked at, once the public ones stand."""
        with self._database.read() as transaction:
            versions = transaction.all("SELECT id FROM version WHERE site = :name AND state IN ('accepted', 'removed') "
                                       "AND EXISTS (SELECT 1 FROM site WHERE name = :name AND changed = 0)", name=name)
        for version in versions:
            self._store.remove_folder(f"{HELD}/{version.id}")


_GONE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="robots" content="noindex"><title>Taken down</title>
<link rel="stylesheet" href="../../pages/style.css"></head>
<body><main class="gone"><h1>This site was taken down on {day}.</h1><p lang="zh-Hans">此遗址已于 {day} 撤下。</p>
<p><a href="../../index.html">All sites · 全部遗址</a></p></main></body></html>
"""


def _replaced(page: str, mark: str, text: str) -> str:
    if page.count(mark) != 1:
        raise RuntimeError(f"the pages have changed: {mark} is not there once")
    return page.replace(mark, text)


def _json(value: Any) -> bytes:
    return json.dumps(value, ensure_ascii=False, separators=(",", ":")).encode("utf-8", "replace")


def _day(seconds: int) -> str:
    return datetime.fromtimestamp(seconds, UTC).date().isoformat()
