# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Everything out of an atlas and back: export, backup, restore, whatever is killed meanwhile."""

from __future__ import annotations

import json
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest
from atlas_run import Asker, Atlas, free_port, listed, make_site, running
from conftest import ROOT, MakeOnce

from atlas import configuration, local, server
from curecon_blender.core.base.options import CELL, EXACT, HIDDEN

PLACE = {"latitude": 24.658307, "longitude": 117.052089}


@pytest.fixture(scope="module")
def full(made_once: MakeOnce[Atlas]) -> Atlas:
    """An atlas that does not run: a public site of two versions, a hidden one with a sealed place, one taken down, one
    held, and an upload that is not finished. Read only."""
    def make(folder: Path) -> Atlas:
        sites = {
            title: make_site(folder / title, title, location)
            for title, location in (("Gate", CELL), ("Secret", HIDDEN), ("Gone", EXACT),
                                                    ("Held", CELL), ("Open", CELL))
        }
        with running(folder / "a") as atlas:
            contributor, moderator = atlas.somebody(name="Conrad"), atlas.somebody("moderator", "Moira")
            for title, added in (("Gate", {}), ("Gate", {"tags": ["土楼"]}), ("Secret", {"exact": PLACE}),
                                 ("Gone", {})):
                version = contributor.upload(listed(sites[title]), **added).said["version"]
                assert moderator.ask("POST", f"/api/versions/{version}/accept", {}).status == 200
            contributor.ask("POST", "/api/sites/gone/remove", {"why": "x"})
            contributor.upload(listed(sites["Held"]))
            contributor.begin(listed(sites["Open"]))
            atlas.published()
            atlas.stop()
        return atlas
    return made_once("full_atlas", make)


def files(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()
    }


def test_a_backup_makes_the_same_atlas_again(full: Atlas, tmp_path: Path) -> None:
    full.run("backup", tmp_path / "backup")
    assert "is there already" in full.run("backup", tmp_path / "backup", code=2)
    other = Atlas(tmp_path / "other", free_port(), more=f'title = "{"Sites"}"\n')
    other.run("restore", tmp_path / "backup")
    assert "not empty" in other.run("restore", tmp_path / "backup", code=2)
    other.start()
    try:
        other.published()
        first, second = files(full.public), files(other.public)
        assert first.keys() == second.keys()
        changed = [name for name in first
                   if first[name] != second[name].replace(other.address.encode(), full.address.encode())]
        assert not changed
        moved = Asker(other.port, *_signed_in(other, "Moira"))
        assert [one["title"] for one in moved.ask("GET", "/api/held").said["held"]] == ["Held"]
        assert moved.ask("GET", "/api/audit").said["lines"][-1]["action"] == "invite"
        assert other.visitor.ask("GET", "/api/search?q=%E5%9C%9F%E6%A5%BC").said["numberMatched"] == 1
        official = other.somebody("official")
        assert official.ask("GET", "/api/sites/secret/place").said == PLACE
        version = moved.ask("GET", "/api/held").said["held"][0]["id"]
        assert moved.ask("POST", f"/api/versions/{version}/accept", {}).said == {"site": "held"}
        other.published()
        assert other.visitor.ask("GET", "/sites/held/").status == 200
    finally:
        other.stop()
    (tmp_path / "backup" / "files").rename(tmp_path / "away")
    spoiled = Atlas(tmp_path / "spoiled", free_port())
    assert spoiled.run("restore", tmp_path / "backup", code=2)
    (tmp_path / "backup" / "backup.json").write_text('{"format": 99}')
    assert "another version" in spoiled.run("restore", tmp_path / "backup", code=2)


def _signed_in(atlas: Atlas, name: str) -> tuple[str, str]:
    answer = atlas.visitor.ask("POST", "/api/session", {"name": name, "password": "correct horse battery"})
    return answer.headers["set-cookie"].partition(";")[0], answer.said["guard"]


def test_an_export_is_what_visitors_get_and_can_be_killed(full: Atlas, tmp_path: Path) -> None:
    for wait in (0.4, 0.9, 1.4):  # somewhere between its start and its end
        killed = subprocess.Popen(
            full.command("export", tmp_path / "out"), cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )
        time.sleep(wait)
        killed.send_signal(signal.SIGKILL)
        killed.wait()
        killed.communicate()
        assert (tmp_path / "out").exists() is ((tmp_path / "out" / "items.json").exists())
        if (tmp_path / "out").exists():
            break
    else:
        full.run("export", tmp_path / "out")
    first, second = files(full.public), files(tmp_path / "out")
    assert first.keys() == second.keys() and not [name for name in first if "partial" in name]
    assert {name for name in first if first[name] != second[name]} == {"items.json"}  # nobody searches for it there
    links = {link["rel"] for link in json.loads(second["items.json"])["links"]}
    assert "tiles" in links and "search" not in links
    for site in ("sites/gone.1", "sites/held"):
        assert not any(name.startswith(site) for name in first)
    # A site comes out as it can go in again.
    parts = server.assemble(configuration.read(Atlas(tmp_path / "again", free_port()).configuration))
    assert local.add(parts, _sent(tmp_path / "out" / "sites" / "gate.2", tmp_path / "sent")) == "gate"


def _sent(site: Path, target: Path) -> Path:
    """What an atlas added is taken off a site's record, as a publisher wrote it."""
    target.mkdir()
    for name, content in files(site).items():
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        (target / name).write_bytes(content)
    record: dict[str, Any] = json.loads((target / "site.json").read_text())
    for name in ("address", "tags", "register", "period", "newest", "versions"):
        record.pop(name, None)
    (target / "site.json").write_text(json.dumps(record))
    return target


def test_static_files_are_made_anew_by_a_command(full: Atlas, tmp_path: Path) -> None:
    full.run("backup", tmp_path / "backup")
    other = Atlas(tmp_path / "other", free_port())
    other.run("restore", tmp_path / "backup")
    before = files(other.public)
    for name in ("items.json", "sites/gate/index.html", "catalogue/map/0/world.json", "pages/map.js"):
        (other.public / name).write_bytes(b"spoiled")
    other.run("rebuild")
    assert files(other.public) == before
