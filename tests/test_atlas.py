# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The atlas: from an upload to what a visitor sees, and out again."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from urllib.parse import urljoin

from atlas_run import PASSWORD, Asker, Atlas, listed, make_site

from curecon_blender.core.base.options import EXACT, HIDDEN


def test_a_site_comes_to_the_map_when_a_moderator_accepts_it(
    atlas: Atlas, contributor: Asker, moderator: Asker, little: Callable[..., Path]
) -> None:
    files = listed(little())
    held = contributor.upload(files, tags=["圆楼", "earth"], register="CN-1113", period_from=1700, period_to=1750)
    assert held.status == 200 and held.said["site"] == "gate" and held.said["doubts"] == []
    assert atlas.visitor.ask("GET", "/sites/gate/site.json").status == 404
    assert not atlas.visitor.ask("GET", "/items.json").said["features"]
    preview = f"/held/sites/{held.said['version']}/"
    assert atlas.visitor.ask("GET", f"{preview}site.json").status == 401
    assert moderator.ask("GET", f"{preview}site.json").said["title"] == "Gate"
    assert moderator.ask("GET", f"{preview}surface/0.glb").body == files["surface/0.glb"]
    assert b"viewer.js" in moderator.ask("GET", f"{preview}index.html").body
    assert moderator.ask("GET", "/held/pages/viewer.js").status == 200

    assert [one["title"] for one in moderator.ask("GET", "/api/held").said["held"]] == ["Gate"]
    assert moderator.ask("POST", f"/api/versions/{held.said['version']}/accept", {}).status == 200
    atlas.published()
    (feature,) = atlas.visitor.ask("GET", "/items.json").said["features"]
    assert feature["id"] == "gate" and feature["geometry"]["type"] == "Polygon"
    record = atlas.visitor.ask("GET", "/sites/gate/site.json").said
    assert record["register"] == "CN-1113" and record["period"] == [1700, 1750] and record["tags"] == ["圆楼", "earth"]
    tiles = atlas.visitor.ask("GET", urljoin("/sites/gate/", record["surface"]["tileset"]))
    assert tiles.status == 200 and tiles.said["asset"]["version"] == "1.1"
    assert atlas.visitor.ask("GET", "/sites/gate.1/surface/0.glb").body == files["surface/0.glb"]
    page = atlas.visitor.ask("GET", "/sites/gate/").body.decode()
    assert '<meta property="og:title" content="Gate">' in page and f"{atlas.address}/sites/gate/thumbnail.jpg" in page
    assert f"{atlas.address}/sites/gate/" in atlas.visitor.ask("GET", "/feed.xml").body.decode()
    assert atlas.visitor.ask("GET", "/catalogue/map/0/world.json").said["sites"][0]["id"] == "gate"
    for asked, found in (
        ("q=gate", 1),
        ("q=%E5%9C%86%E6%A5%BC", 1),
        ("q=%E6%A5%BC%E5%9C%86", 0),
        ("q=hou", 1),
        ("tag=earth", 1),
        ("tag=ear", 0),
        ("register=CN-1113", 1),
        ("from=1750", 1),
        ("from=1751", 0),
        ("to=1699", 0),
        ("box=117,24,118,25", 1),
        ("box=0,0,1,1", 0),
        ("q=!!", 0),
        ("q=nothing", 0),
    ):
        assert atlas.visitor.ask("GET", f"/api/search?{asked}").said["numberMatched"] == found, asked


def test_a_new_version_takes_its_place_and_the_old_one_keeps_its_address(
    atlas: Atlas, contributor: Asker, moderator: Asker, tmp_path: Path
) -> None:
    for number in (1, 2):
        files = listed(make_site(tmp_path / str(number), "Tower", text=f"State {number}"))
        version = contributor.upload(files).said["version"]
        assert moderator.ask("POST", f"/api/versions/{version}/accept", {}).said == {"site": "tower"}
        atlas.published()
    newest = atlas.visitor.ask("GET", "/sites/tower/site.json").said
    assert newest["text"] == "State 2" and [one["number"] for one in newest["versions"]] == [2, 1]
    older = atlas.visitor.ask("GET", urljoin(urljoin("/sites/tower/", newest["versions"][1]["href"]), "site.json")).said
    assert older["text"] == "State 1" and older["newest"] == "../tower/index.html"
    assert sum(one["id"] == "tower" for one in atlas.visitor.ask("GET", "/items.json").said["features"]) == 1


def test_another_person_cannot_take_a_sites_name(atlas: Atlas, moderator: Asker, tmp_path: Path) -> None:
    first, second = atlas.somebody(name="First"), atlas.somebody(name="Second")
    files = listed(make_site(tmp_path / "p", "Name"))
    names = [one.upload(files).said["site"] for one in (first, second)]
    assert names[0] == "name" and names[1].startswith("name-")
    version = second.ask("GET", "/api/mine").said["versions"][0]["id"]
    assert first.ask("DELETE", f"/api/versions/{version}").status == 404
    assert first.ask("POST", f"/api/sites/{names[1]}/remove", {"why": ""}).status == 404
    assert first.ask("GET", f"/held/sites/{version}/site.json").status == 404
    assert second.ask("GET", f"/held/sites/{version}/site.json").status == 200


def test_what_a_contributor_takes_out_is_gone_from_every_file(
    atlas: Atlas, contributor: Asker, moderator: Asker, tmp_path: Path
) -> None:
    files = listed(make_site(tmp_path / "p", "Zanzibar Fort", place="Unguja"))
    version = contributor.upload(files, exact={"latitude": -6.16223, "longitude": 39.18787}).said["version"]
    moderator.ask("POST", f"/api/versions/{version}/accept", {})
    atlas.published()
    assert contributor.ask("POST", "/api/sites/zanzibar-fort/remove", {"why": "looters"}).status == 200
    atlas.published()
    assert b"taken down" in atlas.visitor.ask("GET", "/sites/zanzibar-fort/").body
    assert atlas.visitor.ask("GET", "/sites/zanzibar-fort.1/surface/0.glb").status == 404
    for path in atlas.folder.rglob("*"):
        if path.is_file() and path.name != "log" and "store" in path.parts:
            assert b"Zanzibar" not in path.read_bytes() and b"Unguja" not in path.read_bytes(), path
    assert atlas.visitor.ask("GET", "/api/search?q=zanzibar").said["numberMatched"] == 0
    official = atlas.somebody("official")
    assert official.ask("GET", "/api/sites/zanzibar-fort/place").status == 404
    again = contributor.upload(files).said["site"]
    assert again.startswith("zanzibar-fort-")  # the address that was taken down never leads elsewhere


def test_exact_places_are_sealed_and_officials_alone_read_them(
    atlas: Atlas, contributor: Asker, moderator: Asker, little: Callable[..., Path]
) -> None:
    place = {"latitude": 24.658307, "longitude": 117.052089}
    version = contributor.upload(listed(little("Secret", HIDDEN)), exact=place).said["version"]
    moderator.ask("POST", f"/api/versions/{version}/accept", {})
    atlas.published()
    official = atlas.somebody("official", "Ophelia")
    assert official.ask("GET", "/api/sites/secret/place").said == place
    for one, status in ((moderator, 403), (contributor, 403), (atlas.visitor, 401)):
        assert one.ask("GET", "/api/sites/secret/place").status == status
    for path in atlas.folder.rglob("*"):
        if path.is_file():
            assert not any(needle in path.read_bytes() for needle in (b"24.658", b"117.052")), path
    lines = moderator.ask("GET", "/api/audit").said["lines"]
    assert any((line["action"], line["subject"], line["by"]) == ("place", "secret", "Ophelia") for line in lines)
    # A site published at hidden is in the list, and not on the map.
    assert any(one["id"] == "secret" and one["geometry"] is None
               for one in atlas.visitor.ask("GET", "/items.json").said["features"])
    world = json.dumps(atlas.visitor.ask("GET", "/catalogue/map/0/world.json").said)
    assert "secret" not in world


def test_a_place_that_is_exact_stays_exact(
    atlas: Atlas, contributor: Asker, moderator: Asker, little: Callable[..., Path]
) -> None:
    files = listed(little("Open", EXACT))
    assert "surface/earth.json" in files
    version = contributor.upload(files).said["version"]
    moderator.ask("POST", f"/api/versions/{version}/accept", {})
    atlas.published()
    assert atlas.visitor.ask("GET", "/sites/open/item.json").said["geometry"]["coordinates"] == [117.05, 24.65]
    assert atlas.visitor.ask("GET", "/sites/open.1/surface/earth.json").status == 200


def test_a_refused_version_is_gone_and_says_why(
    atlas: Atlas, contributor: Asker, moderator: Asker, little: Callable[..., Path]
) -> None:
    version = contributor.upload(listed(little("Blurred"))).said["version"]
    assert moderator.ask("POST", f"/api/versions/{version}/refuse", {"why": " "}).status == 400
    assert moderator.ask("POST", f"/api/versions/{version}/refuse", {"why": "Faces can be seen."}).status == 200
    mine = contributor.ask("GET", "/api/mine").said["versions"]
    assert next(one for one in mine if one["id"] == version)["why"] == "Faces can be seen."
    assert not (atlas.folder / "store" / "held" / version).exists()
    assert moderator.ask("POST", f"/api/versions/{version}/accept", {}).said["code"] == "decided"


def test_the_password_is_kept_as_nobody_can_read_it(atlas: Atlas, contributor: Asker) -> None:
    for path in atlas.folder.rglob("*"):
        if path.is_file():
            assert PASSWORD.encode() not in path.read_bytes(), path
            assert contributor.cookie.partition("=")[2].encode() not in path.read_bytes(), path
