# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The accuracy report tells what the workspace holds, in its three forms, and says what it does not know."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from conftest import Run, curecon
from PIL import Image

from curecon_blender.core.base.errors import WorkspaceError
from curecon_blender.core.cloud.ply import Cloud
from curecon_blender.core.report.figures import (
    GROUND,
    ROOFS,
    WALLS,
    kinds_of_surface,
    seen_well,
    supported_scale,
    texel_size,
)
from curecon_blender.core.report.sections import length
from curecon_blender.core.surface.mesh import Mesh, read_mesh

WORDS = ("Clearness", "Accuracy", "Integrity", "Authenticity", "Provenance")


def test_the_report_tells_what_the_workspace_holds(
    textured: tuple[Path, Run], site_photos: Path, tmp_path: Path
) -> None:
    workspace = tmp_path / "tulou"
    shutil.copytree(textured[0], workspace)
    lost = sorted(site_photos.glob("*.JPG"))[0].name
    done = curecon("report", workspace, "--by", "A. Surveyor <a@b>")
    assert done.code == 0, done.said
    files = done.summary["report"]
    told = json.loads(Path(files["json"]).read_text(encoding="utf-8"))
    part, provenance = told["parts"][0], told["provenance"]
    photos = {photo["name"]: photo for photo in provenance["photos"]}
    assert part["integrity"]["placed"] == part["integrity"]["photos"] == len(photos)
    content = (site_photos / lost).read_bytes()
    assert photos[lost]["sha256"] == hashlib.sha256(content).hexdigest() and photos[lost]["taken"]
    # The site is flown at 30 to 60 m with a lens of 1,200 pixels' focal length, here at half the size.
    assert 0.02 < part["clearness"]["pixel"]["median"] < 0.15
    assert part["clearness"]["texel"] > part["clearness"]["pixel"]["low"] / 2
    mesh = read_mesh(workspace / "mesh.ply")
    assert part["faces"] == len(mesh.faces)
    assert part["integrity"]["filled"] == pytest.approx(mesh.areas[mesh.filled].sum() / mesh.areas.sum(), abs=1e-6)
    assert part["authenticity"]["unshown"] >= part["authenticity"]["filled"] - 1e-6
    assert 0.3 < part["integrity"]["seen_well"] <= 1
    assert part["correctness"]["metres"] and part["correctness"]["gps"]["count"] == len(photos)
    assert provenance["settings"]["quality"] and len(provenance["weights"]) == 64

    page = Path(files["html"]).read_text(encoding="utf-8")
    assert all(f"<h2>{word}</h2>" in page for word in WORDS)
    assert "A. Surveyor &lt;a@b&gt;" in page and "<a@b>" not in page  # text from outside stays text
    assert page.count("<img ") == 4 and "http" not in page.replace("http-equiv", "")
    pdf = Path(files["pdf"]).read_bytes()
    assert pdf.startswith(b"%PDF") and pdf.count(b"/Type /Page\n") >= 2


def test_doubtful_heights_are_told_beside_the_scale_of_drawings(
    finished: tuple[Path, Run], tmp_path: Path
) -> None:
    workspace = tmp_path / "w"
    shutil.copytree(finished[0], workspace)
    record = json.loads((workspace / "views.json").read_text(encoding="utf-8"))
    assert curecon("report", workspace).code == 0
    told = json.loads((workspace / "report" / "report.json").read_text(encoding="utf-8"))
    assert "doubtful" not in told["sentences"]["Accuracy"]
    record["components"][0]["frame"]["doubt"] = "Heights are doubtful: the model is bent."
    (workspace / "views.json").write_text(json.dumps(record), encoding="utf-8")
    assert curecon("report", workspace).code == 0
    told = json.loads((workspace / "report" / "report.json").read_text(encoding="utf-8"))
    assert told["sentences"]["Accuracy"].startswith("Heights are doubtful")
    assert "the model is bent" in (workspace / "report" / "report.html").read_text(encoding="utf-8")


def test_a_photo_that_is_gone_is_told_and_ends_no_report(finished: tuple[Path, Run], tmp_path: Path) -> None:
    workspace = tmp_path / "w"
    shutil.copytree(finished[0], workspace)
    record = json.loads((workspace / "photos.json").read_text())
    record["photos"][0]["path"] = str(tmp_path / "gone.jpg")
    (workspace / "photos.json").write_text(json.dumps(record))
    done = curecon("report", workspace)
    assert done.code == 0, done.said
    told = json.loads((workspace / "report" / "report.json").read_text(encoding="utf-8"))
    assert told["provenance"]["photos"][0]["sha256"] == ""
    assert told["sentences"]["Provenance"].count("1 of them")
    assert "no mesh yet" in told["sentences"]["Authenticity"] and told["parts"][0]["integrity"]["filled"] is None


def test_a_folder_without_a_cloud_has_no_report(tmp_path: Path) -> None:
    done = curecon("report", tmp_path)
    assert done.code == WorkspaceError.exit_code
    assert "not a workspace" in done.summary["error"]


def flat_cloud(views: list[int]) -> Cloud:
    """Points a metre apart on the ground, seen by so many photos."""
    count = len(views)
    points = np.column_stack([np.arange(count), np.zeros(count), np.zeros(count)]).astype(np.float32)
    up = np.tile(np.array([0, 0, 1], np.float32), (count, 1))
    return Cloud(points, np.full((count, 3), 99, np.uint8), up, np.ones(count, np.float32), np.array(views, np.uint8))


def test_what_many_points_show_counts_once() -> None:
    sparse, dense = flat_cloud([2] * 50), flat_cloud([5] * 50)
    crowded = Cloud(np.repeat(dense.points + np.float32([100, 0, 0]), 40, 0), np.repeat(dense.colours, 40, 0),
                    np.repeat(dense.normals, 40, 0), np.repeat(dense.confidence, 40), np.repeat(dense.views, 40))
    both = Cloud(*(np.concatenate([getattr(sparse, name), getattr(crowded, name)])
                   for name in ("points", "colours", "normals", "confidence", "views")))
    assert seen_well(both) == pytest.approx(0.5, abs=0.06)  # cells at the rim may hold some more


def test_walls_roofs_and_ground_are_told_apart() -> None:
    cloud = flat_cloud([3] * 90)
    cloud.points[30:60, 2] = 6
    cloud.normals[60:] = [1, 0, 0]
    kinds = kinds_of_surface(cloud)
    assert [int(kinds[name].sum()) for name in (WALLS, ROOFS, GROUND)] == [30, 30, 30]


def test_a_scale_needs_both_precise_points_and_fine_photos() -> None:
    assert supported_scale(0.005, 0.004) == 20
    assert supported_scale(0.012, 0.004) == 50
    assert supported_scale(0.005, 0.02) == 100
    assert supported_scale(1.0, 0.02) is None


def test_the_size_of_a_texel(tmp_path: Path) -> None:
    Image.new("RGB", (100, 200)).save(tmp_path / "page.png")
    uv = np.array([[[0, 0], [1, 0], [0, 1]]], np.float32)  # 100 by 200 pixels over 1 by 2 metres
    mesh = Mesh(
        vertices=np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0]], np.float32), faces=np.array([[0, 1, 2]], np.int32),
        colours=np.zeros((3, 3), np.uint8), distance=np.zeros(3, np.float32), views=np.ones(3, np.uint8),
        filled=np.zeros(1, bool), uv=uv, page=np.zeros(1, np.int32), pages=("page.png",),
    )
    assert texel_size(mesh, tmp_path) == pytest.approx(0.01)


def test_lengths_are_said_as_people_say_them() -> None:
    assert [length(value, metres=True) for value in (0.0093, 0.35, 12)] == ["9.3 mm", "350 mm", "12.00 m"]
    assert length(0.5, metres=False) == "0.5 units"
