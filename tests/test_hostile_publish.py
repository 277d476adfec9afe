# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What cannot be published, and where not: each is said, and what was published before is left as it was."""

from __future__ import annotations

import fcntl
import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import published
import pytest
from conftest import Run, curecon
from little_site import CREDIT
from test_extension import blender, run_script  # noqa: F401

from curecon_blender.core.base.errors import WorkspaceError
from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.base.options import CELL, EXACT, HIDDEN
from curecon_blender.core.publish.records import About, Note, PublishError, read_notes
from curecon_blender.core.run.publish import publish
from curecon_blender.core.surface.mesh import Mesh, read_mesh, write_mesh


def test_the_button_in_blender(blender: Path, tmp_path: Path) -> None:  # noqa: F811
    (tmp_path / "work").mkdir()
    run_script(blender, "check_publish.py", tmp_path / "work", Path(sys.executable), resources=tmp_path / "user")


@pytest.fixture
def workspace(textured: tuple[Path, Run], tmp_path: Path) -> Path:
    """A copy to be spoiled, without what publishing does not need."""
    shutil.copytree(textured[0], tmp_path / "w", ignore=shutil.ignore_patterns("depth", "undistorted"))
    return tmp_path / "w"


def record(folder: Path) -> dict[str, object]:
    (path,) = (folder / "sites").glob("*/site.json")
    found: dict[str, object] = json.loads(path.read_text())
    return found


ABOUT = About(title="Gate", location=CELL, credit=CREDIT)


def test_a_workspace_without_a_mesh_shows_its_cloud_and_says_so(finished: tuple[Path, Run], tmp_path: Path) -> None:
    shutil.copytree(finished[0], tmp_path / "w")
    run = curecon("publish", tmp_path / "w", tmp_path / "out", "--location", HIDDEN, "--title", "土楼")
    assert run.code == 0 and "There is no mesh" in run.said and "no accuracy report" in run.said, run.said
    assert run.summary["id"].startswith("site-") and run.summary["faces"] == 0 < run.summary["points"]
    assert record(tmp_path / "out")["surface"] is None and (tmp_path / "out" / "index.html").is_file()
    refused = curecon("publish", tmp_path / "w", tmp_path / "other", "--title", "x")
    assert refused.code == 2 and "--location" in refused.said and not (tmp_path / "other").exists()
    inside = curecon("publish", tmp_path / "w", tmp_path / "w" / "web", "--location", HIDDEN)
    assert inside.code == 15 and "lie in each other" in inside.said and not (tmp_path / "w" / "web").exists()
    nothing = curecon("publish", tmp_path / "out", tmp_path / "other", "--location", HIDDEN)
    assert nothing.code == 5 and "not a workspace" in nothing.said


def test_an_unknown_scale_and_a_mesh_of_two_faces(workspace: Path, tmp_path: Path) -> None:
    views = json.loads((workspace / "views.json").read_text())
    views["components"][0]["frame"]["scale"] = "unknown"
    (workspace / "views.json").write_text(json.dumps(views))
    write_mesh(workspace / "textured" / "mesh.ply", Mesh(
        vertices=np.array([(0, 0, 0), (1, 0, 0), (1, 1, 1), (0, 1, 1)], np.float32),
        faces=np.array([(0, 1, 2), (0, 2, 3)], np.int32), colours=np.full((4, 3), 90, np.uint8),
        distance=np.zeros(4, np.float32), views=np.ones(4, np.uint8), filled=np.array([False, True])))
    reporter = Reporter()
    publish(workspace, tmp_path / "out", replace(ABOUT, location=EXACT), 1, reporter)
    assert any("not to measure" in text for text in reporter.warnings)
    found = record(tmp_path / "out")
    assert found["metres"] is False and found["surface"]["faces"] == 2  # type: ignore[index]
    (tile,) = published.tiles(next((tmp_path / "out").glob("sites/*/surface")))
    assert {part.material: len(part.faces) for part in tile.primitives} == {"measured": 1, "filled": 1}
    assert not [*(tmp_path / "out").rglob("earth.json")]  # nobody knows how large it is


def test_a_missing_page_costs_the_texture_and_a_page_that_never_was_is_damage(workspace: Path, tmp_path: Path) -> None:
    whole = read_mesh(workspace / "textured" / "mesh.ply")
    assert whole.page is not None
    write_mesh(workspace / "textured" / "mesh.ply", replace(whole, page=whole.page + 99))
    with pytest.raises(PublishError, match="not there"):
        publish(workspace, tmp_path / "out", ABOUT, 1, Reporter())
    write_mesh(workspace / "textured" / "mesh.ply", whole)
    for page in (workspace / "textured").glob("texture_*"):
        page.unlink()
    reporter = Reporter()
    publish(workspace, tmp_path / "out", ABOUT, 1, reporter)
    assert any("colours of its vertices" in text and "Run Texture again" in text for text in reporter.warnings)
    assert record(tmp_path / "out")["surface"]["textured"] is False  # type: ignore[index]
    (tile,) = published.tiles(next((tmp_path / "out").glob("sites/*/surface")))
    assert tile.primitives[0].colours is not None and tile.primitives[0].colours.max() > 0.1


def test_folders_of_others_and_publishes_at_once(workspace: Path, tmp_path: Path) -> None:
    other = tmp_path / "somebody's \"work\""
    other.mkdir()
    (other / "index.html").write_text("precious")
    with pytest.raises(PublishError, match="not empty"):
        publish(workspace, other, ABOUT, 1, Reporter())
    assert [path.name for path in other.iterdir()] == ["index.html"]
    with pytest.raises(PublishError, match="in the way"):
        publish(workspace, other / "index.html", ABOUT, 1, Reporter())
    (tmp_path / "out").mkdir()
    with (tmp_path / "out" / ".publish.lock").open("w") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        with pytest.raises(PublishError, match="Another publish"):
            publish(workspace, tmp_path / "out", ABOUT, 1, Reporter())
    with pytest.raises(PublishError, match="no part 2"):
        publish(workspace, tmp_path / "out", ABOUT, 2, Reporter())
    with pytest.raises(PublishError, match="no name"):
        publish(workspace, tmp_path / "out", replace(ABOUT, title=" \n"), 1, Reporter())


def test_a_site_published_again_leaves_nothing_of_before(workspace: Path, tmp_path: Path) -> None:
    needles, out = published.needles(workspace), tmp_path / "out"
    publish(workspace, out, replace(ABOUT, location=EXACT), 1, Reporter())
    assert published.telling(out, needles)
    publish(workspace, out, replace(ABOUT, title="Tower", location=HIDDEN), 1, Reporter())
    publish(workspace, out, replace(ABOUT, location=HIDDEN), 1, Reporter())
    assert not published.telling(out, needles)
    assert sorted(path.name for path in (out / "sites").iterdir()) == ["gate", "tower"]
    assert len(json.loads((out / "items.json").read_text())["features"]) == 2
    links = [link["href"] for link in json.loads((out / "catalog.json").read_text())["links"] if link["rel"] == "item"]
    assert all((out / link).is_file() for link in links) and len(links) == 2
    (out / "sites" / "tower" / "item.json").write_text("{")
    reporter = Reporter()
    publish(workspace, out, ABOUT, 1, reporter)
    assert any("not in the catalogue" in text for text in reporter.warnings)
    shutil.rmtree(out / "sites" / "tower")
    publish(workspace, out, ABOUT, 1, Reporter())
    assert len(json.loads((out / "items.json").read_text())["features"]) == 1


@pytest.mark.parametrize("options", ["size=400k", "size=40m,ro"])
def test_a_full_or_read_only_disk_leaves_no_half_of_a_site(workspace: Path, tmp_path: Path, options: str) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(disk)], check=False,
                      capture_output=True).returncode:
        pytest.skip("mounting a small disk needs root")
    try:
        with pytest.raises(WorkspaceError, match=r"disk is full|No permission"):
            publish(workspace, disk / "out", ABOUT, 1, Reporter())
        assert not [path for path in disk.rglob("*") if path.is_file() and path.name != ".publish.lock"]
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_titles_become_addresses_and_nothing_else() -> None:
    titles = ["Gate", "../../etc", "a/b\\c", "<b>x</b>", "土楼", "楼土", "con", "x" * 500, "a b", "A_B", ".", "\ud800"]
    names = [replace(ABOUT, title=title).id for title in titles]
    assert names[0] == "gate" and all(name.replace("-", "").isalnum() and name.isascii() for name in names)
    assert len(set(names)) == len(titles) - 1 and names[8] == names[9] == "a-b" and max(map(len, names)) < 60


def test_notes_that_are_none_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "notes.json"
    path.write_text(json.dumps([{"title": "Door", "place": [1, 2, 3], "eye": [4, 5, 6]}]))
    assert read_notes(path) == (Note(title="Door", place=(1, 2, 3), eye=(4, 5, 6)),)
    for wrong in ("[", '[{"title": "x"}]', '[{"title": "x", "place": [1, 2]}]', '[{"title": 3, "place": [1, 2, 3]}]',
                  '[{"title": "x", "place": [1, 2, 1e99]}]', json.dumps([{"title": "x", "place": [0, 0, 0]}] * 501)):
        path.write_text(wrong)
        with pytest.raises(WorkspaceError, match="no notes"):
            read_notes(path)
