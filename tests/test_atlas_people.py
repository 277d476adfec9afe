# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""People at an atlas who try what they may not: hostile letters and paths, tokens, roles, passwords, the audit log."""

from __future__ import annotations

import json
import sqlite3
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest
from atlas_run import PASSWORD, Asker, Atlas, running

from atlas import configuration, people
from atlas.database import Database, now


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
    for text in (long, "a\u202eb", "a\x1bb"):
        assert moderator.ask("POST", f"/api/versions/{version}/refuse", {"why": text}).status == 400
        assert contributor.ask("POST", "/api/sites/gate/remove", {"why": text}).status == 400
        assert contributor.ask("POST", "/api/tokens", {"label": text}).status == 400
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
    assert official.ask("GET", "/api/accounts").status == 403
    leaving = atlas.somebody(name="Leaving")
    (known,) = [one for one in moderator.ask("GET", "/api/accounts").said["accounts"] if one["name"] == "Leaving"]
    assert known["role"] == "contributor" and moderator.ask("DELETE", f"/api/accounts/{known['id']}").status == 200
    assert leaving.ask("GET", "/api/me").status == 401
    assert known["id"] not in json.dumps(moderator.ask("GET", "/api/accounts").said)
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
