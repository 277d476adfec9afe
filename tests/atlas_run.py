# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A little published site, an atlas in a process of its own, and people who ask it things."""

from __future__ import annotations

import hashlib
import http.client
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
from conftest import ROOT
from little_site import CREDIT, FRAME, little_site

from atlas import configuration, people
from atlas.database import Database
from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.base.options import CELL
from curecon_blender.core.base.records import Component, Frame
from curecon_blender.core.publish import folder as published
from curecon_blender.core.publish.records import About, Note
from curecon_blender.core.publish.write import Source, write_site

PASSWORD = "correct horse battery"
CHUNK = 20_000
LIMITS = f"[limits]\nchunk = {CHUNK}\nuploads = 100\n"
_PATIENCE = 120  # seconds for a server to come up on a busy computer


def make_site(folder: Path, title: str = "Gate", location: str = CELL, frame: Frame = FRAME, **about: Any) -> Path:
    """The folder of a published little site."""
    folder.mkdir(parents=True)
    little_site(folder)
    source = Source(
        workspace=folder / "w",
        component=Component(index=0, sparse="sparse/0", cloud="cloud.ply", frame=frame),
        frame=frame,
        matrix=np.eye(4),
        mesh=folder / "w" / "mesh.ply",
        taken=date(2024, 9, 28),
    )
    said = {"text": "A round house.", "place": "Fujian", "credit": CREDIT, "licence": "CC-BY-4.0",
            "notes": (Note(title="Door", text="Oak", place=(1.0, 2.0, 0.5)),), **about}
    made = About(title=title, location=location, **said)
    with published.site_folder(folder, made.id) as place:
        write_site(source, made, place, Reporter())
    return folder / published.SITES / made.id


def listed(site: Path) -> dict[str, bytes]:
    """The files of a site that an atlas takes."""
    return {path.relative_to(site).as_posix(): path.read_bytes() for path in sorted(site.rglob("*"))
            if path.is_file() and path.name not in ("index.html", "item.json", "report.pdf")}


@dataclass
class Answer:
    status: int
    said: Any
    headers: dict[str, str] = field(default_factory=dict)
    body: bytes = b""


@dataclass
class Asker:
    """Somebody who asks the atlas: a visitor, or by session or token."""

    port: int
    cookie: str = ""
    guard: str = ""
    token: str = ""

    def ask(self, method: str, path: str, value: Any = None, *, body: bytes | None = None, **more: str) -> Answer:
        headers = {"Cookie": self.cookie, "X-Atlas-Guard": self.guard, "Authorization": f"Bearer {self.token}"}
        headers = {name: text for name, text in headers.items() if text and text != "Bearer "}
        headers |= {name.replace("_", "-"): text for name, text in more.items()}
        if value is not None:
            body = json.dumps(value).encode()
            headers.setdefault("Content-Type", "application/json")
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        try:
            connection.request(method, path, body, headers)
            answer = connection.getresponse()
            content = answer.read()
            kind = answer.headers.get_content_type()
            return Answer(answer.status, json.loads(content) if kind == "application/json" and content else None,
                          {name.lower(): text for name, text in answer.getheaders()}, content)
        finally:
            connection.close()

    def begin(self, files: dict[str, bytes], **added: Any) -> Answer:
        return self.ask("POST", "/api/uploads", {"added": added, "files": [
            {"path": path, "size": len(content), "sha256": hashlib.sha256(content).hexdigest()}
            for path, content in files.items()]})

    def send(self, begun: dict[str, Any], files: dict[str, bytes]) -> None:
        for number, one in enumerate(begun["files"]):
            content, start = files[one["path"]], one["received"]
            while start < len(content):
                part = content[start : start + begun["chunk"]]
                answer = self.ask("PUT", f"/api/uploads/{begun['upload']}/{number}?start={start}", body=part)
                assert answer.status == 200, answer.said
                start = answer.said["received"]

    def upload(self, files: dict[str, bytes], **added: Any) -> Answer:
        """The answer to the upload's last request."""
        begun = self.begin(files, **added)
        if begun.status != 200:
            return begun
        self.send(begun.said, files)
        return self.ask("POST", f"/api/uploads/{begun.said['upload']}/finish", {})


@dataclass
class Atlas:
    folder: Path
    port: int
    more: str = ""
    database: str = "sqlite:///atlas.sqlite"
    store: str = "store"
    process: subprocess.Popen[bytes] | None = None
    environment: dict[str, str] = field(default_factory=dict)
    limit: int = 0  # bytes that a file of the server's may have; 0: no limit

    def __post_init__(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        self.configuration.write_text(
            f'address = "{self.address}"\nlisten = "127.0.0.1:{self.port}"\ndatabase = "{self.database}"\nstore = '
            f'"{self.store}"\nplaces_key = "{"QUJD" * 10}QUI="\nmetrics_token = "0123456789abcdef"\n{self.more}')

    @property
    def configuration(self) -> Path:
        return self.folder / "atlas.toml"

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    @property
    def public(self) -> Path:
        return self.folder / "store" / "public"

    @property
    def visitor(self) -> Asker:
        return Asker(self.port)

    def command(self, *arguments: object) -> list[str]:
        return [sys.executable, "-m", "atlas", str(arguments[0]), str(self.configuration), *map(str, arguments[1:])]

    def run(self, *arguments: object, code: int = 0) -> str:
        ran = subprocess.run(self.command(*arguments), cwd=ROOT, capture_output=True, text=True, check=False,
                             env={**os.environ, **self.environment})
        assert ran.returncode == code, ran.stderr
        return ran.stdout if code == 0 else ran.stderr

    def start(self) -> None:
        def limited() -> None:
            if self.limit:
                import resource

                signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
                resource.setrlimit(resource.RLIMIT_FSIZE, (self.limit, self.limit))

        with (self.folder / "log").open("ab") as log:
            self.process = subprocess.Popen(self.command("serve"), cwd=ROOT, stderr=log, stdout=log, preexec_fn=limited,
                                            env={**os.environ, **self.environment})
        ends = time.monotonic() + _PATIENCE
        while True:
            try:
                if self.visitor.ask("GET", "/health").status == 200:
                    return
            except OSError:
                pass
            assert self.process.poll() is None and time.monotonic() < ends, self.log[-3000:]
            time.sleep(0.05)

    def stop(self, how: int = signal.SIGTERM) -> int:
        assert self.process is not None
        self.process.send_signal(how)
        code = self.process.wait(_PATIENCE)
        self.process = None
        return code

    @property
    def log(self) -> str:
        return (self.folder / "log").read_text()

    def somebody(self, role: str = "contributor", name: str = "") -> Asker:
        """Somebody who has joined and signed in."""
        database = Database(configuration.read(self.configuration).database)
        with database.write() as transaction:
            token = people.invite(transaction, role, "console")
        database.close()
        answer = self.visitor.ask(
            "POST", "/api/join", {"token": token, "name": name or f"a {role}", "password": PASSWORD}
        )
        assert answer.status == 200, answer.said
        return Asker(self.port, answer.headers["set-cookie"].partition(";")[0], answer.said["guard"])

    def published(self) -> None:
        """Wait until what was decided can be seen."""
        ends = time.monotonic() + _PATIENCE
        while (
            b"atlas_changed 0.0"
            not in self.visitor.ask("GET", "/metrics", Authorization="Bearer 0123456789abcdef").body
        ):
            assert time.monotonic() < ends, self.log[-3000:]
            time.sleep(0.05)


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


@contextmanager
def running(folder: Path, **facts: Any) -> Iterator[Atlas]:
    atlas = Atlas(folder, free_port(), **facts)
    atlas.start()
    try:
        yield atlas
    finally:
        if atlas.process is not None:
            atlas.stop(signal.SIGKILL)
