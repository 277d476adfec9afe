# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The atlas on two machines that share a PostgreSQL and a store that speaks S3, both real."""

from __future__ import annotations

import json
import random
import signal
import struct
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import atlas_services
import pytest
from atlas_run import Asker, Atlas, free_port, listed, make_site, running
from atlas_services import Postgresql

from atlas.database import Database

PLACE = {"latitude": 24.658307, "longitude": 117.052089}


@pytest.fixture(scope="module")
def postgresql() -> Iterator[Postgresql]:
    with ExitStack() as stack:
        try:
            found = stack.enter_context(atlas_services.postgresql())
        except atlas_services.MissingError as missing:
            pytest.skip(str(missing))
        yield found


@pytest.fixture(scope="module")
def s3(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, str, Path]]:
    """A store's URL, its options for the configuration, and the folder behind it."""
    folder = tmp_path_factory.mktemp("s3")
    with ExitStack() as stack:
        try:
            url, options = stack.enter_context(atlas_services.s3(folder))
        except atlas_services.MissingError as missing:
            pytest.skip(str(missing))
        yield url, options, folder / "bucket"


def test_two_machines_are_one_atlas(postgresql: Postgresql, s3: tuple[str, str, Path], tmp_path: Path) -> None:
    facts: dict[str, Any] = {"database": postgresql.url, "store": s3[0], "more": f"{s3[1]}[limits]\nchunk = 20000\n"}
    files = listed(make_site(tmp_path / "p"))
    with ExitStack() as stack:
        first, second = (stack.enter_context(running(tmp_path / name, **facts)) for name in ("a", "b"))
        contributor, moderator = first.somebody(), second.somebody("moderator", "Moira")
        other = first.somebody("moderator", "Other")
        elsewhere = replace(contributor, port=second.port)
        begun = contributor.begin(files, tags=["土楼"], exact=PLACE).said
        # A file's chunks by turns over both machines, each twice at once.
        for number, one in enumerate(begun["files"]):
            content, start, turn = files[one["path"]], 0, 0
            while start < len(content):
                way, part = f"/api/uploads/{begun['upload']}/{number}?start={start}", content[start : start + 20000]
                with ThreadPoolExecutor(2) as at_once:
                    answers = list(
                        at_once.map(
                            lambda asker, way=way, part=part: asker.ask("PUT", way, body=part).status,
                            (contributor, elsewhere),
                        )
                    )
                assert sorted(answers) == [200, 409]
                start, turn = start + len(part), turn + 1
        first.stop(signal.SIGKILL)
        version = elsewhere.ask("POST", f"/api/uploads/{begun['upload']}/finish", {}).said["version"]
        first.start()
        decided = [(moderator, "accept", {}), (other, "accept", {}), (other, "accept", {}), (moderator, "accept", {})]
        with ThreadPoolExecutor(4) as at_once:
            answers = list(
                at_once.map(lambda one: one[0].ask("POST", f"/api/versions/{version}/{one[1]}", one[2]), decided)
            )
        assert sorted(one.status for one in answers) == [200, 409, 409, 409]
        first.published()
        for atlas in (first, second):
            assert atlas.visitor.ask("GET", "/items.json").said["numberMatched"] == 1
            assert atlas.visitor.ask("GET", "/sites/gate.1/surface/0.glb").body == files["surface/0.glb"]
            assert (
                atlas.visitor.ask("GET", "/sites/gate/").status == 200 and atlas.visitor.ask("GET", "/").status == 200
            )
            assert atlas.visitor.ask("GET", "/sites/gate").status == 307
            for asked, found in (
                ("q=%E5%9C%9F%E6%A5%BC", 1),
                ("q=%E6%A5%BC%E5%9C%9F", 0),
                ("q=gat", 1),
                ("q=!%22'", 0),
                ("q=a:zz", 0),
            ):
                assert atlas.visitor.ask("GET", f"/api/search?{asked}").said["numberMatched"] == found, asked
        official = second.somebody("official")
        assert official.ask("GET", "/api/sites/gate/place").said == PLACE
        assert not [path for path in s3[2].rglob("*") if path.is_file() and b"24.658" in path.read_bytes()]
        assert contributor.ask("POST", "/api/sites/gate/remove", {"why": ""}).status == 200
        second.published()
        assert second.visitor.ask("GET", "/sites/gate.1/surface/0.glb").status == 404
        assert b"taken down" in second.visitor.ask("GET", "/sites/gate/").body


def test_a_small_atlas_grows_into_a_large_one(
    postgresql: Postgresql, s3: tuple[str, str, Path], tmp_path: Path
) -> None:
    files = listed(make_site(tmp_path / "p"))
    with running(tmp_path / "small") as small:
        contributor, moderator = small.somebody(), small.somebody("moderator", "Moira")
        version = contributor.upload(files, exact=PLACE).said["version"]
        moderator.ask("POST", f"/api/versions/{version}/accept", {})
        small.published()
    small.run("backup", tmp_path / "backup")
    database = Database(postgresql.url)
    with database.write() as transaction:  # whatever another test left
        transaction.run("DROP SCHEMA public CASCADE")
        transaction.run("CREATE SCHEMA public")
    database.close()
    large = Atlas(tmp_path / "large", free_port(), database=postgresql.url, store="s3://bucket/grown", more=s3[1])
    large.run("restore", tmp_path / "backup")
    large.start()
    try:
        assert large.visitor.ask("GET", "/sites/gate.1/surface/0.glb").body == files["surface/0.glb"]
        assert large.visitor.ask("GET", "/api/search?q=gate").said["numberMatched"] == 1
        answer = large.visitor.ask("POST", "/api/session", {"name": "Moira", "password": "correct horse battery"})
        moved = Asker(large.port, answer.headers["set-cookie"].partition(";")[0], answer.said["guard"])
        lines = moved.ask("GET", "/api/audit").said["lines"]
        assert lines[0]["action"] == "sign_in" and {line["action"] for line in lines} >= {
            "accepted",
            "hold",
            "upload",
            "join",
        }
        database = Database(postgresql.url)
        for statement in ("UPDATE audit SET action = 'x'", "DELETE FROM audit", "TRUNCATE audit"):
            with pytest.raises(Exception, match="only added to"), database.write() as transaction:
                transaction.run(statement)
        database.close()
        large.run("backup", tmp_path / "again")
        for name in ("site", "version", "version_file", "place"):
            assert (tmp_path / "again" / "tables" / f"{name}.jsonl").read_bytes().count(
                b"\n"
            ) == 1 or name == "version_file"
    finally:
        large.stop()


def test_a_database_that_goes_away_and_comes_back(
    postgresql: Postgresql, tmp_path: Path, files: dict[str, bytes]
) -> None:
    with running(tmp_path / "a", database=postgresql.url) as atlas:
        contributor = atlas.somebody(name="Patient")
        begun = contributor.begin(files).said
        postgresql.stop()
        try:
            answer = contributor.begin(files)
            assert answer.status == 503 and answer.said["code"] == "database" and "retry-after" in answer.headers
            assert atlas.visitor.ask("GET", "/health").status == 503
            assert atlas.visitor.ask("GET", "/index.html").status == 200  # visitors notice nothing
        finally:
            postgresql.start()
        again = contributor.begin(files).said
        assert again["upload"] == begun["upload"]
        contributor.send(again, files)
        assert contributor.ask("POST", f"/api/uploads/{begun['upload']}/finish", {}).status == 200


def test_a_film_comes_in_pieces_from_a_store(s3: tuple[str, str, Path], tmp_path: Path) -> None:
    site = make_site(tmp_path / "p")
    box = lambda kind, body: struct.pack(">I4s", 8 + len(body), kind) + body  # noqa: E731
    handler = box(b"trak", box(b"mdia", box(b"hdlr", bytes(8) + b"vide" + bytes(13))))
    film = box(b"ftyp", b"isom") + box(b"moov", handler) + box(b"mdat", random.Random(0).randbytes(5_000_000))
    record = json.dumps({**json.loads((site / "site.json").read_text()), "film": "film.mp4"}).encode()
    with running(tmp_path / "a", store="s3://bucket/film", more=s3[1]) as atlas:
        contributor, moderator = atlas.somebody(), atlas.somebody("moderator")
        held = contributor.upload({**listed(site), "film.mp4": film, "site.json": record}).said["version"]
        moderator.ask("POST", f"/api/versions/{held}/accept", {})
        atlas.published()
        for asked, status, first, last in (
            ("", 200, 0, len(film)), ("bytes=0-", 206, 0, len(film)), ("bytes=4000000-", 206, 4_000_000, len(film)),
            ("bytes=10-3000000", 206, 10, 3_000_001), ("bytes=10-99999999", 206, 10, len(film)),
        ):
            answer = atlas.visitor.ask("GET", "/sites/gate.1/film.mp4", Range=asked)
            assert (answer.status, answer.body == film[first:last]) == (status, True), asked
            assert status == 200 or answer.headers["content-range"] == f"bytes {first}-{last - 1}/{len(film)}"
        assert atlas.visitor.ask("GET", "/sites/gate.1/film.mp4", Range="bytes=5100000-").status == 416
        assert atlas.visitor.ask("GET", "/sites/gate.9/film.mp4").status == 404
