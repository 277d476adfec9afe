# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the machine's owner does at its console: publish a folder without the network, through the same checks."""

from __future__ import annotations

import hashlib
from pathlib import Path

from . import people
from .database import now
from .people import CONTRIBUTOR, MODERATOR, SESSION, Person
from .problems import refused
from .requests import Parts

CONSOLE = Person("console", "console", MODERATOR, SESSION)
_OWN = {"index.html", "item.json", "report.pdf"}  # the atlas makes its own, or takes none


def add(parts: Parts, site: Path) -> str:
    """Publish a site's folder in the console's name; its name in the atlas. Raises Problem."""
    with parts.database.write() as transaction:
        if not transaction.one("SELECT id FROM account WHERE id = :id", id=CONSOLE.id):
            transaction.run("INSERT INTO account VALUES (:id, :id, :role, '', :now, :now)", id=CONSOLE.id,
                            role=CONTRIBUTOR, now=now())  # closed: nobody can sign in to it
            people.note(transaction, CONSOLE.id, "join", CONTRIBUTOR)
    files = {path.relative_to(site).as_posix(): path for path in sorted(site.rglob("*"))
             if path.is_file() and path.name not in _OWN}
    if "site.json" not in files:
        raise refused(f"{site} is no published site.")
    begun = parts.uploads.begin(CONSOLE, {"files": [
        {"path": name, "size": path.stat().st_size, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
        for name, path in files.items()]})
    for number, one in enumerate(begun["files"]):
        content, start = files[one["path"]].read_bytes(), one["received"]
        while start < len(content):
            part = content[start : start + begun["chunk"]]
            start = parts.uploads.add(CONSOLE, begun["upload"], number, start, part)
    held = parts.uploads.finish(CONSOLE, begun["upload"])
    name = parts.sites.accept(CONSOLE, held["version"])
    while parts.publisher.publish():
        pass
    return name
