# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What goes wrong at an atlas: cut uploads, a killed server, a full disk, a locked database, and people who try."""

from __future__ import annotations

import http.client
import json
import shutil
import signal
import socket
import sqlite3
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from atlas_run import PASSWORD, Asker, Atlas, listed, make_site, running
from conftest import MakeOnce

from atlas import configuration, people
from atlas.database import Database, now

CHUNK = 20_000
LIMITS = f"[limits]\nchunk = {CHUNK}\nuploads = 100\n"


@pytest.fixture(scope="module")
def files(made_once: MakeOnce[Path]) -> dict[str, bytes]:
    return listed(made_once("atlas_Gate_cell", lambda folder: make_site(folder / "p")))


@pytest.fixture(scope="module")
def atlas(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Atlas]:
    with running(tmp_path_factory.mktemp("faults"), more=LIMITS) as found:
        yield found


@pytest.fixture(scope="module")
def contributor(atlas: Atlas) -> Asker:
    return atlas.somebody("contributor", "Conrad")


@pytest.fixture(scope="module")
def moderator(atlas: Atlas) -> Asker:
    return atlas.somebody("moderator", "Moira")


@pytest.fixture
def titled(files: dict[str, bytes], request: pytest.FixtureRequest) -> dict[str, bytes]:
    """The files of a site with a name of its own."""
    name = request.node.name[:50]
    record = {
        **json.loads(files["site.json"]),
        "title": name,
        "id": "".join(c if c.isalnum() else "-" for c in name.lower()),
    }
    return {**files, "site.json": json.dumps(record).encode()}


def largest(begun: dict[str, Any]) -> tuple[int, str, int]:
    return max(
        ((number, one["path"], one["size"]) for number, one in enumerate(begun["files"])), key=lambda one: one[2]
    )


# ---- uploads

def test_chunks_cut_doubled_out_of_order_and_too_many(
    atlas: Atlas, contributor: Asker, titled: dict[str, bytes]
) -> None:
    begun = contributor.begin(titled).said
    number, path, size = largest(begun)
    content, way = titled[path], f"/api/uploads/{begun['upload']}/{number}?start="
    assert size > 2 * CHUNK

    def offset() -> int:
        return int(contributor.ask("GET", f"/api/uploads/{begun['upload']}").said["files"][number]["received"])

    for cut in (0, 1, 100, CHUNK - 1):  # the connection ends before the chunk does
        with socket.create_connection(("127.0.0.1", atlas.port)) as line:
            line.sendall((f"PUT {way}0 HTTP/1.1\r\nHost: 127.0.0.1\r\nCookie: {contributor.cookie}\r\nX-Atlas-Guard: "
                          f"{contributor.guard}\r\nContent-Length: {CHUNK}\r\n\r\n").encode() + content[:cut])
    time.sleep(0.2)
    assert offset() == 0
    assert contributor.ask("PUT", f"{way}0", body=content[:CHUNK]).said == {"received": CHUNK}
    for start, part, status in (
        (0, content[:CHUNK], 409),
        (2 * CHUNK, content[2 * CHUNK : 3 * CHUNK], 409),
        (CHUNK, b"", 413),
        (CHUNK - 1, b"xx", 409),
        (CHUNK, content[: CHUNK + 1], 413),
        (10**14, b"x", 409),
    ):
        answer = contributor.ask("PUT", f"{way}{start}", body=part)
        assert answer.status == status and answer.said.get("offset", CHUNK) == CHUNK, (start, answer)
    for bad in ("-1", "x", "1e3", "", "9" * 40):
        assert contributor.ask("PUT", f"{way}{bad}", body=b"x").status == 400
    assert contributor.ask("POST", f"/api/uploads/{begun['upload']}/finish", {}).said["code"] == "incomplete"
    # Once more from the beginning: the same upload, where it was.
    again = contributor.begin(titled).said
    assert again["upload"] == begun["upload"] and again["files"][number]["received"] == CHUNK
    contributor.send(again, titled)
    assert contributor.ask("PUT", f"{way}{size}", body=b"more").status == 413
    with ThreadPoolExecutor(4) as at_once:
        done = list(
            at_once.map(lambda _: contributor.ask("POST", f"/api/uploads/{begun['upload']}/finish", {}), range(4))
        )
    assert {one.status for one in done} == {200} and len({one.said["version"] for one in done}) == 1
    assert contributor.ask("PUT", f"{way}0", body=b"x").status == 404
    mine = contributor.ask("GET", "/api/mine").said["versions"]
    assert sum(one["id"] == done[0].said["version"] for one in mine) == 1


def test_the_same_chunk_from_many_connections_at_once_counts_once(contributor: Asker, titled: dict[str, bytes]) -> None:
    begun = contributor.begin(titled).said
    number, path, _ = largest(begun)
    way = f"/api/uploads/{begun['upload']}/{number}?start=0"
    with ThreadPoolExecutor(8) as at_once:
        answers = list(at_once.map(lambda _: contributor.ask("PUT", way, body=titled[path][:CHUNK]).status, range(8)))
    assert sorted(answers) == [200] + [409] * 7
    contributor.send(contributor.begin(titled).said, titled)
    assert contributor.ask("POST", f"/api/uploads/{begun['upload']}/finish", {}).status == 200


def test_bytes_other_than_promised_and_sizes_larger_than_said(contributor: Asker, titled: dict[str, bytes]) -> None:
    begun = contributor.begin(titled).said
    changed = {**titled, "thumbnail.jpg": bytes(len(titled["thumbnail.jpg"]))}
    contributor.send(begun, changed)
    answer = contributor.ask("POST", f"/api/uploads/{begun['upload']}/finish", {})
    assert answer.status == 422 and "SHA-256" in answer.said["said"]
    assert contributor.ask("GET", f"/api/uploads/{begun['upload']}").status == 404  # what is refused is gone
    begun = contributor.begin(titled).said
    number = next(number for number, one in enumerate(begun["files"]) if one["path"] == "thumbnail.jpg")
    longer = titled["thumbnail.jpg"] + b"more"
    assert contributor.ask("PUT", f"/api/uploads/{begun['upload']}/{number}?start=0", body=longer).status == 413


def test_an_upload_of_another_person(atlas: Atlas, contributor: Asker, titled: dict[str, bytes]) -> None:
    other = atlas.somebody(name="Another")
    begun = contributor.begin(titled).said
    way = f"/api/uploads/{begun['upload']}"
    assert [
        other.ask("GET", way).status,
        other.ask("DELETE", way).status,
        other.ask("PUT", f"{way}/0?start=0", body=b"x").status,
        other.ask("POST", f"{way}/finish", {}).status,
    ] == [404] * 4
    assert other.begin(titled).said["upload"] != begun["upload"]
    assert contributor.ask("DELETE", way).status == 200 and contributor.ask("GET", way).status == 404


def test_more_uploads_than_an_account_may_have(tmp_path: Path, files: dict[str, bytes]) -> None:
    total = sum(map(len, files.values()))
    with running(tmp_path / "a", more=f"[limits]\nuploads = 2\naccount = {2 * total + 100}\nupload = "
                                      f"{total + 50}\n") as atlas:
        somebody = atlas.somebody()
        assert somebody.upload(files).status == 200
        assert somebody.begin({**files, "thumbnail.jpg": files["thumbnail.jpg"] + b"x" * 40}).status == 200
        assert somebody.begin({**files, "thumbnail.jpg": files["thumbnail.jpg"] + b"x"}).said["code"] == "full"
        assert somebody.begin({**files, "thumbnail.jpg": files["thumbnail.jpg"] + b"x" * 60}).status == 413
        version = somebody.ask("GET", "/api/mine").said["versions"][0]["id"]
        assert somebody.ask("DELETE", f"/api/versions/{version}").status == 200
        assert somebody.begin({**files, "thumbnail.jpg": files["thumbnail.jpg"] + b"x"}).status == 200


# ---- the server and its disk

def test_a_server_that_is_killed_loses_nothing_it_took(tmp_path: Path, files: dict[str, bytes]) -> None:
    """By SIGKILL: amid chunks, amid checking, right after a decision, amid publishing."""
    with running(tmp_path / "a", more=LIMITS) as atlas:
        contributor, moderator = atlas.somebody(), atlas.somebody("moderator")
        begun = contributor.begin(files).said
        taken: list[int] = []

        def send() -> None:
            try:
                for number, one in enumerate(begun["files"]):
                    while (start := one["received"]) < one["size"]:
                        part = files[one["path"]][start : start + 2000]
                        one["received"] = contributor.ask(
                            "PUT", f"/api/uploads/{begun['upload']}/{number}?start={start}", body=part
                        ).said["received"]
                        taken.append(len(part))
            except (OSError, http.client.HTTPException):
                pass

        sending = threading.Thread(target=send)
        sending.start()
        while len(taken) < 5:
            time.sleep(0.01)
        atlas.stop(signal.SIGKILL)
        sending.join()
        atlas.start()
        again = contributor.begin(files).said
        assert again["upload"] == begun["upload"]
        assert sum(one["received"] for one in again["files"]) >= sum(taken) > 0
        contributor.send(again, files)

        for _ in range(2):  # amid checking, or just behind it
            asking = threading.Thread(target=_quietly, args=(contributor, f"/api/uploads/{begun['upload']}/finish"))
            asking.start()
            time.sleep(0.05)
            atlas.stop(signal.SIGKILL)
            asking.join()
            atlas.start()
        version = contributor.ask("POST", f"/api/uploads/{begun['upload']}/finish", {}).said["version"]
        assert len(contributor.ask("GET", "/api/mine").said["versions"]) == 1

        assert moderator.ask("POST", f"/api/versions/{version}/accept", {}).status == 200
        atlas.stop(signal.SIGKILL)
        atlas.start()
        atlas.published()
        assert atlas.visitor.ask("GET", "/items.json").said["numberMatched"] == 1
        tile = next(path for path in files if path.endswith(".glb"))
        assert atlas.visitor.ask("GET", f"/sites/gate.1/{tile}").body == files[tile]
        # A publisher that was killed amid its work begins again: what is half there is made whole.
        atlas.stop(signal.SIGKILL)
        shutil.rmtree(atlas.public / "sites" / "gate")
        (atlas.public / "items.json").unlink()
        with sqlite3.connect(atlas.folder / "atlas.sqlite") as database:
            database.execute("UPDATE site SET changed = 1")
            database.execute("UPDATE lease SET ends = 0")  # of the checks that were killed
        atlas.start()
        atlas.published()
        assert atlas.visitor.ask("GET", "/sites/gate/site.json").status == 200
        assert atlas.visitor.ask("GET", "/items.json").said["numberMatched"] == 1
        ends = time.monotonic() + 10
        while litter := [path for kind in ("incoming", "held") for path in (atlas.folder / "store" / kind).glob("*")]:
            assert time.monotonic() < ends, litter
            time.sleep(0.1)


def _quietly(somebody: Asker, path: str) -> None:
    with suppress(OSError, http.client.HTTPException):
        somebody.ask("POST", path, {})


def test_a_server_that_is_told_to_end_finishes_what_it_does(tmp_path: Path, files: dict[str, bytes]) -> None:
    with running(tmp_path / "a") as atlas:
        contributor = atlas.somebody()
        begun = contributor.begin(files).said
        contributor.send(begun, files)
        with ThreadPoolExecutor(1) as at_once:
            answer = at_once.submit(contributor.ask, "POST", f"/api/uploads/{begun['upload']}/finish", {})
            time.sleep(0.05)
            assert atlas.stop() in (0, -signal.SIGTERM)
            assert answer.result().status == 200


def test_a_full_disk_is_said_and_costs_nothing_that_was_taken(tmp_path: Path, files: dict[str, bytes]) -> None:
    """No file of the server's may grow beyond a size, which it learns as of a full disk."""
    with running(tmp_path / "a", more=LIMITS, limit=15_000_000) as atlas:
        contributor = atlas.somebody()
        begun = contributor.begin(files).said
        atlas.stop()
        size = max(path.stat().st_size for path in atlas.folder.glob("atlas.sqlite"))
        atlas.limit = size + 100_000
        atlas.start()
        number, path, _ = largest(begun)
        statuses = set()
        start = 0
        for _ in range(60):  # until the database's log can grow no more
            answer = contributor.ask(
                "PUT", f"/api/uploads/{begun['upload']}/{number}?start={start}", body=files[path][start : start + 300]
            )
            statuses.add(answer.status)
            if answer.status != 200:
                break
            start = answer.said["received"]
        assert statuses <= {200, 503, 507} and len(statuses) == 2, statuses
        assert "Nothing is lost" in answer.said["said"]
        atlas.stop(signal.SIGKILL)
        atlas.limit = 0
        atlas.start()
        assert contributor.ask("GET", f"/api/uploads/{begun['upload']}").said["files"][number]["received"] == start
        contributor.send(contributor.begin(files).said, files)
        assert contributor.ask("POST", f"/api/uploads/{begun['upload']}/finish", {}).status == 200


def test_a_database_that_is_locked_or_gone(tmp_path: Path, files: dict[str, bytes]) -> None:
    with running(tmp_path / "a") as atlas:
        contributor = atlas.somebody()
        with sqlite3.connect(atlas.folder / "atlas.sqlite", isolation_level=None) as other:
            other.execute("BEGIN EXCLUSIVE")
            with ThreadPoolExecutor(2) as at_once:
                answer = at_once.submit(contributor.begin, files)
                assert atlas.visitor.ask("GET", "/index.html").status == 200  # visitors notice nothing
                assert atlas.visitor.ask("GET", "/items.json").status == 200
                answer = answer.result()
            assert answer.status == 503 and answer.said["code"] == "database" and "retry-after" in answer.headers
            other.execute("ROLLBACK")
        assert contributor.begin(files).status == 200
        atlas.stop()
        (atlas.folder / "atlas.sqlite").rename(atlas.folder / "away")
        (atlas.folder / "atlas.sqlite").mkdir()
        assert "sqlite" in atlas.run("serve", code=2)


# ---- people

def test_two_moderators_at_once(atlas: Atlas, contributor: Asker, moderator: Asker, titled: dict[str, bytes]) -> None:
    second = atlas.somebody("moderator", "Second")
    version = contributor.upload(titled).said["version"]
    asked = [
        (moderator, "accept", {}),
        (second, "refuse", {"why": "no"}),
        (second, "accept", {}),
        (moderator, "refuse", {"why": "no"}),
    ] * 2
    with ThreadPoolExecutor(8) as at_once:
        answers = list(at_once.map(lambda one: one[0].ask("POST", f"/api/versions/{version}/{one[1]}", one[2]), asked))
    assert sorted(one.status for one in answers) == [200] + [409] * 7
    assert all(one.said["code"] == "decided" for one in answers if one.status == 409)
    lines = [line for line in moderator.ask("GET", "/api/audit").said["lines"] if line["subject"] == version]
    assert sum(line["action"] in ("accepted", "refused") for line in lines) == 1
    atlas.published()


def test_hostile_letters_in_every_field(
    atlas: Atlas, contributor: Asker, moderator: Asker, titled: dict[str, bytes]
) -> None:
    long, html = "x" * 10_000, "<script>alert(1)</script>\"'&"
    record = json.loads(titled["site.json"])
    bad = {
        "title": ("\u202egpj.exe", long, "a\0b"),
        "text": ("\u2066", long),
        "place": ("a\x9bb", long),
        "credit": ("\x1b[0m", long),
        "licence": ("\u200b", long),
    }
    for name, texts in bad.items():
        for text in texts:
            changed = {**titled, "site.json": json.dumps({**record, name: text}).encode()}
            assert contributor.upload(changed).status == 422, (name, text[:20])
    for added in (
        {"tags": [long]},
        {"tags": ["x"] * 21},
        {"tags": [""]},
        {"register": long},
        {"register": "a\u202eb"},
        {"more": 1},
        {"period_from": 5},
        {"period_from": 5, "period_to": 4},
        {"period_from": 1e9, "period_to": 1e9},
        {"tags": "x"},
        {"exact": {"latitude": 91, "longitude": 0}},
        {"exact": {"latitude": 1}},
    ):
        assert contributor.begin(titled, **added).status == 422, added
    version = contributor.upload(
        {**titled, "site.json": json.dumps({**record, **dict.fromkeys(("place", "text"), html)}).encode()},
        tags=[html[:40]],
        register="../../etc",
    ).said["version"]
    assert moderator.ask("POST", f"/api/versions/{version}/refuse", {"why": long}).status == 400
    assert moderator.ask("POST", f"/api/versions/{version}/accept", {}).status == 200
    atlas.published()
    for path in atlas.public.rglob("*"):
        if path.suffix in (".html", ".xml") and "pages" not in path.parts:
            assert b"<script>alert" not in path.read_bytes(), path
    for asked in (
        long,
        "%00",
        "%22%20OR%20*",
        "%27%3B%20DROP%20TABLE%20site",
        "a%20NEAR%20b",
        "(((",
        "*",
        "-",
        "^",
        "%E2%80%AE",
    ):
        assert atlas.visitor.ask("GET", f"/api/search?q={asked}").status in (200, 400), asked
    for asked in ("from=x", "page=0", "page=99999999999", "box=1", "box=a,b,c,d", "from=1e9"):
        assert atlas.visitor.ask("GET", f"/api/search?{asked}").status == 400, asked
    for name in (long, "a\0b", "x", " ", "<b>", "a\u202eb", "../x"):
        token = _invitation(atlas)
        assert atlas.visitor.ask("POST", "/api/join", {"token": token, "name": name, "password": PASSWORD}).status in (
            400,
            413,
        ), name
    for body in (
        b"[" * 100_000,
        b"{",
        b'{"name": 1}',
        b"\xff",
        b"null",
        b'"x"',
        b'{"name":"a","password":"b","more":1}',
    ):
        assert atlas.visitor.ask("POST", "/api/session", body=body, Content_Type="application/json").status == 400
    assert (
        atlas.visitor.ask("POST", "/api/session", body=b"x" * (3 << 20), Content_Type="application/json").status == 413
    )
    assert atlas.visitor.ask("POST", "/api/session", body=b"name=a&password=b").status == 415


def _invitation(atlas: Atlas, role: str = "contributor") -> str:
    database = Database(f"sqlite:///{atlas.folder / 'atlas.sqlite'}")
    with database.write() as transaction:
        token = people.invite(transaction, role, "console")
    database.close()
    return token


@pytest.mark.parametrize(
    "path",
    [
        "/../atlas.toml",
        "/..%2f..%2fatlas.toml",
        "/%2e%2e/%2e%2e/atlas.toml",
        "/sites/../../../atlas.toml",
        "/pages/..%5c..%5catlas.toml",
        "/desk/../../atlas.toml",
        "/desk/..%2f__main__.py",
        "/held/pages/..%2f..%2fcore",
        "/.env",
        "/sites/.gate.partial/x",
        "//etc/passwd",
        "/sites/gate%00.json",
        "/held/sites/../../incoming",
        "/catalogue/map/0/..%2f..%2f..%2f..%2fatlas.toml",
    ],
)
def test_paths_that_lead_out_of_what_is_public(atlas: Atlas, moderator: Asker, path: str) -> None:
    for somebody in (atlas.visitor, moderator):
        answer = somebody.ask("GET", path)
        assert answer.status in (400, 404, 307) and b"places_key" not in answer.body and b"import" not in answer.body


def test_tokens_that_are_forged_old_stolen_or_ended(atlas: Atlas, files: dict[str, bytes]) -> None:
    somebody = atlas.somebody("moderator", "Token")
    token = somebody.ask("POST", "/api/tokens", {"label": "laptop"}).said["token"]
    blender = Asker(atlas.port, token=token)
    assert blender.begin(files).status == 200
    for forged in (
        token[:-1],
        token + "x",
        token.upper(),
        "atlas_" + "a" * 43,
        "'",
        "x" * 5000,
        somebody.cookie.partition("=")[2],
    ):
        assert replace(blender, token=forged).begin(files).status == 401, forged
    # A stolen token of a moderator uploads, and does nothing else.
    for method, path in (
        ("GET", "/api/held"),
        ("GET", "/api/audit"),
        ("GET", "/api/me"),
        ("GET", "/api/mine"),
        ("POST", "/api/tokens"),
        ("POST", "/api/invitations"),
        ("POST", "/api/sites/gate/remove"),
        ("GET", "/api/sites/gate/place"),
        ("POST", "/api/versions/x/accept"),
        ("POST", "/api/password"),
    ):
        assert blender.ask(method, path, {} if method == "POST" else None).status == 403, path
    (listed_,) = somebody.ask("GET", "/api/tokens").said["tokens"]
    assert token not in json.dumps(listed_) and somebody.ask("DELETE", f"/api/tokens/{listed_['id']}").status == 200
    assert blender.begin(files).status == 401
    old = somebody.ask("POST", "/api/tokens", {"label": ""}).said["token"]
    with sqlite3.connect(atlas.folder / "atlas.sqlite") as database:
        database.execute("UPDATE token SET ends = ? WHERE digest = ?", (now() - 1, people.digest(old)))
        assert token not in str(list(database.execute("SELECT * FROM token"))) and old not in str(
            list(database.execute("SELECT * FROM token"))
        )
    assert Asker(atlas.port, token=old).begin(files).status == 401
    # A session ends with sign-out, and all of them with a new password.
    other = Asker(atlas.port, *_signed_in(atlas, "Token"))
    assert other.ask("DELETE", "/api/session").status == 200 and other.ask("GET", "/api/me").status == 401
    assert somebody.ask("POST", "/api/password", {"old": "wrong", "new": "another horse battery"}).status == 403
    assert somebody.ask("POST", "/api/password", {"old": PASSWORD, "new": "another horse battery"}).status == 200
    assert somebody.ask("GET", "/api/me").status == 401


def _signed_in(atlas: Atlas, name: str, password: str = PASSWORD) -> tuple[str, str]:
    answer = atlas.visitor.ask("POST", "/api/session", {"name": name, "password": password})
    assert answer.status == 200, answer.said
    assert (
        "httponly" in answer.headers["set-cookie"].lower() and "samesite=strict" in answer.headers["set-cookie"].lower()
    )
    return answer.headers["set-cookie"].partition(";")[0], answer.said["guard"]


def test_what_another_sites_page_asks_for(atlas: Atlas, contributor: Asker) -> None:
    for changed in (replace(contributor, guard=""), replace(contributor, guard="0" * 64)):
        assert changed.ask("POST", "/api/tokens", {"label": ""}).said["code"] == "guard"
    assert contributor.ask("POST", "/api/tokens", {"label": ""}, Origin="https://evil.example").said["code"] == "origin"
    assert (
        atlas.visitor.ask("POST", "/api/session", {"name": "a", "password": "b"}, Origin="https://evil.example").status
        == 403
    )
    answer = contributor.ask("GET", "/api/me", Origin="https://evil.example")
    assert "access-control-allow-origin" not in answer.headers and answer.headers["cache-control"] == "no-store"
    for path in ("/", "/desk/", "/api/me", "/nothing"):
        policy = atlas.visitor.ask("GET", path).headers["content-security-policy"]
        assert "default-src 'none'" in policy and "unsafe" not in policy and "frame-ancestors 'none'" in policy
        assert "set-cookie" not in atlas.visitor.ask("GET", path).headers


def test_each_role_does_what_is_its_own(
    atlas: Atlas, contributor: Asker, moderator: Asker, titled: dict[str, bytes]
) -> None:
    official = atlas.somebody("official", "Officer")
    version = contributor.upload(titled).said["version"]
    for somebody in (contributor, official):
        for method, path in (("GET", "/api/held"), ("GET", "/api/audit"), ("POST", f"/api/versions/{version}/accept"),
                             ("POST", "/api/invitations"), ("POST", f"/api/versions/{version}/refuse")):
            value = {"why": "x"} if path.endswith("refuse") else {"role": "moderator"} if "inv" in path else {}
            assert somebody.ask(method, path, value if method == "POST" else None).status == 403, path
    assert atlas.visitor.ask("GET", "/api/held").status == 401
    account = contributor.ask("GET", "/api/me").said["id"]
    assert official.ask("DELETE", f"/api/accounts/{account}").status == 403
    link = moderator.ask("POST", "/api/invitations", {"role": "official"}).said["link"]
    token = link.partition("#join=")[2]
    given = {"token": token, "name": "New Official", "password": PASSWORD}
    assert atlas.visitor.ask("POST", "/api/join", {**given, "password": "short"}).status == 400
    assert atlas.visitor.ask("POST", "/api/join", {**given, "name": "conrad"}).said["code"] == "taken"
    with ThreadPoolExecutor(4) as at_once:
        joins = list(
            at_once.map(
                lambda n: atlas.visitor.ask("POST", "/api/join", {**given, "name": f"New {n}"}).status, range(4)
            )
        )
    assert sorted(joins) == [200, 403, 403, 403]  # an invitation is used once


def test_guessing_passwords_and_asking_too_often(tmp_path: Path) -> None:
    with running(tmp_path / "a") as atlas:
        atlas.somebody(name="Victim")
        statuses = [
            atlas.visitor.ask("POST", "/api/session", {"name": "victim", "password": f"guess {n}"}).status
            for n in range(11)
        ]
        assert statuses[0] == 403 and statuses[-1] == 429
        assert atlas.visitor.ask("POST", "/api/session", {"name": "Victim", "password": PASSWORD}).status == 429
        assert "retry-after" in atlas.visitor.ask("POST", "/api/session", {"name": "Victim", "password": "x"}).headers


def test_the_audit_log_is_only_added_to(atlas: Atlas, moderator: Asker) -> None:
    with sqlite3.connect(atlas.folder / "atlas.sqlite") as database:
        for statement in ("UPDATE audit SET action = 'nothing'", "DELETE FROM audit"):
            with pytest.raises(sqlite3.IntegrityError, match="only added to"):
                database.execute(statement)
    assert moderator.ask("DELETE", "/api/audit").status == 405


def test_figures_and_health_are_there_and_tell_nothing_to_strangers(atlas: Atlas) -> None:
    assert atlas.visitor.ask("GET", "/metrics").status == 404
    assert atlas.visitor.ask("GET", "/metrics", Authorization="Bearer wrong").status == 404
    figures = atlas.visitor.ask("GET", "/metrics", Authorization="Bearer 0123456789abcdef").body.decode()
    assert "atlas_requests_total{" in figures and "atlas_received_bytes_total" in figures
    assert atlas.visitor.ask("GET", "/health").said == {"status": "ok"}
    for line in atlas.log.splitlines():
        assert set(json.loads(line)) >= {"at", "level", "logger", "said"}, line
    assert PASSWORD not in atlas.log and "join=" not in atlas.log


def test_wrong_configurations_are_said(tmp_path: Path) -> None:
    for change, said in (
        ('address = "http://atlas.example"', "https"),
        ("addres = 1", "addres"),
        ("[", "toml|Invalid|atlas"),
        ('places_key = "eA=="', "32 bytes"),
        ("[limits]\nchunk = -1", "chunk"),
        ('metrics_token = "x"', "16"),
    ):
        (tmp_path / "atlas.toml").write_text(change)
        with pytest.raises(configuration.ConfigurationError, match=said):
            configuration.read(tmp_path / "atlas.toml")
