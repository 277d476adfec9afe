# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The catalogue in pages and tiles: after any changes, what a visitor can reach is what there is."""

from __future__ import annotations

import json
import random
import xml.etree.ElementTree
from pathlib import Path
from typing import Any

import pytest

from atlas import catalogue, quadkeys
from atlas.catalogue import Catalogue
from atlas.configuration import Configuration
from atlas.database import Database
from atlas.store import PUBLIC, Store

TITLE = "<b>\"Gate\" & 土楼</b>"


@pytest.fixture
def database(tmp_path: Path) -> Database:
    made = Database(f"sqlite:///{tmp_path / 'a.sqlite'}")
    steps = made.migrate()
    assert steps[0] == "0001" and steps == sorted(steps) and made.migrate() == []
    with made.write() as transaction:
        transaction.run("INSERT INTO account VALUES ('a', 'a', 'contributor', '', 0, 0)")
    return made


def place(database: Database, number: int, where: tuple[float, float] | None) -> str:
    """Put a site there, or take it off the map; the quadkeys that change."""
    name = f"site-{number}"
    feature = {
        "id": name,
        "geometry": where and {"type": "Point", "coordinates": where},
        "properties": {"title": TITLE, "providers": [{"name": "A & B"}]},
        "assets": {kind: {"href": f"sites/{name}/{kind}"} for kind in ("page", "thumbnail")},
    }
    values = {
        "name": name,
        "number": number,
        "title": TITLE,
        "key": where and quadkeys.of(*where),
        "feature": json.dumps(feature),
        "state": "public" if where else "removed",
        "longitude": where and where[0],
        "latitude": where and where[1],
    }
    with database.write() as transaction:
        old = transaction.value("SELECT quadkey FROM site WHERE name = :name", name=name)
        transaction.run("DELETE FROM site WHERE name = :name", name=name)
        transaction.run("INSERT INTO site VALUES (:name, 'a', :state, :number, 1, 0, :number, NULL, '', :title, '', "
                        "'[]', '', NULL, NULL, :longitude, :latitude, :key, NULL, :feature, 0)", **values)
    return " ".join(key for key in (old, values["key"]) if key)


def reached(store: Store) -> tuple[set[str], int]:
    """The sites that one comes to from the map's first tile, and how many it says there are."""
    found: set[str] = set()
    told = [0]

    def visit(key: str) -> int:
        tile = json.loads(store.get(f"{PUBLIC}/catalogue/map/{len(key)}/{key or 'world'}.json"))
        if "sites" in tile:
            found.update(site["id"] for site in tile["sites"])
            return len(tile["sites"])
        for part, count, longitude, latitude in tile["parts"]:
            assert visit(part) == count and -180 <= longitude <= 180 and -86 < latitude < 86
        return sum(count for _, count, _, _ in tile["parts"])

    told[0] = visit("")
    return found, told[0]


def test_any_changes_leave_a_map_that_is_whole(
    database: Database, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(catalogue, "_LEAF", 3)
    monkeypatch.setattr(catalogue, "PAGE", 4)
    store = Store(str(tmp_path / "store"), {})
    made = Catalogue(Configuration(), database, store)
    chance = random.Random(1)
    there: set[str] = set()
    for number in range(30):  # numbers are given in order
        place(database, number, None)
    made.write(range(30), [], 30)
    for step in range(60):
        changed: list[tuple[int, str]] = []
        for _ in range(chance.choice([1, 1, 3])):
            number = chance.randrange(30)
            # Few places, so that tiles come to hold too many sites, and too few again.
            where = (
                None
                if chance.random() < 0.35
                else (chance.choice([0.0, 0.1, 90.0, 179.97]) + chance.random() / 50, chance.choice([0.0, 60.0]))
            )
            keys = place(database, number, where)
            there = there | {f"site-{number}"} if where else there - {f"site-{number}"}
            changed.append((number, keys))
        made.write(
            [number for number, _ in changed], [key for _, keys in changed for key in keys.split()], len(changed)
        )
        assert reached(store) == (there, len(there)), step
        page: dict[str, Any] = json.loads(store.get(f"{PUBLIC}/items.json"))
        assert page["numberMatched"] == len(there)
        listed = [one["id"] for one in page["features"]]
        while link := next((one["href"] for one in page["links"] if one["rel"] == "next"), None):
            page = json.loads(store.get(f"{PUBLIC}/{link}"))
            listed += [one["id"] for one in page["features"]]
        assert sorted(listed) == sorted(there), step
    # Nothing of a site that was taken off is in any file, reachable or not.
    off = {f'"site-{number}"' for number in range(30)} - {f'"{name}"' for name in there}
    for name, _ in store.names(PUBLIC):
        content = store.get(name).decode()
        assert not any(one in content for one in off), name
    made.write_all()
    assert reached(store) == (there, len(there))
    for name in ("feed.xml", "sitemap.xml", "catalogue/sitemap/0.xml"):
        root = xml.etree.ElementTree.fromstring(store.get(f"{PUBLIC}/{name}"))
        assert len(root), name
    titles = {one.text for one in xml.etree.ElementTree.fromstring(store.get(f"{PUBLIC}/feed.xml")).iter("{http://www.w3.org/2005/Atom}title")}
    assert TITLE in titles
    stac = json.loads(store.get(f"{PUBLIC}/catalog.json"))
    assert stac["stac_version"] == "1.1.0" and [link["rel"] for link in stac["links"]] == ["root", "child"]
    child = json.loads(store.get(f"{PUBLIC}/catalogue/stac/0.json"))
    assert {link["href"] for link in child["links"] if link["rel"] == "item"} == {
        f"../../sites/{name}/item.json" for name in there
    }


@pytest.mark.parametrize(
    "where", [(-180.0, 90.0), (180.0, -90.0), (0.0, 0.0), (179.999999, 85.06), (-0.000001, -85.06)]
)
def test_every_place_on_earth_has_a_tile(where: tuple[float, float]) -> None:
    key = quadkeys.of(*where)
    assert len(key) == quadkeys.DEEPEST and set(key) <= set("0123")
    assert quadkeys.path(key)[0] == "" and all(key.startswith(part) for part in quadkeys.path(key))
