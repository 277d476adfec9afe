# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The catalogue as static files: pages of the list, tiles of the map, STAC, feed and sitemap. Each is made from the
database alone, so making it again is always safe; what a change of some sites touches is a few files.
"""

from __future__ import annotations

import html
import json
from collections.abc import Iterable
from datetime import UTC, datetime
from typing import Any

from . import quadkeys
from .configuration import Configuration
from .database import Database, Transaction
from .store import PUBLIC, Store

PAGE = 100  # sites
STAC = 1000
_LEAF = 100  # sites of a tile that names them; of more it tells how many are where
_NEWS = 50
_FOLDER = "catalogue"
_VERSION = "1.1.0"


class Catalogue:
    def __init__(self, configuration: Configuration, database: Database, store: Store) -> None:
        self._address, self._title = configuration.address, configuration.title
        self._database, self._store = database, store

    def write(self, numbers: Iterable[int], keys: Iterable[str], many: int) -> None:
        """Write what tells of the sites of these numbers and quadkeys, of which `many` may be new."""
        numbers = set(numbers)
        with self._database.read() as transaction:
            last = transaction.value("SELECT coalesce(max(number), -1) FROM site")
            for page in sorted({number // PAGE for number in numbers}):
                self._put(f"{_FOLDER}/pages/{page}.json", self._page(transaction, [page]))
            for part in sorted({number // STAC for number in numbers}):
                self._write_part(transaction, part)
            done: set[str] = set()
            for key in sorted(set(keys)):
                self._write_tiles(transaction, key, many, done)
            self._write_heads(transaction, last)

    def write_all(self) -> None:
        with self._database.read() as transaction:
            last = transaction.value("SELECT coalesce(max(number), -1) FROM site")
            for page in range(last // PAGE + 1):
                self._put(f"{_FOLDER}/pages/{page}.json", self._page(transaction, [page]))
            for part in range(last // STAC + 1):
                self._write_part(transaction, part)
            self._subtree(transaction, "", set())
            self._write_heads(transaction, last)

    # ---- the list

    def _page(self, transaction: Transaction, pages: list[int]) -> dict[str, Any]:
        """Sites of some pages, the last of which is the oldest, newest first; `next` leads on."""
        low = pages[-1]
        rows = transaction.all("SELECT feature FROM site WHERE state = 'public' AND number >= :low AND number < :high "
                               "ORDER BY number DESC", low=PAGE * low, high=PAGE * (pages[0] + 1))
        links = (
            [{"rel": "next", "href": f"{_FOLDER}/pages/{low - 1}.json", "type": "application/geo+json"}] if low else []
        )
        return {"type": "FeatureCollection", "features": [json.loads(row.feature) for row in rows], "links": links}

    def _write_heads(self, transaction: Transaction, last: int) -> None:
        page = max(last, 0) // PAGE
        count = transaction.value("SELECT count(*) FROM site WHERE state = 'public'")
        found = self._page(transaction, [page, page - 1] if page else [page])
        self._put("items.json", {
            **found, "numberMatched": count,
            "links": [*found["links"], {"rel": "tiles", "href": f"{_FOLDER}/map/{{level}}/{{key}}.json"},
                      {"rel": "search", "href": "api/search"}, {"rel": "alternate", "href": "feed.xml"}]})
        parts = range(max(last, 0) // STAC + 1)
        self._put("catalog.json", {
            "type": "Catalog", "stac_version": _VERSION, "id": "curecon-atlas", "title": self._title,
            "description": f"{count} sites recorded from drone photos.",
            "links": [{"rel": "root", "href": "./catalog.json", "type": "application/json"},
                      *({"rel": "child", "href": f"./{_FOLDER}/stac/{part}.json", "type": "application/json"}
                        for part in parts)]})
        entries = "".join(
            f"<sitemap><loc>{self._at(f'{_FOLDER}/sitemap/{part}.xml')}</loc></sitemap>" for part in parts
        )
        self._put_text("sitemap.xml", f'<sitemapindex xmlns="http://www.sitemaps.org/schemas/sitemap/0.9">{entries}'
                                      "</sitemapindex>")
        self._put_text("feed.xml", self._feed(transaction))

    def _write_part(self, transaction: Transaction, part: int) -> None:
        rows = transaction.all("SELECT name, title, published FROM site WHERE state = 'public' AND number >= :low AND "
                               "number < :high ORDER BY number", low=STAC * part, high=STAC * (part + 1))
        self._put(
            f"{_FOLDER}/stac/{part}.json",
            {
                "type": "Catalog",
                "stac_version": _VERSION,
                "id": f"curecon-atlas-{part}",
                "description": f"Sites {STAC * part} to {STAC * (part + 1) - 1}, in the order of their acceptance.",
                "links": [
                    *(
                        {"rel": rel, "href": "../../catalog.json", "type": "application/json"}
                        for rel in ("root", "parent")
                    ),
                    *(
                        {
                            "rel": "item",
                            "href": f"../../sites/{row.name}/item.json",
                            "type": "application/geo+json",
                            "title": row.title,
                        }
                        for row in rows
                    ),
                ],
            },
        )
        entries = "".join(
            f"<url><loc>{self._at(f'sites/{row.name}/')}</loc><lastmod>{_day(row.published)}</lastmod></url>"
            for row in rows
        )
        self._put_text(f"{_FOLDER}/sitemap/{part}.xml",
                       f'<urlset xmlns="http://www.sitemaps.org/schemas/sitemap/0.9">{entries}</urlset>')

    def _feed(self, transaction: Transaction) -> str:
        rows = transaction.all("SELECT name, title, place, published, number, feature FROM site WHERE state = "
                               "'public' ORDER "
                               f"BY published DESC, number DESC LIMIT {_NEWS}")
        entries = "".join(
            f"<entry><id>{self._at(f'sites/{row.name}/')}</id><title>{_text(row.title)}</title>"
            f"<updated>{_moment(row.published)}</updated><link href=\"{self._at(f'sites/{row.name}/')}\"/>"
            f"<author><name>{_text(_credit(row.feature) or self._title)}</name></author>"
            f"<summary>{_text(row.place)}</summary></entry>" for row in rows)
        newest = _moment(max((row.published for row in rows), default=0))
        return (f'<feed xmlns="http://www.w3.org/2005/Atom"><id>{self._at("")}</id><title>{_text(self._title)}</title>'
                f'<updated>{newest}</updated><link rel="self" href="{self._at("feed.xml")}"/><link '
                f'href="{self._at("")}"/>'
                f"{entries}</feed>")

    # ---- the map

    def _write_tiles(self, transaction: Transaction, key: str, many: int, done: set[str]) -> None:
        """The tiles that a place is in. A tile that may just have come to hold too many sites to name them gets all
        tiles below it; below one that names its sites again nothing is left of this place."""
        leaf = False
        for prefix in quadkeys.path(key):
            if leaf:
                self._store.remove(f"{PUBLIC}/{self._name(prefix)}")
            elif prefix not in done:
                count = self._write_tile(transaction, prefix)
                done.add(prefix)
                leaf = self._is_leaf(prefix, count)
                if not leaf and count <= _LEAF + many:
                    self._subtree(transaction, prefix, done)
            else:
                leaf = self._is_leaf(prefix, self._count(transaction, prefix))

    def _subtree(self, transaction: Transaction, prefix: str, done: set[str]) -> None:
        count = self._write_tile(transaction, prefix)
        done.add(prefix)
        if not self._is_leaf(prefix, count):
            for row in self._parts(transaction, prefix):
                self._subtree(transaction, row.part, done)

    @staticmethod
    def _is_leaf(prefix: str, count: int) -> bool:
        return count <= _LEAF or len(prefix) == quadkeys.DEEPEST

    @staticmethod
    def _count(transaction: Transaction, prefix: str) -> int:
        return int(transaction.value("SELECT count(*) FROM site WHERE quadkey >= :low AND quadkey < :high", low=prefix,
                                     high=f"{prefix}4"))

    @staticmethod
    def _parts(transaction: Transaction, prefix: str) -> list[Any]:
        width = len(prefix) + quadkeys.STEP
        return transaction.all(
            f"SELECT substr(quadkey, 1, {width}) AS part, count(*) AS count, avg(longitude) AS longitude, "
            f"avg(latitude) AS latitude FROM site WHERE quadkey >= :low AND quadkey < :high GROUP BY substr(quadkey, "
            f"1, {width})",
            low=prefix, high=f"{prefix}4")

    def _write_tile(self, transaction: Transaction, prefix: str) -> int:
        """Sites that are in it."""
        count = self._count(transaction, prefix)
        if self._is_leaf(prefix, count):
            rows = transaction.all("SELECT feature FROM site WHERE quadkey >= :low AND quadkey < :high ORDER BY number",
                                   low=prefix, high=f"{prefix}4")
            self._put(self._name(prefix), {"sites": [_short(json.loads(row.feature)) for row in rows]})
        else:
            self._put(self._name(prefix), {"parts": [
                [row.part, row.count, round(row.longitude, 4), round(row.latitude, 4)]
                for row in self._parts(transaction, prefix)]})
        return count

    @staticmethod
    def _name(prefix: str) -> str:
        return f"{_FOLDER}/map/{len(prefix)}/{prefix or 'world'}.json"

    # ---- files

    def _at(self, path: str) -> str:
        return html.escape(f"{self._address}/{path}")

    def _put(self, name: str, value: dict[str, Any]) -> None:
        self._put_text(name, json.dumps(value, ensure_ascii=False, separators=(",", ":")))

    def _put_text(self, name: str, text: str) -> None:
        self._store.put(f"{PUBLIC}/{name}", text.encode("utf-8", "replace"))


def _short(feature: dict[str, Any]) -> dict[str, Any]:
    """What the map needs of a site."""
    kept = ("title", "datetime", "curecon:location", "curecon:date_of", "curecon:place")
    said = feature["properties"]
    return {
        "id": feature["id"],
        "geometry": feature["geometry"],
        "properties": {key: said[key] for key in kept if key in said},
        "assets": {name: {"href": feature["assets"][name]["href"]} for name in ("page", "thumbnail")},
    }


def _credit(feature: str) -> str:
    providers = json.loads(feature)["properties"].get("providers", [])
    return providers[0]["name"] if providers else ""


def _text(text: str) -> str:
    """For XML, which control characters may not stand in."""
    return html.escape("".join(letter for letter in text if letter >= " "))


def _moment(seconds: int) -> str:
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def _day(seconds: int) -> str:
    return _moment(seconds)[:10]
