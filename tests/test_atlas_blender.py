# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The whole way from Blender to the public map, and what each level of privacy tells after it."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import published
import pytest
from atlas_run import Asker, listed, make_site, running
from conftest import curecon
from test_extension import blender, run_script  # noqa: F401
from test_publish import only_site, site, told  # noqa: F401

from curecon_blender.core.base.options import CELL, EXACT, HIDDEN, TOKEN_VARIABLE


@pytest.mark.parametrize("blender", ["4.5"], indirect=True)
def test_the_button_in_blender_to_the_public_map(blender: Path, tmp_path: Path) -> None:  # noqa: F811
    (tmp_path / "work").mkdir()
    with running(tmp_path / "atlas") as atlas:
        contributor, moderator = atlas.somebody(), atlas.somebody("moderator")
        token = contributor.ask("POST", "/api/tokens", {"label": "Blender"}).said["token"]
        run_script(blender, "check_upload.py", tmp_path / "work", Path(sys.executable), atlas.address, token,  # type: ignore[arg-type]
                   resources=tmp_path / "user")
        (held,) = moderator.ask("GET", "/api/held").said["held"]
        assert (
            held["title"] == "From Blender"
            and moderator.ask("POST", f"/api/versions/{held['id']}/accept", {}).status == 200
        )
        atlas.published()
        (feature,) = atlas.visitor.ask("GET", "/items.json").said["features"]
        assert feature["properties"]["title"] == "From Blender" and feature["geometry"] is None
        record = atlas.visitor.ask("GET", f"/sites/{feature['id']}/site.json").said
        assert record["tags"] == ["earth", "圆楼", "round"] and record["register"] == "CN-1113"
        assert record["period"] == [-20, 220]
        assert atlas.visitor.ask("GET", "/api/search?tag=%E5%9C%86%E6%A5%BC&to=-19").said["numberMatched"] == 1


def test_the_command_goes_on_where_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = make_site(tmp_path / "p")
    with running(tmp_path / "atlas", more="[limits]\nchunk = 20000\n") as atlas:
        contributor = atlas.somebody()
        monkeypatch.setenv(TOKEN_VARIABLE, contributor.ask("POST", "/api/tokens", {"label": ""}).said["token"])
        files = listed(made)
        begun = contributor.begin(files).said
        contributor.ask(
            "PUT", f"/api/uploads/{begun['upload']}/0?start=0", body=files[begun["files"][0]["path"]][:20000]
        )
        run = curecon("upload", made.parent.parent, "--to", atlas.address)
        assert run.code == 0 and run.summary["bytes"] == sum(map(len, files.values())), run.said
        (version,) = contributor.ask("GET", "/api/mine").said["versions"]
        assert version["id"] == run.summary["version"] and version["state"] == "held"
        record = json.loads((made / "site.json").read_text())
        (made / "site.json").write_text(json.dumps({**record, "title": "a\u202eb"}))
        refused = curecon("upload", made.parent.parent, "--to", atlas.address)
        assert refused.code == 17 and "invisible letter" in refused.said
        refused = curecon("upload", made.parent.parent, "--to", atlas.address, "--language", "zh_HANS")
        assert refused.code == 17 and "不可见字符" in refused.said
        assert curecon("upload", tmp_path, "--to", atlas.address).code == 15
        monkeypatch.setenv(TOKEN_VARIABLE, "")
        assert curecon("upload", made, "--to", atlas.address).code == 17


def test_each_level_of_privacy_tells_no_more_after_a_round_through_the_atlas(
    site: Callable[[str], Path], told: Path, tmp_path: Path  # noqa: F811
) -> None:
    """Every byte of the export is searched, as every byte of a published folder is. The exact place was left for
    officials: no file tells it."""
    needles = published.needles(told)
    with running(tmp_path / "atlas") as atlas:
        contributor, moderator = atlas.somebody(), atlas.somebody("moderator")
        for location in (CELL, HIDDEN):
            _accepted(contributor, moderator, listed(only_site(site(location))),
                      exact={"latitude": 24.658307, "longitude": 117.052089})
        atlas.published()
        atlas.run("export", tmp_path / "below")
        assert (
            len([*(tmp_path / "below" / "sites").glob("*/site.json")]) == 3
        )  # two versions, and the newest one's address
        assert not (found := published.telling(tmp_path / "below", needles)), "\n".join(found)
        _accepted(contributor, moderator, listed(only_site(site(EXACT))))
        atlas.published()
        atlas.run("export", tmp_path / "exact")
        found = "\n".join(published.telling(tmp_path / "exact", needles))
        assert "item.json: latitude as text" in found and "site.json: longitude as text" in found
        assert "photo DJI" not in found and "time of" not in found


def _accepted(contributor: Asker, moderator: Asker, files: dict[str, bytes], **added: object) -> None:
    answer = contributor.upload(files, **added)
    assert answer.status == 200, answer.said
    assert moderator.ask("POST", f"/api/versions/{answer.said['version']}/accept", {}).status == 200
