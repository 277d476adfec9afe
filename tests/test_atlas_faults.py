# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What goes wrong at an atlas: cut uploads, a killed server, a full disk, a locked database."""

from __future__ import annotations

import http.client
import shutil
import signal
import socket
import sqlite3
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from atlas_run import CHUNK, LIMITS, Asker, Atlas, running


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


def test_whoever_is_cut_off_while_files_are_checked_asks_again(
    atlas: Atlas, contributor: Asker, titled: dict[str, bytes]
) -> None:
    begun = contributor.begin(titled).said
    contributor.send(begun, titled)
    for _ in range(3):
        with socket.create_connection(("127.0.0.1", atlas.port)) as line:
            line.sendall((f"POST /api/uploads/{begun['upload']}/finish HTTP/1.1\r\nHost: 127.0.0.1\r\nCookie: "
                          f"{contributor.cookie}\r\nX-Atlas-Guard: {contributor.guard}\r\nContent-Length: 0\r\n\r\n"
                          ).encode())
    answer = contributor.ask("POST", f"/api/uploads/{begun['upload']}/finish", {})
    assert answer.status == 200
    mine = contributor.ask("GET", "/api/mine").said["versions"]
    assert [one["id"] for one in mine if one["site"] == answer.said["site"]] == [answer.said["version"]]
    assert (atlas.folder / "store" / "held" / answer.said["version"] / "thumbnail.jpg").is_file()


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

        for wait in (0.001, 0.01):  # amid the acceptance, until it is told
            asking = threading.Thread(target=_quietly, args=(moderator, f"/api/versions/{version}/accept"))
            asking.start()
            time.sleep(wait)
            atlas.stop(signal.SIGKILL)
            asking.join()
            atlas.start()
        answer = moderator.ask("POST", f"/api/versions/{version}/accept", {})
        assert answer.status == 200 or answer.said["code"] == "decided"
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


@pytest.mark.parametrize("mounted", ["size=20m"], indirect=True)
def test_a_disk_that_is_full(mounted: Path, files: dict[str, bytes]) -> None:
    with running(mounted / "a", more=LIMITS) as atlas:
        contributor = atlas.somebody()
        begun = contributor.begin(files).said
        (mounted / "filler").write_bytes(bytes(shutil.disk_usage(mounted).free - 50_000))
        number, path, _ = largest(begun)
        start, answers = 0, []
        while not answers or (answers[-1].status == 200 and len(answers) < 100):
            answers.append(contributor.ask("PUT", f"/api/uploads/{begun['upload']}/{number}?start={start}",
                                           body=files[path][start : start + 2000]))
            start = (answers[-1].said or {}).get("received", start)
        assert answers[-1].status in (503, 507) and "Nothing is lost" in answers[-1].said["said"]
        assert atlas.visitor.ask("GET", "/index.html").status == 200
        (mounted / "filler").unlink()
        again = contributor.begin(files).said
        assert again["files"][number]["received"] == start
        contributor.send(again, files)
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
